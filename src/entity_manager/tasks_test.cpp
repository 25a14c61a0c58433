// SPDX-License-Identifier: GPL-2.0-or-later
// Tasks across retries, restarts and losses; what the journal says of them; applications that do not answer.
#include <gtest/gtest.h>

#include <algorithm>

#include "entity_manager/task_memory.hpp"
#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using test::CoreRig;
using test::idOf;
using Kind = JournalRecord::Kind;

int dispatches(const CoreRig& rig, const std::string& task) {
    int count = 0;
    for (const auto& message : rig.to_application)
        count += message.has_task() && message.task().task_id() == idOf(task) ? 1 : 0;
    return count;
}

/// The last that was told of the task.
proto::TaskEvent lastOf(const CoreRig& rig, const std::string& task) {
    for (auto at = rig.to_clients.rbegin(); at != rig.to_clients.rend(); ++at)
        if (at->message.has_task() && at->message.task().task_id() == idOf(task)) return at->message.task();
    return {};
}

proto::EntityStatus statusFor(CoreRig& rig, const std::string& client) {
    proto::ToEntity message;
    message.mutable_status_request()->set_request_id(idOf("status"));
    rig.send(client, message);
    return rig.to_clients.back().message.status();
}

std::vector<std::string> kinds(const CoreRig& rig) {
    std::vector<std::string> all;
    for (const auto& record : rig.journal.records) all.emplace_back(toString(record.kind));
    return all;
}

struct Tasks : testing::Test {
    Tasks() {
        rig.makeIdle();
        rig.take("client1", "r1");
    }
    void newLife() {
        rig.restart();
        rig.makeIdle();
        rig.take("client1", "r2");
        rig.rearm("client1", "again");
    }
    CoreRig rig;
};

TEST(TaskMemory, ForgetsTheOldestIdAboveItsBound) {
    TaskMemory memory;
    SeededRandom random(1);
    const auto first = Id128::random(random);
    memory.accept(first);
    for (std::size_t i = 1; i < TaskMemory::kIds; ++i) memory.accept(Id128::random(random));
    memory.ended(first, proto::TASK_FAILED);
    ASSERT_TRUE(memory.whyNotAgain(first));
    EXPECT_EQ(memory.whyNotAgain(first)->code, RefusalCode::Duplicate);
    memory.accept(Id128::random(random));
    EXPECT_FALSE(memory.whyNotAgain(first));
}

TEST_F(Tasks, TheJournalTellsTheStory) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.lease = LeaseNumber{1, 1};
    rig.task("client2", "t2", "Turning");
    rig.stop("client2");
    rig.stopDone(1);
    rig.rearm("client1", "r2");
    rig.stop("client2", StopCause::Drill);
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    EXPECT_EQ(kinds(rig), (std::vector<std::string>{"started", "granted", "dispatched", "refused", "stopped",
                                                    "task-ended", "rearmed", "stopped", "lease-ended"}));
    const auto& records = rig.journal.records;
    EXPECT_EQ(records[1].who, "client1@lab");
    EXPECT_EQ(records[1].lease, (LeaseNumber{1, 1}));
    EXPECT_EQ(records[2].task.bytes(), idOf("t1"));
    EXPECT_EQ(records[2].service, "Turning");
    EXPECT_EQ(records[3].code, "NOT_HOLDER");
    EXPECT_EQ(records[4].generation, 1U);
    EXPECT_EQ(records[4].who, "client2@lab");
    EXPECT_EQ(records[5].code, "TASK_STOPPED");
    EXPECT_EQ(records[8].code, "OK");
}

TEST_F(Tasks, ALatchOutlivesTheManagerUntilARearm) {
    rig.stop("client2");
    rig.restart();
    rig.makeIdle();
    EXPECT_TRUE(rig.core().latched());
    rig.take("client1", "r2");
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::LATCHED);
    EXPECT_EQ(dispatches(rig, "t1"), 0);
    rig.rearm("client1", "rearm");
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    rig.restart();
    EXPECT_FALSE(rig.core().latched());
}

TEST_F(Tasks, AStopThatTheDiskHasNoRoomForIsCarriedOutAndALaterLifeIsLatched) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.journal.full = rig.storage.full = true;
    rig.stop("client2");
    EXPECT_TRUE(rig.core().latched());
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_STOPPED);
    EXPECT_FALSE(rig.core().takeWarning().empty());
    rig.journal.full = rig.storage.full = false;
    rig.restart();
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(Tasks, ARearmThatDoesNotComeToTheDiskLeavesTheLatchToALaterLife) {
    rig.stop("client2");
    rig.stopDone(1);
    rig.storage.full = true;
    rig.rearm("client1", "rearm");
    EXPECT_FALSE(rig.core().latched());
    rig.restart();
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(Tasks, NothingThatTheJournalForgetsUnlatches) {
    rig.stop("client2");
    rig.journal.records.clear();
    rig.restart();
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(Tasks, AStopThatDoesNotLatchDoesNotLatchTheNextLife) {
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    rig.stop("client2", StopCause::Drill);
    rig.restart();
    EXPECT_FALSE(rig.core().latched());
}

TEST_F(Tasks, ATaskIdIsInTheJournalBeforeTheApplicationHasIt) {
    bool noted = false;
    rig.on_application = [&](const proto::EmToEi& message) {
        if (message.has_task())
            noted = rig.journal.records.back().kind == Kind::Dispatched &&
                    rig.journal.records.back().task.bytes() == message.task().task_id();
    };
    rig.task("client1", "t1", "Turning");
    EXPECT_TRUE(noted);
}

TEST_F(Tasks, AnIdReachesTheApplicationOnceHoweverOftenItIsSentAndTheManagerKilled) {
    rig.task("client1", "t1", "Turning");
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::DUPLICATE);
    rig.grant("t1");
    rig.update("t1", proto::TASK_SUCCEEDED);
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::DUPLICATE);
    for (int life = 0; life < 3; ++life) {
        newLife();
        rig.task("client1", "t1", "Turning");
        EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_REFUSED);
        EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::DUPLICATE);
        EXPECT_NE(lastOf(rig, "t1").reason().message().find("TASK_SUCCEEDED"), std::string::npos);
    }
    EXPECT_EQ(dispatches(rig, "t1"), 1);
}

TEST_F(Tasks, WhatWasRunningWhenTheManagerWasKilledIsUnknownAndNotRunAgain) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    newLife();
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_UNKNOWN);
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::OUTCOME_UNKNOWN);
    EXPECT_EQ(dispatches(rig, "t1"), 1);
    int ends = 0;
    newLife();
    for (const auto& record : rig.journal.records)
        if (record.kind == Kind::TaskEnded) {
            ++ends;
            EXPECT_EQ(record.code, "TASK_UNKNOWN");
        }
    EXPECT_EQ(ends, 1);
}

TEST_F(Tasks, WhatOnlyWaitedWhenTheManagerWasKilledMayBeSentAgain) {
    rig.task("client1", "t1", "Turning");
    rig.task("client1", "t2", "Turning");
    newLife();
    rig.task("client1", "t2", "Turning");
    EXPECT_EQ(dispatches(rig, "t2"), 1);
}

TEST_F(Tasks, TheLossOfTheLinkLeavesTheOutcomeUnknownAndSaysSoWhenAskedAgain) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.core().onLinkDown("pulled");
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_UNKNOWN);
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::OUTCOME_UNKNOWN);
    rig.linkUp();
    rig.uploadProfiles();
    if (rig.core().status().holder.id.empty()) rig.take("client1", "r2");
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_UNKNOWN);
    EXPECT_EQ(dispatches(rig, "t1"), 1);
}

TEST_F(Tasks, NothingStartsThatTheJournalDoesNotTake) {
    rig.journal.full = true;
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(dispatches(rig, "t1"), 0);
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_REFUSED);
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::OVERLOADED);
    EXPECT_FALSE(rig.busy);
    rig.stop("client2");  // a stop does not depend on it
    EXPECT_TRUE(rig.core().latched());
    EXPECT_GT(rig.core().counters().unrecorded, 0U);
}

TEST_F(Tasks, AFloodOfRefusalsDoesNotWashTheJournalOut) {
    const auto before = rig.journal.records.size();
    for (int i = 0; i < 1000; ++i) {
        rig.lease = LeaseNumber{1, 1};
        rig.task("client2", "t" + std::to_string(i), "Turning");
    }
    EXPECT_LE(rig.journal.records.size(), before + 10);
    EXPECT_GE(rig.core().counters().unrecorded, 990U);
}

TEST_F(Tasks, TheHolderIsToldHowItsLastTasksHaveEndedWhenItAsks) {
    for (int i = 0; i < 70; ++i) {
        const auto id = "t" + std::to_string(i);
        rig.task("client1", id, "Turning");
        rig.grant(id);
        rig.update(id, i == 69 ? proto::TASK_FAILED : proto::TASK_SUCCEEDED);
    }
    const auto status = statusFor(rig, "client1");
    ASSERT_EQ(status.ended_size(), 64);
    EXPECT_EQ(status.ended(0).task_id(), idOf("t6"));
    EXPECT_EQ(status.ended(63).state(), proto::TASK_FAILED);
    EXPECT_EQ(statusFor(rig, "client2").ended_size(), 0);
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    rig.stopDone(rig.gate.generation());
    rig.take("client2", "r2");
    EXPECT_EQ(statusFor(rig, "client2").ended_size(), 0);
}

TEST_F(Tasks, AnEndTooLargeToKeepIsRememberedWithoutItsResults) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    proto::EiToEm message;
    auto& event = *message.mutable_task()->mutable_event();
    event.set_task_id(idOf("t1"));
    event.set_state(proto::TASK_SUCCEEDED);
    event.add_results()->add_values()->set_str(std::string(100'000, 'x'));
    rig.fromApplication(message);
    EXPECT_EQ(lastOf(rig, "t1").results_size(), 1);
    const auto status = statusFor(rig, "client1");
    ASSERT_EQ(status.ended_size(), 1);
    EXPECT_EQ(status.ended(0).results_size(), 0);
    EXPECT_EQ(status.ended(0).state(), proto::TASK_SUCCEEDED);
}

TEST_F(Tasks, ATaskThatWaitedTooLongIsExpiredBehindOthersAndAfterAStandstill) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.task("client1", "t2", "Turning", {}, 1.0);
    rig.task("client1", "t3", "Turning", {}, 5.0);
    rig.advance(2s);
    EXPECT_EQ(lastOf(rig, "t2").reason().code(), proto::EXPIRED);
    // A reset lets the queue go on once the robot stands, which it does too late.
    rig.reset("client1");
    rig.update("t1", proto::TASK_STOPPED);
    rig.clock.advance(4s);  // nobody has called the timer yet
    rig.stopDone(rig.gate.generation());
    EXPECT_EQ(lastOf(rig, "t3").reason().code(), proto::EXPIRED);
    EXPECT_EQ(dispatches(rig, "t2") + dispatches(rig, "t3"), 0);
}

TEST_F(Tasks, AnApplicationThatDoesNotAnswerAParameterIsNotWaitedFor) {
    rig.setParam("client1", "p1", "Driving", "Speed=300");
    rig.advance(9999ms);
    EXPECT_FALSE(rig.to_clients.back().message.has_reply());
    rig.advance(1ms);
    const auto& reply = rig.to_clients.back().message.reply();
    EXPECT_EQ(reply.request_id(), idOf("p1"));
    EXPECT_EQ(reply.refusal().code(), proto::TIMED_OUT);
    const auto before = rig.to_clients.size();
    proto::EiToEm late;
    late.mutable_answer()->set_request(1);
    rig.fromApplication(late);
    EXPECT_EQ(rig.to_clients.size(), before);
    EXPECT_EQ(rig.core().counters().unexpected, 1U);
}

TEST_F(Tasks, AnApplicationThatDoesNotAnswerATaskIsToldToCancelItAndNothingStartsBesideIt) {
    rig.task("client1", "t1", "Turning");
    rig.task("client1", "t2", "Turning");
    rig.advance(10s);
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_UNKNOWN);
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::TIMED_OUT);
    ASSERT_TRUE(rig.to_application.back().has_cancel());
    EXPECT_EQ(rig.to_application.back().cancel().task_id(), idOf("t1"));
    EXPECT_EQ(dispatches(rig, "t2"), 0);
    rig.deny("t1", "too late");
    EXPECT_EQ(dispatches(rig, "t2"), 1);
    EXPECT_EQ(rig.core().state(), EntityState::REG);
}

TEST_F(Tasks, ATaskThatWasGrantedInTimeIsNotTimedOut) {
    rig.task("client1", "t1", "Turning");
    rig.advance(9s);
    rig.grant("t1");
    rig.advance(60s);
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_RUNNING);
    EXPECT_EQ(rig.core().state(), EntityState::BUSY);
}

TEST_F(Tasks, WhatTheLinkDoesNotTakeIsRefusedToItsSender) {
    rig.frame_max = 1000;
    proto::ToEntity text;
    text.mutable_text()->set_text(std::string(2000, 'x'));
    rig.send("client1", text);
    EXPECT_EQ(rig.to_clients.back().message.reply().refusal().code(), proto::TOO_LARGE);
    const auto before = rig.to_clients.size();
    proto::ToEntity raw;
    raw.mutable_raw()->add_data(std::string(2000, 'x'));
    rig.send("client1", raw);
    ASSERT_EQ(rig.to_clients.size(), before + 1);
    EXPECT_EQ(rig.to_clients.back().message.reply().refusal().code(), proto::TOO_LARGE);
    EXPECT_EQ(rig.core().counters().raw_refused, 1U);
    proto::ToEntity small;
    small.mutable_raw()->add_data("x");
    rig.send("client1", small);
    EXPECT_TRUE(rig.to_application.back().has_raw());
    EXPECT_EQ(rig.to_application.back().raw().data_size(), 1);
}

TEST_F(Tasks, ACopyOfATaskThatWasRefusedDoesNotBeginLater) {
    rig.stop("client2");
    rig.stopDone(1);
    rig.task("client1", "t1", "Turning");
    ASSERT_EQ(lastOf(rig, "t1").reason().code(), proto::LATCHED);
    rig.rearm("client1", "r2");
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::DUPLICATE);
    EXPECT_EQ(dispatches(rig, "t1"), 0);
}

TEST_F(Tasks, WhatIsRefusedToOthersThanTheHolderIsNotRemembered) {
    rig.lease = LeaseNumber{1, 1};
    rig.task("client2", "t1", "Turning");
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(dispatches(rig, "t1"), 1);
}

}  // namespace
}  // namespace axon::entity_manager
