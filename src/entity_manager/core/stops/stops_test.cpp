// SPDX-License-Identifier: GPL-2.0-or-later
// What a receipt says of robots that cannot be stopped, that come to rest later, or that were not stopped by
// anybody's wish.
#include <gtest/gtest.h>

#include <algorithm>

#include "entity_manager/core/entity_manager_core.hpp"
#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using proto::StopReceipt;
using test::CoreRig;

struct Stops : testing::Test {
    Stops() {
        rig.makeIdle();
        rig.take("client1", "r1");
    }
    void run(const std::string& task) {
        rig.task("client1", task, "Turning");
        rig.grant(task);
    }
    void comeBack() {
        rig.linkUp();
        rig.uploadProfiles();
    }
    bool given(const std::string& task) const {
        return std::any_of(rig.to_application.begin(), rig.to_application.end(), [&](const auto& message) {
            return message.has_task() && rig.nameOfSent(message.task().task_id()) == task;
        });
    }
    /// The last receipt that the client was told.
    StopReceipt last(const std::string& client) const {
        StopReceipt found;
        for (const auto& told : rig.to_clients)
            if (told.head.sender.id == client && told.message.has_receipt()) {
                EXPECT_EQ(told.lane, Lane::Signal);
                found = told.message.receipt();
            }
        return found;
    }
    std::vector<StopReceipt::Stage> stages(const std::string& client) const {
        std::vector<StopReceipt::Stage> found;
        for (const auto& told : rig.to_clients)
            if (told.head.sender.id == client && told.message.has_receipt())
                found.push_back(told.message.receipt().stage());
        return found;
    }
    CoreRig rig;
};

TEST_F(Stops, ASilentApplicationIsNotTakenForAbsent) {
    run("t1");
    rig.core().onLinkDown("the robot application has been silent for 250 ms", LinkEnd::Silent);
    rig.advance(2s);
    rig.stop("client2");
    EXPECT_EQ(last("client2").stage(), StopReceipt::NO_APPLICATION);
    EXPECT_EQ(last("client2").absence(), StopReceipt::SILENT);
    EXPECT_NE(last("client2").absence_reason().find("silent for 250 ms"), std::string::npos);
    EXPECT_EQ(last("client2").absent_for_ms(), 2000U);
}

TEST_F(Stops, AStopThatIsUnderWayWhenTheApplicationFallsSilentIsNotTakenForConfirmed) {
    run("t1");
    rig.stop("client2");
    rig.core().onLinkDown("the robot application has been silent for 250 ms", LinkEnd::Silent);
    EXPECT_EQ(last("client2").absence(), StopReceipt::SILENT);
    EXPECT_EQ(last("client1").absence(), StopReceipt::SILENT) << "the holder is told as well";
}

TEST_F(Stops, AnApplicationThatDiedHasNotSaidThatItsRobotStands) {
    run("t1");
    rig.core().onLinkDown("the robot application has closed the link", LinkEnd::Closed);
    rig.stop("client2");
    EXPECT_EQ(last("client2").stage(), StopReceipt::NO_APPLICATION);
    EXPECT_EQ(last("client2").absence(), StopReceipt::GONE);
}

TEST_F(Stops, AfterAGoodByeThereIsNothingToStop) {
    rig.core().onLinkDown("the robot application has stopped its robot and ended", LinkEnd::GoodBye);
    rig.stop("client2");
    EXPECT_EQ(last("client2").stage(), StopReceipt::NO_APPLICATION);
    EXPECT_EQ(last("client2").absence(), StopReceipt::NONE);
    rig.restart();
    rig.core().onServerUp();
    EXPECT_EQ(rig.core().status().state, EntityState::UNAV);
}

TEST(StopsOfNobody, WhereNoApplicationHasEverBeenLinkedThereIsNothingToStop) {
    CoreRig rig;
    rig.makeIdle();
    rig.core().onLinkDown("pulled", LinkEnd::GoodBye);
    CoreRig fresh;
    fresh.core().onServerUp();
    fresh.stop("client2");
    ASSERT_FALSE(fresh.to_clients.empty());
    EXPECT_EQ(fresh.to_clients.back().message.receipt().absence(), StopReceipt::NONE);
}

TEST_F(Stops, AnApplicationThatComesBackIsGivenTheStopAndConfirmsIt) {
    run("t1");
    rig.core().onLinkDown("silent", LinkEnd::Silent);
    const auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    const auto before = rig.stops.size();
    comeBack();
    ASSERT_EQ(rig.stops.size(), before + 1) << "another process may be in its place";
    EXPECT_EQ(rig.stops.back().second, StopCause::LinkLost);
    EXPECT_EQ(last("client2").absence(), StopReceipt::SILENT) << "not yet";
    rig.core().onStopRepeated(head, StopCause::Requested, *raised);
    EXPECT_EQ(last("client2").stage(), StopReceipt::MANAGER);
    rig.stopDone(rig.stops.back().first);
    EXPECT_EQ(last("client2").stage(), StopReceipt::CALLBACK_RETURNED);
    EXPECT_EQ(last("client2").absence(), StopReceipt::ABSENCE_UNSPECIFIED);
}

TEST_F(Stops, NobodyGetsTheRobotBeforeThatStopIsConfirmed) {
    rig.core().onLinkDown("silent", LinkEnd::Silent);
    rig.stop("client2");
    comeBack();
    rig.take("client3", "r3");
    EXPECT_EQ(rig.core().held(), nullptr);
    rig.stopDone(rig.stops.back().first);
    EXPECT_NE(rig.core().held(), nullptr);
}

TEST_F(Stops, WithoutAStopMeanwhileNothingIsGivenToAnApplicationThatComesBack) {
    rig.core().onLinkDown("closed", LinkEnd::Closed);
    comeBack();
    EXPECT_TRUE(rig.stops.empty());
}

TEST_F(Stops, TheNextLifeOfTheEntityManagerKnowsThatItsApplicationIsMissing) {
    rig.restart();
    rig.core().onServerUp();
    rig.stop("client2");
    rig.to_clients.clear();
    comeBack();
    rig.core().onServerUp();
    rig.stopDone(rig.stop_generations.generation());
    rig.core().onLinkDown("closed", LinkEnd::Closed);
    rig.stop("client2");
    EXPECT_EQ(last("client2").absence(), StopReceipt::GONE);
    const auto kept = rig.storage.values.contains("application_linked");
    EXPECT_TRUE(kept);
}

TEST_F(Stops, AfterTheEndOfTheEntityManagerAnApplicationIsMissingUntilItLinksOrHasSaidGoodBye) {
    rig.core().shutDown();
    EXPECT_TRUE(rig.storage.values.contains("application_linked"))
        << "it may have hung, or died, a moment before";
}

TEST_F(Stops, AnOrderlyLifeInWhichATaskRanIsNotFollowedByALatch) {
    run("t1");
    rig.core().shutDown();
    // A file of tasks and one of all else are read one after the other.
    std::stable_partition(rig.journal.records.begin(), rig.journal.records.end(),
                          [](const JournalRecord& record) {
                              return record.kind != JournalRecord::Kind::Dispatched &&
                                     record.kind != JournalRecord::Kind::TaskEnded;
                          });
    rig.restart();
    EXPECT_FALSE(rig.core().latched());
}

TEST_F(Stops, ALifeThatWasBrokenOffUnderAHolderIsFollowedByALatchWithoutAWordOfTheJournal) {
    rig.journal.records.clear();
    rig.restart();
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(Stops, ADrillOfALostApplicationIsNotKeptForItsReturn) {
    rig.stop("client2", StopCause::Drill);
    const auto told = rig.stops.size();
    rig.core().onLinkDown("silent", LinkEnd::Silent);
    EXPECT_EQ(last("client2").absence(), StopReceipt::SILENT);
    comeBack();
    EXPECT_EQ(rig.stops.size(), told) << "nothing is stopped on its account";
}

TEST_F(Stops, ADrillIsAnsweredWhateverSomebodyElseDrillsMeanwhile) {
    rig.stop("client2", StopCause::Drill);
    for (int i = 0; i < 300; ++i) rig.stop("client3", StopCause::Drill);
    rig.drillDone(1);
    EXPECT_EQ(last("client2").stage(), StopReceipt::CALLBACK_RETURNED);
}

TEST_F(Stops, OfARobotThatMovesStandstillIsAnnouncedWhereItsApplicationReportsIt) {
    run("t1");
    rig.stop("client2");
    rig.stopDone(1, StopReceipt::CALLBACK_RETURNED, true);
    EXPECT_TRUE(last("client2").standstill_follows());
    EXPECT_TRUE(last("client1").standstill_follows());
    rig.update("t1", proto::TASK_STOPPED);
    rig.advance(300ms);
    rig.stop("client3");  // it still rolls
    rig.stopDone(2, StopReceipt::CALLBACK_RETURNED, true);
    EXPECT_TRUE(last("client3").standstill_follows());
    rig.stopDone(2, StopReceipt::STANDSTILL);
    for (const auto* client : {"client1", "client2", "client3"}) {
        EXPECT_EQ(last(client).stage(), StopReceipt::STANDSTILL) << client;
        EXPECT_FALSE(last(client).standstill_follows());
    }
    rig.stop("client3");
    rig.stopDone(3, StopReceipt::CALLBACK_RETURNED, true);
    EXPECT_FALSE(last("client3").standstill_follows()) << "it stands";
}

TEST_F(Stops, AStandstillConfirmsNoCallback) {
    run("t1");
    rig.stop("client2");
    rig.update("t1", proto::TASK_STOPPED);
    rig.stopDone(1, StopReceipt::STANDSTILL);
    EXPECT_EQ(last("client2").stage(), StopReceipt::MANAGER);
    rig.rearm("client1", "r2");
    rig.task("client1", "t2", "Turning");
    EXPECT_FALSE(given("t2")) << "its stop callback may still run";
    rig.stopDone(1);
    EXPECT_EQ(last("client2").stage(), StopReceipt::CALLBACK_RETURNED);
    EXPECT_TRUE(given("t2"));
}

TEST_F(Stops, ATaskThatEndsBeforeTheStrandHearsOfItsStopLeavesARobotThatMoves) {
    run("t1");
    const auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);  // the signal thread
    rig.stopDone(*raised, StopReceipt::CALLBACK_RETURNED, true);
    rig.update("t1", proto::TASK_STOPPED);
    EXPECT_TRUE(rig.busy);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    EXPECT_EQ(last("client2").stage(), StopReceipt::CALLBACK_RETURNED);
    EXPECT_TRUE(last("client2").standstill_follows());
    EXPECT_FALSE(rig.busy);
    rig.stopDone(*raised, StopReceipt::STANDSTILL);
    EXPECT_EQ(last("client2").stage(), StopReceipt::STANDSTILL);
}

TEST_F(Stops, OfARobotThatStoodOrWhoseApplicationDoesNotSayItIsNotWaitedFor) {
    rig.stop("client2");
    rig.stopDone(1, StopReceipt::CALLBACK_RETURNED, true);
    EXPECT_FALSE(last("client2").standstill_follows());
    rig.rearm("client1", "r2");
    run("t1");
    rig.stop("client2");
    rig.stopDone(2, StopReceipt::CALLBACK_RETURNED, false);
    EXPECT_EQ(last("client2").stage(), StopReceipt::CALLBACK_RETURNED);
    EXPECT_FALSE(last("client2").standstill_follows());
}

TEST_F(Stops, WhoAsksAgainAfterTheLastStageIsToldTheLastStage) {
    run("t1");
    const auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    rig.stopDone(*raised);
    rig.stopDone(*raised, StopReceipt::STANDSTILL);
    rig.to_clients.clear();
    rig.core().onStopRepeated(head, StopCause::Requested, *raised);
    EXPECT_EQ(stages("client2"), std::vector{StopReceipt::STANDSTILL});
}

TEST_F(Stops, WhoWaitsForStandstillIsToldWhenTheApplicationIsLostMeanwhile) {
    run("t1");
    rig.stop("client2");
    rig.stopDone(1, StopReceipt::CALLBACK_RETURNED, true);
    rig.core().onLinkDown("closed", LinkEnd::Closed);
    EXPECT_EQ(last("client2").stage(), StopReceipt::CALLBACK_RETURNED);
    EXPECT_FALSE(last("client2").standstill_follows());
}

TEST_F(Stops, AStandstillLongAfterwardsIsNoNewsOfAnOldStop) {
    run("t1");
    rig.stop("client2");
    rig.stopDone(1);
    rig.update("t1", proto::TASK_STOPPED);
    rig.advance(11s);
    rig.to_clients.clear();
    rig.stopDone(1, StopReceipt::STANDSTILL);
    EXPECT_TRUE(stages("client2").empty());
}

TEST_F(Stops, AResetAndAClearSayHowManyTasksTheyEndAndRemove) {
    run("t1");
    rig.task("client1", "t2", "Turning");
    rig.task("client1", "t3", "Turning");
    rig.reset("client1");
    EXPECT_EQ(last("client1").tasks_ended(), 1U);
    EXPECT_EQ(last("client1").tasks_removed(), 0U);
    rig.stopDone(1);
    rig.update("t1", proto::TASK_STOPPED);
    rig.grant("t2");
    rig.clear("client1");
    EXPECT_EQ(last("client1").tasks_ended(), 1U);
    EXPECT_EQ(last("client1").tasks_removed(), 1U);
    rig.stopDone(2);
    rig.update("t2", proto::TASK_STOPPED);
    rig.reset("client1");
    EXPECT_EQ(last("client1").tasks_ended(), 0U) << "nothing ran";
}

// Stops that nobody ordered (ADR 0022).

TEST_F(Stops, TheLossOfTheServerLatchesWhatSomebodyHolds) {
    rig.core().onServerDown("connection closed");
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(Stops, TheLossOfTheApplicationLatchesAndItsGoodByeDoesNot) {
    rig.core().onLinkDown("over", LinkEnd::GoodBye);
    EXPECT_FALSE(rig.core().latched());
    for (const auto end : {LinkEnd::Closed, LinkEnd::Silent}) {
        CoreRig other;
        other.makeIdle();
        other.take("client1", "r1");
        other.core().onLinkDown("lost", end);
        EXPECT_TRUE(other.core().latched());
    }
}

TEST_F(Stops, WhatNobodyHoldsIsNotLatchedByALoss) {
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    rig.core().onServerDown("connection closed");
    rig.core().onServerUp();
    rig.core().onLinkDown("closed", LinkEnd::Closed);
    EXPECT_FALSE(rig.core().latched());
}

TEST_F(Stops, AnEntityManagerThatWasKilledWhileSomebodyHeldTheRobotComesBackLatched) {
    rig.restart();
    EXPECT_TRUE(rig.core().latched());
    rig.restart();
    EXPECT_TRUE(rig.core().latched()) << "and stays so";
    rig.makeIdle();
    rig.rearm("admin", "r9");
    rig.restart();
    EXPECT_FALSE(rig.core().latched()) << "nobody held it any more";
}

TEST_F(Stops, AnEntityManagerThatWasEndedInOrderComesBackAsItWas) {
    rig.core().shutDown();
    rig.restart();
    EXPECT_FALSE(rig.core().latched());
}

}  // namespace
}  // namespace axon::entity_manager
