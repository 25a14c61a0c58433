// SPDX-License-Identifier: GPL-2.0-or-later
// Values that the robot application is asked for, without the rest of the Entity Manager. What they mean for
// tasks is claimed in tasks_test.cpp and composite_tasks_test.cpp.
#include "entity_manager/core/inputs/inputs.hpp"

#include <gtest/gtest.h>

#include "messages/values.hpp"
#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

proto::ServicesProfile profileOfDriving() {
    proto::ServicesProfile profile;
    auto& service = *profile.add_services();
    service.set_name("Driving");
    for (const auto type : {proto::INPUT, proto::CONFIG}) {
        auto& param = *service.add_params();
        param.set_name(type == proto::CONFIG ? "Limit" : "Distance");
        param.set_type(type);
        param.set_data_type(proto::INT);
    }
    return profile;
}

/// What stops and tasks would say.
struct NotingOthers final : Inputs::Others {
    Refusal checkGeneration(std::int32_t) const override { return outdated; }
    Refusal leavesRoom(int, const proto::Param&) const override { return room; }
    void reconfigure(int, const proto::Param& param) override { reconfigured.push_back(param); }
    Refusal outdated, room;
    std::vector<proto::Param> reconfigured;
};

struct TheInputs : testing::Test {
    TheInputs() {
        profiler.load(profileOfDriving(), "self", {});
        turn.lease.emplace();
        turn.lease->number = {1, 1};
        turn.lease->holder.id = "client";
    }
    void set(const std::string& name, int value) {
        Header head;
        head.sender.id = "client";
        head.held = {1, 1};
        proto::ToEntity body;
        auto& request = *body.mutable_set_param();
        request.set_request_id("r");
        request.set_service("Driving");
        request.mutable_param()->set_name(name);
        request.mutable_param()->add_values()->set_int_(value);
        inputs.askParameter({Event::SetParam, &head, &body});
    }
    std::uint64_t asked() const { return turn.to_application.back().param().request(); }
    void answer(RefusalCode code = RefusalCode::Ok) {
        proto::RequestAnswer said;
        said.set_request(asked());
        if (code != RefusalCode::Ok) *said.mutable_refusal() = toProto(Refusal{code, "no", {}});
        inputs.answered(said);
    }
    std::int64_t valueOf(int param) const {
        const auto& initial = profiler.record(0).params(param).initial();
        return initial.empty() ? 0 : initial[0].int_();
    }

    test::MemoryStorage storage;
    test::MemoryResources store;
    test::FakeTurn turn;
    ServiceProfiler profiler;
    NotingOthers others;
    Inputs inputs{turn, others, storage, store, profiler, {10s, 1000, 100}};
};

TEST_F(TheInputs, AValueCountsOnceTheApplicationHasGrantedIt) {
    set("Distance", 5);
    ASSERT_EQ(turn.to_application.size(), 1U);
    EXPECT_EQ(valueOf(0), 0);
    EXPECT_TRUE(turn.replies.empty());
    answer();
    EXPECT_EQ(valueOf(0), 5);
    ASSERT_EQ(turn.replies.size(), 1U);
    EXPECT_TRUE(turn.replies[0].ok());
    ASSERT_EQ(turn.told.size(), 1U);
    EXPECT_EQ(turn.told[0].message.service().name(), "Driving") << "its holder is told";
    answer();
    EXPECT_EQ(turn.counted.unexpected, 1U) << "a second answer is to nothing";
}

TEST_F(TheInputs, WhatTheApplicationDeniesOrDoesNotAnswerChangesNothing) {
    set("Distance", 5);
    answer(RefusalCode::Denied);
    EXPECT_EQ(turn.replies.back().code, RefusalCode::Denied);

    set("Distance", 6);
    EXPECT_EQ(inputs.nextDeadline(), turn.now() + 10s);
    turn.clock.advance(10s);
    inputs.onTimer();
    EXPECT_EQ(turn.replies.back().code, RefusalCode::TimedOut);
    EXPECT_EQ(inputs.nextDeadline(), TimePoint::max());

    set("Distance", 7);
    inputs.abandon({RefusalCode::Unavailable, "", {}});
    EXPECT_EQ(turn.replies.back().code, RefusalCode::Unavailable);
    answer();
    EXPECT_EQ(valueOf(0), 0);
}

TEST_F(TheInputs, AValueForALeaseThatHasEndedIsNotKeptForTheNext) {
    set("Distance", 5);
    turn.lease->number = {1, 2};
    answer();
    EXPECT_EQ(turn.replies.back().code, RefusalCode::RevokedLease);
    EXPECT_EQ(valueOf(0), 0);
}

TEST_F(TheInputs, AConfigurationReachesTheTasksUnlessItIsFromBeforeAStopOrDoesNotFit) {
    set("Limit", 5);
    answer();
    ASSERT_EQ(others.reconfigured.size(), 1U);
    EXPECT_EQ(others.reconfigured[0].name(), "Limit");

    set("Limit", 6);
    others.outdated = {RefusalCode::OldGeneration, "", {}};
    answer();
    EXPECT_EQ(turn.replies.back().code, RefusalCode::OldGeneration);

    set("Limit", 7);
    others.outdated = {};
    others.room = {RefusalCode::TooLarge, "", {}};
    answer();
    EXPECT_EQ(turn.replies.back().code, RefusalCode::TooLarge);
    EXPECT_EQ(others.reconfigured.size(), 1U);
    EXPECT_EQ(valueOf(1), 5);
}

TEST_F(TheInputs, TheApplicationIsAskedABoundedNumberOfThingsAtATime) {
    for (int i = 0; i < 64; ++i) set("Distance", i);
    EXPECT_TRUE(turn.refused.empty());
    set("Distance", 64);
    ASSERT_EQ(turn.refused.size(), 1U);
    EXPECT_EQ(turn.refused[0].code, RefusalCode::Overloaded);
}

}  // namespace
}  // namespace axon::entity_manager
