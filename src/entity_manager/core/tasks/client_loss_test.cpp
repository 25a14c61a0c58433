// SPDX-License-Identifier: GPL-2.0-or-later
// on_client_loss: what a task may do without its client, and everything that still stops it.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using test::CoreRig;
using test::idOf;

constexpr const char* kServices = R"(<ServiceProfile count="5">
  <Service name="Deliver" type="SMPL" blocking="false" on_client_loss="finish" max_duration="30"/>
  <Service name="Follow" type="SMPL" blocking="false" pausable="true" on_client_loss="hold"/>
  <Service name="Stiff" type="SMPL" blocking="false" on_client_loss="hold"/>
  <Service name="Drive" type="SMPL" blocking="false"/>
  <Service name="Turn" type="SMPL"/>
</ServiceProfile>
)";

struct ClientLoss : testing::Test {
    ClientLoss() {
        rig.linkUp();
        rig.upload(false, test::kRigBasicProfile);
        rig.upload(true, kServices);
        rig.core().onServerUp();
        rig.take("client1", "r1");
    }
    void run(const std::string& task, const std::string& service) {
        rig.task("client1", task, service);
        rig.grant(task);
    }
    /// As the front-end server does it: the stop on the signal lane, and the news.
    void lose(const std::string& client = "client1") {
        rig.stop(client, StopCause::ClientLost);
        rig.core().onClientUpdate(rig.headOf(client), ClientChange::Lost);
    }
    void confirm() { rig.stopDone(rig.stop_generations.generation()); }
    proto::TaskEvent lastOf(const std::string& task) const {
        for (auto at = rig.to_clients.rbegin(); at != rig.to_clients.rend(); ++at)
            if (at->message.has_task() && at->message.task().task_id() == idOf(task))
                return at->message.task();
        return {};
    }
    proto::RefusalCode takes(const std::string& client, const std::string& request) {
        rig.take(client, request);
        const auto& last = rig.to_clients.back().message;
        return last.has_check_out() ? last.check_out().refusal().code() : proto::OK;
    }
    int pauses() const {
        return static_cast<int>(
            std::count_if(rig.to_application.begin(), rig.to_application.end(),
                          [](const auto& m) { return m.has_pause() && !m.pause().resume(); }));
    }
    EntityStatus status() { return rig.core().status(); }
    CoreRig rig;
};

TEST_F(ClientLoss, WithoutAPolicyTheRobotStopsAtOnceAndIsLatched) {
    run("t1", "Drive");
    EXPECT_FALSE(rig.stop_generations.sparesClientLoss());
    lose();
    EXPECT_FALSE(rig.stops.empty());
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_STOPPED);
    EXPECT_TRUE(rig.core().latched());
    EXPECT_TRUE(status().orphaned);
}

TEST_F(ClientLoss, FinishRunsToItsEndAndTheEntityIsNobodysUntilThen) {
    run("t1", "Deliver");
    EXPECT_TRUE(rig.stop_generations.sparesClientLoss());
    lose();
    EXPECT_TRUE(rig.stops.empty());
    EXPECT_FALSE(rig.core().latched());
    EXPECT_EQ(status().state, EntityState::BUSY);
    EXPECT_TRUE(status().orphaned);
    rig.advance(20s);  // far beyond the grace
    EXPECT_EQ(takes("client2", "r2"), proto::ALREADY_HELD);
    EXPECT_TRUE(rig.stops.empty());
    rig.update("t1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(status().state, EntityState::IDLE);
    EXPECT_FALSE(rig.core().latched());
    EXPECT_FALSE(rig.stop_generations.sparesClientLoss());
    confirm();
    EXPECT_EQ(takes("client2", "r3"), proto::OK);
}

TEST_F(ClientLoss, FinishHasAnEndEvenIfTheTaskHasNone) {
    run("t1", "Deliver");
    lose();
    rig.advance(29'999ms);
    EXPECT_TRUE(rig.stops.empty());
    rig.advance(1ms);
    EXPECT_FALSE(rig.stops.empty());
    EXPECT_TRUE(rig.core().latched());
    EXPECT_EQ(rig.journal.records.back().kind, JournalRecord::Kind::LeaseEnded);
    EXPECT_EQ(status().state, EntityState::IDLE);
    EXPECT_TRUE(std::any_of(rig.journal.records.begin(), rig.journal.records.end(), [](const auto& record) {
        return record.kind == JournalRecord::Kind::TaskEnded &&
               record.text.find("max_duration") != std::string::npos;
    }));
}

TEST_F(ClientLoss, TheHolderComesBackToATaskThatWentOnAndHearsOfOneThatEnded) {
    run("t1", "Deliver");
    rig.task("client1", "t3", "Follow");
    rig.grant("t3");
    lose();
    rig.update("t3", proto::TASK_PAUSED);
    rig.update("t1", proto::TASK_SUCCEEDED);
    rig.to_clients.clear();
    rig.resumeLease("client1b", "r4", "client1");
    EXPECT_EQ(status().holder.id, "client1b");
    EXPECT_FALSE(status().orphaned);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_SUCCEEDED) << "told again";
    // Nothing runs by itself that was held.
    rig.advance(60s);
    EXPECT_EQ(status().state, EntityState::BUSY);
    EXPECT_TRUE(rig.stops.empty());
    proto::ToEntity resume;
    resume.mutable_task_control()->set_task_id(idOf("t3"));
    resume.mutable_task_control()->set_action(proto::RESUME);
    rig.send("client1b", resume);
    ASSERT_TRUE(rig.to_application.back().has_pause());
    EXPECT_TRUE(rig.to_application.back().pause().resume());
}

TEST_F(ClientLoss, HoldPausesAndIsEndedWithTheGrace) {
    run("t1", "Follow");
    lose();
    EXPECT_EQ(pauses(), 1);
    EXPECT_TRUE(rig.stops.empty());
    rig.update("t1", proto::TASK_PAUSED);
    rig.advance(4900ms);
    EXPECT_TRUE(rig.stops.empty());
    EXPECT_EQ(status().state, EntityState::BUSY);
    rig.advance(200ms);
    EXPECT_FALSE(rig.stops.empty());
    EXPECT_TRUE(rig.core().latched());
    EXPECT_EQ(status().state, EntityState::IDLE);
}

TEST_F(ClientLoss, HoldThatIsNotPausedInTimeIsStopped) {
    run("t1", "Follow");
    lose();
    rig.advance(999ms);
    EXPECT_TRUE(rig.stops.empty());
    rig.advance(1ms);
    EXPECT_FALSE(rig.stops.empty());
    EXPECT_TRUE(rig.core().latched());
    EXPECT_TRUE(status().orphaned);
}

TEST_F(ClientLoss, HeldAndRunningAgainByItselfIsStopped) {
    run("t1", "Follow");
    lose();
    rig.update("t1", proto::TASK_PAUSED);
    rig.advance(500ms);
    rig.update("t1", proto::TASK_RUNNING);
    rig.advance(1s);
    EXPECT_FALSE(rig.stops.empty());
}

TEST_F(ClientLoss, WhatIsInDoubtStops) {
    for (const char* service : {"Stiff", "Drive"}) {
        run(service, service);
        EXPECT_FALSE(rig.stop_generations.sparesClientLoss()) << service;
        rig.update(service, proto::TASK_SUCCEEDED);
    }
    run("t1", "Deliver");
    EXPECT_TRUE(rig.stop_generations.sparesClientLoss());
    rig.task("client1", "t2", "Follow");
    EXPECT_FALSE(rig.stop_generations.sparesClientLoss()) << "a task that has not been granted yet";
    rig.grant("t2");
    EXPECT_TRUE(rig.stop_generations.sparesClientLoss());
    run("t3", "Drive");
    EXPECT_FALSE(rig.stop_generations.sparesClientLoss()) << "the strictest counts";
    lose();
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_STOPPED);
    EXPECT_FALSE(rig.stops.empty());
}

TEST_F(ClientLoss, WhatWaitedIsVoid) {
    run("t1", "Deliver");
    rig.task("client1", "t2", "Turn");
    lose();
    EXPECT_EQ(lastOf("t2").state(), proto::TASK_STOPPED);
    rig.update("t1", proto::TASK_SUCCEEDED);
    for (const auto& message : rig.to_application) {
        EXPECT_FALSE(message.has_task() && message.task().task_id() == idOf("t2"));
    }
}

TEST_F(ClientLoss, AStopOfAnybodyRightAfterASparedLossStops) {
    run("t1", "Deliver");
    // The signal thread spares the loss and at once passes on a stop; the strand hears of both later.
    auto lost = rig.headOf("client1");
    ASSERT_TRUE(rig.stop_generations.sparesClientLoss());
    auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.core().onClientUpdate(lost, ClientChange::Lost);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_STOPPED);
    EXPECT_TRUE(rig.core().latched());
    EXPECT_FALSE(rig.stop_generations.sparesClientLoss());
}

TEST_F(ClientLoss, AStopWhileATaskFinishesAloneStops) {
    for (const auto cause : {StopCause::Requested, StopCause::Improper}) {
        rig.rearm("client1", "r2");
        const auto task = "t" + std::to_string(static_cast<int>(cause));
        run(task, "Deliver");
        lose();
        rig.stops.clear();
        rig.stop("client2", cause);
        EXPECT_EQ(lastOf(task).state(), proto::TASK_STOPPED);
        EXPECT_TRUE(rig.core().latched());
        confirm();
        rig.update(task, proto::TASK_STOPPED);
        rig.resumeLease("client1", "r" + task, "client1");
    }
}

TEST_F(ClientLoss, ALossThatWasSparedTooEarlyIsMadeUpForOnTheStrand) {
    run("t1", "Deliver");
    ASSERT_TRUE(rig.stop_generations.sparesClientLoss());  // the signal thread looks here …
    const auto lost = rig.headOf("client1");
    run("t2", "Drive");                                   // … the strand dispatches something else …
    rig.core().onClientUpdate(lost, ClientChange::Lost);  // … and then hears of the loss
    EXPECT_FALSE(rig.stops.empty());
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_STOPPED);
    EXPECT_EQ(lastOf("t2").state(), proto::TASK_STOPPED);
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(ClientLoss, TheLossOfAnythingElseStopsAsEver) {
    run("t1", "Deliver");
    lose();
    rig.core().onServerDown("cut");
    EXPECT_FALSE(rig.stops.empty());
    EXPECT_EQ(rig.journal.records.back().code, "TASK_STOPPED");
}

TEST_F(ClientLoss, TheSilenceOfTheServerStopsAsEver) {
    run("t1", "Deliver");
    lose();
    rig.advance(250ms, false);
    EXPECT_FALSE(rig.stops.empty());
}

TEST_F(ClientLoss, TheLossOfTheLinkIsAnUnknownOutcome) {
    run("t1", "Deliver");
    lose();
    rig.core().onLinkDown("pulled");
    EXPECT_FALSE(rig.stop_generations.sparesClientLoss());
    EXPECT_TRUE(std::any_of(rig.journal.records.begin(), rig.journal.records.end(),
                            [](const auto& record) { return record.code == "TASK_UNKNOWN"; }));
}

TEST_F(ClientLoss, AClientThatLeavesInAnOrderlyWayStopsWhatItLeavesBehind) {
    run("t1", "Deliver");
    rig.core().onClientUpdate(rig.headOf("client1"), ClientChange::Ended);
    EXPECT_FALSE(rig.stops.empty());
    EXPECT_EQ(status().state, EntityState::IDLE);
}

TEST_F(ClientLoss, ASecondNewsOfTheSameLossChangesNothing) {
    run("t1", "Deliver");
    lose();
    rig.advance(10s);
    lose();
    EXPECT_TRUE(rig.stops.empty());
    rig.advance(19'999ms);
    EXPECT_TRUE(rig.stops.empty());
    rig.advance(2ms);
    EXPECT_FALSE(rig.stops.empty()) << "the time runs from the first";
}

TEST_F(ClientLoss, TheLostClientItselfCommandsNothingAnyMore) {
    run("t1", "Deliver");
    lose();
    rig.task("client1", "t2", "Drive");
    EXPECT_EQ(lastOf("t2").state(), proto::TASK_REFUSED);
}

}  // namespace
}  // namespace axon::entity_manager
