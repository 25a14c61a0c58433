// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/tasks/active_task.hpp"

#include <gtest/gtest.h>

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

struct ActiveTasks : testing::Test {
    ActiveTasks() {
        proto::ServicesProfile profile;
        for (const auto* name : {"Whole", "Driving", "Turning"}) {
            auto& service = *profile.add_services();
            service.set_name(name);
            service.set_on_client_loss(proto::FINISH_TASK);
            service.set_max_duration_s(10);
            service.set_is_pausable(true);
        }
        profiler.load(profile, "self", {});
        active.task.plan.composite = true;
        for (const int service : {1, 2}) {
            ServiceProfiler::Order part;
            part.service = service;
            part.way = {0, service};
            active.task.plan.parts.push_back(part);
        }
        active.answered = true;
    }
    void say(int service, proto::OnClientLoss policy) {
        auto profile = profiler.profile();
        profile.mutable_services(service)->set_on_client_loss(policy);
        profiler.load(profile, "self", {});
    }

    ServiceProfiler profiler;
    ActiveTask active;
};

TEST_F(ActiveTasks, ThePartsOfACompositeAreToldAsOneTask) {
    active.part = 1;
    proto::TaskEvent event;
    event.set_progress(0.5);
    event.set_feedback("left");
    event.add_results()->set_name("Angle");
    active.nameAsWhole(profiler, event);
    EXPECT_EQ(event.progress(), 0.75);
    EXPECT_EQ(event.feedback(), "part 2 of 2, Turning: left");
    EXPECT_EQ(event.results(0).name(), "Turning.Angle");
}

TEST_F(ActiveTasks, TheEndHasTheNewestResultsOfAllPartsAndSaysWhereItWas) {
    active.sent = Id128{};
    for (const int value : {1, 2}) {
        proto::TaskEvent event;
        auto& result = *event.add_results();
        result.set_name("Driving.Way");
        result.add_values()->set_int_(value);
        active.keepResults(profiler, event);
    }
    proto::TaskEvent end;
    end.set_state(proto::TASK_FAILED);
    end.set_progress(-1);
    end.mutable_reason()->set_message("stuck");
    active.endAsWhole(profiler, end);
    ASSERT_EQ(end.results_size(), 1);
    EXPECT_EQ(end.results(0).values(0).int_(), 2);
    EXPECT_EQ(end.progress(), 0);
    EXPECT_EQ(end.reason().message(), "part 1 of 2, Driving: stuck");
}

TEST_F(ActiveTasks, WithoutItsClientTheStrictestServiceOfThePresentPartCounts) {
    EXPECT_EQ(active.lossPolicy(profiler, true), proto::FINISH_TASK);
    say(1, proto::HOLD_TASK);
    EXPECT_EQ(active.lossPolicy(profiler, true), proto::HOLD_TASK);
    EXPECT_EQ(active.lossPolicy(profiler, false), proto::STOP_TASK) << "nobody could come back and resume it";
    active.part = 1;
    EXPECT_EQ(active.lossPolicy(profiler, true), proto::FINISH_TASK) << "that part is over";
    say(0, proto::STOP_TASK);
    EXPECT_EQ(active.lossPolicy(profiler, true), proto::STOP_TASK);
}

TEST_F(ActiveTasks, WhatIsInDoubtStops) {
    active.answered = false;
    EXPECT_EQ(active.lossPolicy(profiler, true), proto::STOP_TASK);
    active.answered = true;
    active.halted = true;
    EXPECT_EQ(active.lossPolicy(profiler, true), proto::STOP_TASK);
}

TEST_F(ActiveTasks, APartGoesOnAloneNoLongerThanTheWhole) {
    const TimePoint now{1h};
    EXPECT_EQ(active.finishesUntil(profiler, now), now + 10s);
    active.finish_until = now + 3s;
    EXPECT_EQ(active.finishesUntil(profiler, now), now + 3s);
}

}  // namespace
}  // namespace axon::entity_manager
