// SPDX-License-Identifier: GPL-2.0-or-later
// Tasks across retries, restarts and losses; what the journal says of them; applications that do not answer.
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>

#include "entity_manager/core/services/task_memory.hpp"
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
    ASSERT_FALSE(rig.journal.mentioned.empty()) << "the audit has it all the same";
    EXPECT_EQ(rig.journal.mentioned.back().kind, Kind::TaskEnded);
    EXPECT_EQ(rig.journal.mentioned.back().code, "TASK_REFUSED");
    EXPECT_EQ(rig.journal.mentioned.back().task.bytes(), idOf("t1"));
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_REFUSED);
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::OVERLOADED);
    EXPECT_FALSE(rig.busy);
    rig.stop("client2");  // a stop does not depend on it
    EXPECT_TRUE(rig.core().latched());
    EXPECT_GT(rig.core().counters().unrecorded, 0U);
}

TEST_F(Tasks, WhatControlsATaskIsMentionedForTheAuditWithTheIdOfItsClientWhateverWayItCame) {
    const auto control = [&](const char* task, proto::TaskAction action) {
        proto::ToEntity message;
        message.mutable_task_control()->set_task_id(idOf(task));
        message.mutable_task_control()->set_action(action);
        rig.send("client1", message);
    };
    const auto id = rig.headOf("client1").sender.id;
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    EXPECT_EQ(rig.journal.records.back().kind, Kind::Dispatched);
    EXPECT_EQ(rig.journal.records.back().client, id);
    auto& mentioned = rig.journal.mentioned;
    mentioned.clear();
    control("t1", proto::CANCEL);
    ASSERT_EQ(mentioned.size(), 1U);
    EXPECT_EQ(mentioned[0].kind, Kind::Controlled);
    EXPECT_EQ(mentioned[0].text, "Cancel");
    EXPECT_EQ(mentioned[0].client, id);
    EXPECT_EQ(mentioned[0].task.bytes(), idOf("t1"));
    control("t2", proto::PAUSE);
    ASSERT_EQ(mentioned.size(), 2U);
    EXPECT_EQ(mentioned[1].kind, Kind::Refused);
    EXPECT_EQ(mentioned[1].client, id);
    EXPECT_EQ(mentioned[1].code, "UNKNOWN_TASK");
}

/// The journal's disk takes its time.
struct SlowJournal : Tasks {
    SlowJournal() { rig.journal.slow = true; }
    void answer() {
        rig.journal.answerAll();
        rig.core().onStored();
    }
    proto::TaskState stateOf(const std::string& task) const { return lastOf(rig, task).state(); }
};

TEST_F(SlowJournal, ATaskBeginsWhenItsEntryIsWrittenAndItsClientIsToldThatItWaits) {
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(dispatches(rig, "t1"), 0);
    EXPECT_FALSE(rig.busy) << "the long watchdog: nothing moves";
    EXPECT_EQ(stateOf("t1"), proto::TASK_UNSPECIFIED) << "mostly it begins at once";
    rig.advance(100ms);
    EXPECT_EQ(stateOf("t1"), proto::TASK_QUEUED);
    EXPECT_EQ(statusFor(rig, "client1").tasks(0).state(), proto::TASK_QUEUED);
    rig.advance(2s);
    EXPECT_EQ(dispatches(rig, "t1"), 0);
    answer();
    EXPECT_EQ(dispatches(rig, "t1"), 1);
    EXPECT_EQ(stateOf("t1"), proto::TASK_DISPATCHED);
    EXPECT_EQ(kinds(rig).back(), "dispatched");
}

TEST_F(SlowJournal, WhatWaitsForAnotherTaskIsToldAtOnceAndWritesNothing) {
    rig.task("client1", "t1", "Turning");
    rig.task("client1", "t2", "Turning");
    EXPECT_EQ(stateOf("t2"), proto::TASK_QUEUED);
    answer();
    EXPECT_EQ(dispatches(rig, "t1"), 1);
    rig.grant("t1");
    answer();
    EXPECT_EQ(dispatches(rig, "t2"), 0);
    EXPECT_EQ(std::count_if(rig.journal.records.begin(), rig.journal.records.end(),
                            [](const auto& record) { return record.kind == Kind::Dispatched; }),
              1);
    rig.update("t1", proto::TASK_SUCCEEDED);
    answer();
    EXPECT_EQ(dispatches(rig, "t2"), 1);
}

TEST_F(SlowJournal, ATaskWhoseEntryCannotBeWrittenIsRefusedAndTheNextOneGoesOn) {
    rig.task("client1", "t1", "Turning");
    rig.task("client1", "t2", "Turning");
    rig.journal.full = true;
    answer();
    EXPECT_EQ(stateOf("t1"), proto::TASK_REFUSED);
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::OVERLOADED);
    rig.journal.full = false;
    answer();
    EXPECT_EQ(dispatches(rig, "t1"), 0);
    EXPECT_EQ(dispatches(rig, "t2"), 1);
}

TEST(SlowJournalAlone, WhateverVoidsTheQueueVoidsTheTaskThatWaitsForItsEntry) {
    const std::vector<std::pair<const char*, std::function<void(CoreRig&)>>> ways{
        {"stop", [](CoreRig& rig) { rig.stop("client2"); }},
        {"clear", [](CoreRig& rig) { rig.clear("client1"); }},
        {"cancel",
         [](CoreRig& rig) {
             proto::ToEntity cancel;
             cancel.mutable_task_control()->set_task_id(idOf("t1"));
             cancel.mutable_task_control()->set_action(proto::CANCEL);
             rig.send("client1", cancel);
         }},
        {"release",
         [](CoreRig& rig) {
             proto::ToEntity release;
             release.mutable_release();
             rig.send("client1", release);
         }},
        {"loss of the client",
         [](CoreRig& rig) {
             Header head;
             head.sender = {"client1", "client1@lab", Role::Operator};
             rig.core().onClientUpdate(head, ClientChange::Lost);
         }},
        {"loss of the server", [](CoreRig& rig) { rig.core().onServerDown("gone"); }},
        {"loss of the link", [](CoreRig& rig) { rig.core().onLinkDown("gone"); }},
        {"not_after", [](CoreRig& rig) { rig.advance(2s); }},
    };
    for (const auto& [name, happens] : ways) {
        SCOPED_TRACE(name);
        CoreRig rig;
        rig.makeIdle();
        rig.take("client1", "r1");
        rig.journal.slow = true;
        rig.task("client1", "t1", "Turning", {}, name == std::string("not_after") ? 1 : 0);
        happens(rig);
        const auto answer = [&] {
            rig.journal.answerAll();
            rig.core().onStored();
        };
        answer();
        rig.stopDone(rig.stop_generations.generation());
        rig.rearm("client1", "rearm");
        answer();
        EXPECT_EQ(dispatches(rig, "t1"), 0);
        // The entry was written, and so is how it ended: a next life does not think that it ran.
        ASSERT_TRUE(std::any_of(rig.journal.records.begin(), rig.journal.records.end(),
                                [](const auto& record) { return record.kind == Kind::TaskEnded; }));
    }
}

TEST_F(SlowJournal, AStopThatIsOnItsWayAsTheEntryIsWrittenLetsNothingBegin) {
    rig.task("client1", "t1", "Turning");
    rig.stop_generations.raise("client2",
                               1);  // the signal thread has passed it on, the strand does not know it
    answer();
    EXPECT_EQ(dispatches(rig, "t1"), 0);
}

TEST_F(SlowJournal, KilledBeforeTheEntryIsWrittenItMayBeSentAgainAndAfterwardsItMayNot) {
    rig.task("client1", "t1", "Turning");
    rig.journal.slow = false;  // what was not written is lost
    newLife();
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(dispatches(rig, "t1"), 1);
    newLife();
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(dispatches(rig, "t1"), 1);
    EXPECT_EQ(stateOf("t1"), proto::TASK_UNKNOWN);
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
    rig.stopDone(rig.stop_generations.generation());
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
    rig.stopDone(rig.stop_generations.generation());
    EXPECT_EQ(lastOf(rig, "t3").reason().code(), proto::EXPIRED);
    EXPECT_EQ(dispatches(rig, "t2") + dispatches(rig, "t3"), 0);
}

TEST_F(Tasks, WhatIsGivenWithATaskIsToBeAskedForWhatWasSetBeforeIsNot) {
    rig.task("client1", "t1", "Driving", {"Distance=500"});
    ASSERT_TRUE(rig.to_application.back().has_task());
    const auto& dispatch = rig.to_application.back().task();
    EXPECT_EQ(dispatch.params_size(), 2) << "Speed has a value of its own";
    ASSERT_EQ(dispatch.given_size(), 1);
    EXPECT_EQ(dispatch.given(0).service(), "Driving");
    EXPECT_EQ(dispatch.given(0).param().name(), "Distance");
    EXPECT_EQ(dispatch.given(0).param().values_size(), 0) << "it is among params already";
    rig.deny("t1", "parameter 'Distance' of 'Driving': there is a wall");
    EXPECT_EQ(lastOf(rig, "t1").state(), proto::TASK_REFUSED);
    EXPECT_EQ(lastOf(rig, "t1").reason().message(), "parameter 'Distance' of 'Driving': there is a wall");
}

struct SavableValues : Tasks {
    /// What a client sets and the application grants.
    void set(const std::string& service, const std::string& param) {
        rig.setParam("client1", "p", service, param);
        answer();
    }
    void answer() {
        proto::EiToEm granted;
        granted.mutable_answer()->set_request(rig.to_application.back().param().request());
        rig.fromApplication(granted);
        ASSERT_FALSE(rig.to_clients.empty());
    }
    /// The present record, as everybody is told it.
    proto::EntityStatus status() {
        proto::ToEntity message;
        message.mutable_status_request()->set_request_id(idOf("status"));
        message.mutable_status_request()->set_with_services(true);
        rig.send("client2", message);
        return rig.to_clients.back().message.status();
    }
    std::string speed() {
        const auto now = status();
        for (const auto& param : now.services(0).params())
            if (param.name() == "Speed")
                return param.ready() ? std::to_string(param.initial(0).int_()) + param.units() : "none";
        return "not there";
    }
    /// The application is started again, with this services profile.
    void relink(const std::string& services = test::kRigServicesProfile) {
        rig.core().onLinkDown("the application was restarted");
        rig.linkUp();
        rig.upload(false, test::kRigBasicProfile);
        rig.upload(true, services);
        if (rig.core().state() != EntityState::IDLE) return;
        rig.take("client1", "r2");
        rig.rearm("client1", "rearm");  // a link that was lost while it was held has latched it
    }
    /// Likewise, with one text in place of another throughout the profile.
    void change(const std::string& from, const std::string& to) {
        std::string xml = test::kRigServicesProfile;
        for (auto at = xml.find(from); at != std::string::npos; at = xml.find(from, at + to.size()))
            xml.replace(at, from.size(), to);
        relink(xml);
    }
};

TEST_F(SavableValues, SurviveANewLinkTheProfileReadAnewAndARestart) {
    set("Driving", "Speed=300");
    set("Driving", "Distance=700");  // not savable
    ASSERT_EQ(speed(), "300mm/s");
    relink();
    EXPECT_EQ(speed(), "300mm/s");
    EXPECT_FALSE(status().services(0).params(0).ready()) << "Distance is not savable";
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    rig.stopDone(rig.stop_generations.generation());
    rig.uploadProfiles();
    EXPECT_EQ(speed(), "300mm/s");
    rig.restart();
    rig.makeIdle();
    EXPECT_EQ(speed(), "300mm/s");
    EXPECT_EQ(status().findings_size(), 0);
    EXPECT_EQ(rig.core().takeWarning(), "");
    rig.take("client1", "r3");
    rig.rearm("client1", "rearm");
    rig.task("client1", "t1", "Driving", {"Distance=1"});
    ASSERT_EQ(dispatches(rig, "t1"), 1);
    EXPECT_EQ(rig.to_application.back().task().params(1).values(0).int_(), 300);
    EXPECT_EQ(rig.to_application.back().task().given_size(), 1) << "it was asked for when it was set";
}

TEST_F(SavableValues, SurviveAProfileThatStillAdmitsThem) {
    set("Driving", "Speed=300");
    change("value=\"200\" savable", "value=\"100\" maximum=\"400\" savable");
    EXPECT_EQ(speed(), "300mm/s");
    EXPECT_EQ(status().findings_size(), 0);
}

TEST_F(SavableValues, AreDroppedByAProfileThatDoesNotAdmitThemAndItIsSaid) {
    const std::pair<const char*, const char*> changes[] = {
        {"value=\"200\" savable", "value=\"100\" maximum=\"250\" savable"},
        {"units=\"mm/s\" value=\"200\"", "units=\"m/s\" value=\"100\""},
        {"type=\"CONFIG\" data_type=\"INT\" units=\"mm/s\" value=\"200\" savable=\"true\"",
         "type=\"INPUT\" data_type=\"INT\" units=\"mm/s\" value=\"100\""},
        {"data_type=\"INT\" units=\"mm/s\" value=\"200\"", "data_type=\"BOOL\" value=\"true\""}};
    for (const auto& [from, to] : changes) {
        SCOPED_TRACE(to);
        set("Driving", "Speed=300");
        ASSERT_EQ(status().findings_size(), 0);
        change(from, to);
        EXPECT_NE(speed(), "300mm/s");
        const auto told = status();
        ASSERT_EQ(told.findings_size(), 1);
        EXPECT_NE(told.findings(0).message().find(
                      "the saved value 300 mm/s of parameter \"Speed\" of \"Driving\" was dropped: "),
                  std::string::npos)
            << told.findings(0).message();
        EXPECT_EQ(rig.core().takeWarning(), told.findings(0).message());
        relink();
        EXPECT_EQ(speed(), "200mm/s") << "what was dropped does not come back";
    }
}

TEST_F(SavableValues, AreDroppedWithTheirServiceAndStayDroppedInTheNextLife) {
    set("Driving", "Speed=300");
    change("\"Driving\"", "\"driving\"");
    EXPECT_EQ(status().services(0).params(1).initial(0).int_(), 200);
    ASSERT_EQ(status().findings_size(), 1);
    rig.restart();
    rig.makeIdle();
    EXPECT_EQ(speed(), "200mm/s");
    EXPECT_EQ(status().findings_size(), 0) << "nothing was dropped in this life";
}

TEST_F(SavableValues, StayWhileAProfileIsBroken) {
    set("Driving", "Speed=300");
    change("<Service name=\"Turning\"", "<Service");
    EXPECT_EQ(rig.core().state(), EntityState::ERR);
    relink();
    EXPECT_EQ(speed(), "300mm/s");
}

TEST_F(SavableValues, ThatAreNotGrantedAreNotKept) {
    rig.setParam("client1", "p", "Driving", "Speed=300");
    proto::EiToEm denied;
    denied.mutable_answer()->set_request(rig.to_application.back().param().request());
    denied.mutable_answer()->mutable_refusal()->set_code(proto::DENIED);
    rig.fromApplication(denied);
    rig.restart();
    rig.makeIdle();
    EXPECT_EQ(speed(), "200mm/s");
}

TEST_F(SavableValues, ThatAreDamagedOnTheDiskAreSaidToBeLost) {
    set("Driving", "Speed=300");
    rig.storage.values["values"] = "\xff\xff";
    rig.restart();
    EXPECT_NE(rig.core().takeWarning(), "");
    rig.makeIdle();
    EXPECT_EQ(speed(), "200mm/s");
    EXPECT_EQ(status().findings_size(), 1);
}

struct ConfigParameters : SavableValues {
    ConfigParameters() {
        declare(R"(<Param name="Route" type="CONFIG" data_type="STR" multiple="true" required="true"/>)"
                R"(<Param name="Notes" type="CONFIG" data_type="STR" multiple="true" savable="false"/>)"
                R"(<Param name="Words" type="INPUT" data_type="STR" multiple="true"/>)"
                R"(<Param name="Remarks" type="INPUT" data_type="STR" multiple="true" savable="true"/>)");
    }
    /// As the parameters of the service Light, which is the profile's only one then.
    void declare(const std::string& params) {
        relink(R"(<ServiceProfile><Service name="Light" type="SMPL" blocking="false"><Parameters>)" + params +
               "</Parameters></Service></ServiceProfile>");
    }
    /// So many texts of 64 KiB.
    static proto::Param longValue(const std::string& name, int texts) {
        proto::Param param;
        param.set_name(name);
        for (int i = 0; i < texts; ++i) param.add_values()->set_str(std::string(65536, 'x'));
        return param;
    }
    /// Asks for it; what the application grants it with.
    proto::EiToEm ask(const proto::Param& param) {
        proto::ToEntity message;
        message.mutable_set_param()->set_request_id(idOf("p"));
        message.mutable_set_param()->set_service("Light");
        *message.mutable_set_param()->mutable_param() = param;
        rig.send("client1", message);
        proto::EiToEm granted;
        granted.mutable_answer()->set_request(rig.to_application.back().param().request());
        return granted;
    }
    proto::RefusalCode setLong(const std::string& name, int texts) { return setLong(longValue(name, texts)); }
    proto::RefusalCode setLong(const proto::Param& param) {
        rig.fromApplication(ask(param));
        for (auto at = rig.to_clients.rbegin(); at != rig.to_clients.rend(); ++at)
            if (at->message.has_reply()) return at->message.reply().refusal().code();
        return proto::INTERNAL;
    }
    std::string taskWith(const std::string& id, const proto::Param& param) {
        proto::ToEntity message;
        message.mutable_task()->set_task_id(idOf(id));
        message.mutable_task()->set_service("Light");
        *message.mutable_task()->add_params() = param;
        rig.send("client1", message);
        return proto::TaskState_Name(lastOf(rig, id).state());
    }
    /// What the application was told of its configuration since the test looked last.
    std::vector<proto::Configuration> told() {
        std::vector<proto::Configuration> all;
        for (; looked < rig.to_application.size(); ++looked)
            if (rig.to_application[looked].has_configuration())
                all.push_back(rig.to_application[looked].configuration());
        return all;
    }
    std::size_t looked = 0;
};

TEST_F(ConfigParameters, AreToldBeforeAnyTaskWithTheUnitsOfTheProfileOthersAreNot) {
    relink();
    const auto all = told();
    ASSERT_EQ(all.size(), 2U) << "one for each link that had any: those of this fixture have no value yet";
    ASSERT_EQ(all.back().params_size(), 1);
    EXPECT_EQ(all.back().params(0).service(), "Driving");
    EXPECT_EQ(all.back().params(0).param().name(), "Speed");
    EXPECT_EQ(all.back().params(0).param().units(), "mm/s");
    EXPECT_EQ(all.back().params(0).param().values(0).int_(), 200);
    set("Driving", "Distance=700");
    EXPECT_TRUE(told().empty()) << "an INPUT";
    set("driving", "Speed=300");
    const auto then = told();
    ASSERT_EQ(then.size(), 1U);
    EXPECT_EQ(then[0].params(0).service(), "Driving");
    EXPECT_EQ(then[0].params(0).param().units(), "mm/s") << "of the profile, where the client names none";
    EXPECT_EQ(then[0].task_id(), "");
}

TEST_F(ConfigParameters, ThatWereAskedForBeforeAStopReachNoTaskAfterIt) {
    const auto granted = ask(longValue("Notes", 1));
    rig.stop("client1");
    rig.stopDone(rig.core().status().stop_generation);
    rig.rearm("client1", "a");
    set("Light", "Route=a");
    EXPECT_EQ(taskWith("t1", longValue("Words", 1)), "TASK_DISPATCHED");
    rig.grant("t1");
    static_cast<void>(told());

    rig.fromApplication(granted);
    EXPECT_TRUE(told().empty());
    EXPECT_EQ(rig.to_clients.back().message.reply().refusal().code(), proto::OLD_GENERATION);
    EXPECT_FALSE(status().services(0).params(1).ready());
}

TEST_F(ConfigParameters, ThatAreRequiredAreSetOnceAndForAll) {
    EXPECT_EQ(taskWith("t1", longValue("Words", 1)), "TASK_REFUSED");
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::MISSING_DEPENDENCY);
    set("Light", "Route=a");
    for (const std::string task : {"t2", "t3"}) {
        EXPECT_EQ(taskWith(task, longValue("Words", 1)), "TASK_DISPATCHED");
        rig.update(task, proto::TASK_SUCCEEDED);
    }
    EXPECT_EQ(status().services(0).missing_size(), 0);
}

TEST_F(ConfigParameters, AreKeptWhateverTheProfileSaysOfSavable) {
    set("Light", "Notes=a");
    declare(R"(<Param name="Notes" type="CONFIG" data_type="STR" multiple="true" savable="false"/>)");
    const auto param = status().services(0).params(0);
    EXPECT_TRUE(param.savable());
    ASSERT_EQ(param.initial_size(), 1);
    EXPECT_EQ(param.initial(0).str(), "a");
}

TEST_F(ConfigParameters, AreRefusedWhereTheyCouldNotBeKept) {
    EXPECT_EQ(setLong("Route", 10), proto::OK);
    static_cast<void>(told());
    EXPECT_EQ(setLong("Notes", 6), proto::TOO_LARGE) << "with the other one it is more than 1 MiB";
    EXPECT_TRUE(told().empty());
    EXPECT_FALSE(status().services(0).params(1).ready());
    EXPECT_EQ(setLong("Route", 12), proto::OK) << "in its own place";
    EXPECT_EQ(setLong("Notes", 3), proto::OK);
    static_cast<void>(told());
    declare(R"(<Param name="Route" type="CONFIG" data_type="STR" multiple="true"/>)"
            R"(<Param name="Notes" type="CONFIG" data_type="STR" multiple="true"/>)");
    int params = 0;
    for (const auto& one : told()) params += one.params_size();
    EXPECT_EQ(params, 2);
}

TEST_F(ConfigParameters, TakeTheRoomOfSavedINPUTsWhichAreSaidNotToBeKept) {
    /// Texts that are there in the next life.
    const auto restarted = [&](const std::string& name) {
        const std::string profile =
            R"(<ServiceProfile><Service name="Light" type="SMPL" blocking="false"><Parameters>)"
            R"(<Param name="Route" type="CONFIG" data_type="STR" multiple="true"/>)"
            R"(<Param name="Remarks" type="INPUT" data_type="STR" multiple="true" savable="true"/>)"
            "</Parameters></Service></ServiceProfile>";
        rig.restart();
        rig.linkUp();
        rig.upload(false, test::kRigBasicProfile);
        rig.upload(true, profile);
        rig.core().onServerUp();
        rig.take("client1", "next");
        rig.rearm("client1", "again");
        const auto now = status();
        for (const auto& param : now.services(0).params())
            if (param.name() == name) return param.initial_size();
        return -1;
    };
    EXPECT_EQ(setLong("Remarks", 10), proto::OK);
    EXPECT_EQ(status().findings_size(), 0);
    EXPECT_EQ(setLong("Route", 10), proto::OK);
    const auto told = status();
    ASSERT_EQ(told.findings_size(), 1);
    EXPECT_NE(told.findings(0).message().find("the value of parameter \"Remarks\" of \"Light\" is lost"),
              std::string::npos)
        << told.findings(0).message();
    EXPECT_EQ(setLong("Notes", 6), proto::TOO_LARGE) << "CONFIG values have the room among themselves";

    EXPECT_EQ(setLong("Route", 5), proto::OK);
    EXPECT_EQ(status().findings_size(), 0) << "there is room again";
    EXPECT_EQ(restarted("Remarks"), 10);
    EXPECT_EQ(setLong("Route", 12), proto::OK) << "also of those that an earlier life has saved";
    EXPECT_EQ(restarted("Route"), 12);
    EXPECT_EQ(restarted("Remarks"), 0);
    EXPECT_EQ(setLong("Remarks", 10), proto::OK) << "it counts for as long as this process lives";
    EXPECT_EQ(status().findings_size(), 1);
    EXPECT_EQ(restarted("Route"), 12);
}

TEST_F(ConfigParameters, AreRefusedWhereATaskThatWaitsCouldNotBeSentWithThem) {
    set("Light", "Route=a");
    EXPECT_EQ(taskWith("t1", longValue("Words", 8)), "TASK_DISPATCHED");
    rig.grant("t1");
    EXPECT_EQ(taskWith("t2", longValue("Words", 8)), "TASK_QUEUED");
    EXPECT_EQ(setLong("Route", 8), proto::TOO_LARGE);
    EXPECT_EQ(setLong("Route", 3), proto::OK) << "there is room for this";
    rig.update("t1", proto::TASK_SUCCEEDED);
    ASSERT_EQ(dispatches(rig, "t2"), 1);
    EXPECT_EQ(rig.to_application.back().task().params(0).values_size(), 3);
    rig.grant("t2");
    EXPECT_EQ(setLong("Route", 8), proto::OK) << "a running one is not sent again";
}

TEST_F(ConfigParameters, AreTakenUpToTheLastByteThatATaskThatWaitsHasRoomFor) {
    EXPECT_EQ(setLong("Route", 6), proto::OK);
    EXPECT_EQ(taskWith("t1", longValue("Words", 8)), "TASK_DISPATCHED");
    rig.grant("t1");
    EXPECT_EQ(taskWith("t2", longValue("Words", 8)), "TASK_QUEUED");
    EXPECT_EQ(setLong("Route", 7), proto::OK) << "in the place of the 6";

    auto route = longValue("Route", 8);
    const auto setLast = [&](std::size_t bytes) {
        route.mutable_values(7)->set_str(std::string(bytes, 'x'));
        return setLong(route);
    };
    std::size_t taken = 0;
    std::size_t refused = 65536;
    while (refused - taken > 1) {
        const auto between = (taken + refused) / 2;
        (setLast(between) == proto::OK ? taken : refused) = between;
    }
    ASSERT_EQ(setLast(taken), proto::OK);
    const auto task = longValue("Words", 8);
    EXPECT_EQ(taskWith("t3", task), "TASK_QUEUED") << "what is set is also admitted";
    EXPECT_EQ(setLast(refused), proto::TOO_LARGE);

    rig.update("t1", proto::TASK_SUCCEEDED);
    ASSERT_EQ(dispatches(rig, "t2"), 1);
    const auto sent = rig.to_application.back().ByteSizeLong();
    EXPECT_LE(sent, rig.frame_max - 64);
    EXPECT_GE(sent, rig.frame_max - 64 - 32);
}

TEST_F(ConfigParameters, AreTakenWhateverTheirLengthByTasksThatHaveNoUseForThem) {
    const std::string route = R"(<Param name="Route" type="CONFIG" data_type="STR" multiple="true"/>)";
    const std::string words = R"(<Param name="Words" type="INPUT" data_type="STR" multiple="true"/>)";
    relink(
        R"(<ServiceProfile><Service name="Light" type="SMPL" blocking="false"><Parameters>)" + route + words +
        R"(</Parameters></Service><Service name="Tour" type="CMPLX" blocking="false"><Parameters>)" + route +
        R"(</Parameters><Services><ServiceRef name="Light"/></Services></Service></ServiceProfile>)");
    rig.setParam("client1", "p", "Tour", "Route=a");
    answer();
    const auto tour = [&](const std::string& id) {
        proto::ToEntity message;
        message.mutable_task()->set_task_id(idOf(id));
        message.mutable_task()->set_service("Tour");
        *message.mutable_task()->add_params() = longValue("Light.Words", 7);
        rig.send("client1", message);
        return proto::TaskState_Name(lastOf(rig, id).state());
    };
    EXPECT_EQ(tour("t1"), "TASK_DISPATCHED");
    EXPECT_EQ(tour("t2"), "TASK_QUEUED");
    EXPECT_EQ(setLong("Route", 12), proto::OK) << "the value of the composite counts for its part";
}

TEST_F(ConfigParameters, AreRefusedWhereTheLastPartOfACompositeCouldNotBeginWithThem) {
    relink(
        R"(<ServiceProfile><Service name="Light" type="SMPL" blocking="false" pausable="true"><Parameters>)"
        R"(<Param name="Route" type="CONFIG" data_type="STR" multiple="true"/>)"
        R"(<Param name="Words" type="INPUT" data_type="STR" multiple="true"/>)"
        R"(</Parameters></Service><Service name="Tour" type="CMPLX" blocking="false" pausable="true">)"
        R"(<Services><ServiceRef name="Light"/><ServiceRef name="Light"/></Services></Service>)"
        "</ServiceProfile>");
    EXPECT_EQ(setLong("Words", 6), proto::OK);
    rig.task("client1", "t1", "Tour");
    rig.grant("part1");
    proto::ToEntity pause;
    pause.mutable_task_control()->set_task_id(idOf("t1"));
    pause.mutable_task_control()->set_action(proto::PAUSE);
    rig.send("client1", pause);
    rig.update("part1", proto::TASK_SUCCEEDED);  // before it could pause, so that the second waits
    EXPECT_EQ(setLong("Route", 10), proto::TOO_LARGE);
    EXPECT_EQ(setLong("Route", 9), proto::OK) << "the first part is not sent again";
    pause.mutable_task_control()->set_action(proto::RESUME);
    rig.send("client1", pause);
    EXPECT_EQ(rig.to_application.back().task().params(1).values_size(), 9);
}

struct Urls : SavableValues {
    /// The profile's one resource, with these attributes beside its name and `required`.
    void declare(const std::string& attributes) {
        const std::string old = "name=\"Map\" required=\"true\" savable=\"false\"";
        change(old, "name=\"Map\" required=\"true\" " + attributes);
    }
    proto::Resource map() { return status().services(4).resources(0); }
    void deliver(const std::string& id) { rig.task("client1", id, "Delivery", {"Room=Lab"}); }
    std::vector<std::string> findings() {
        std::vector<std::string> all;
        const auto told = status();
        for (const auto& finding : told.findings()) all.push_back(finding.message());
        return all;
    }
};

TEST_F(Urls, WhatTheProfileDeclaresReadyIsThereWithItsPathAndSize) {
    rig.resources.files["/profiles/maps/lab.map"] = 1234;
    declare("url=\"maps/lab.map\" ready=\"true\" savable=\"true\"");
    EXPECT_TRUE(map().ready());
    EXPECT_EQ(map().size(), 1234U);
    EXPECT_TRUE(findings().empty());
    deliver("t1");
    ASSERT_EQ(dispatches(rig, "t1"), 1);
    EXPECT_EQ(rig.to_application.back().task().resources(0).url(), "/profiles/maps/lab.map");
}

TEST_F(Urls, WhatTheProfileDeclaresReadyAndIsNotThereIsSaidAndComesWhenItIsPutThere) {
    declare("url=\"maps/lab.map\" ready=\"true\" savable=\"true\"");
    EXPECT_NE(rig.core().takeWarning(), "");
    EXPECT_FALSE(map().ready());
    EXPECT_EQ(findings(), std::vector<std::string>{"resource \"Map\" of \"Delivery\" is declared ready, and "
                                                   "there is no file \"/profiles/maps/lab.map\""});
    deliver("t1");
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::MISSING_DEPENDENCY);
    rig.resources.files["/profiles/maps/lab.map"] = 5;
    deliver("t2");
    EXPECT_EQ(lastOf(rig, "t2").state(), proto::TASK_DISPATCHED);
    EXPECT_TRUE(findings().empty());
}

TEST_F(Urls, AFileThatIsGoneIsNoLongerReadyAndItsTaskIsRefused) {
    rig.resources.files["/profiles/lab.map"] = 1;
    declare("url=\"lab.map\" savable=\"true\"");
    EXPECT_TRUE(map().ready()) << "savable: it is there";
    rig.resources.files.clear();
    deliver("t1");
    EXPECT_EQ(lastOf(rig, "t1").reason().code(), proto::MISSING_DEPENDENCY);
    EXPECT_EQ(dispatches(rig, "t1"), 0);
    EXPECT_FALSE(map().ready());
}

TEST_F(Urls, WhatMustBeGivenEachTimeIsNotReadyBecauseAFileIsThere) {
    rig.resources.files["/profiles/lab.map"] = 1;
    declare("url=\"lab.map\" savable=\"false\"");
    EXPECT_FALSE(map().ready());
    EXPECT_TRUE(findings().empty());
}

TEST_F(Urls, AnAbsoluteOneThatIsNotPermittedIsSaidEvenWhereNothingIsDeclaredReady) {
    declare("url=\"/srv/lab.map\"");
    ASSERT_EQ(findings().size(), 1U);
    EXPECT_NE(findings()[0].find("cannot be used: It is not permitted."), std::string::npos);
}

TEST_F(Urls, ReadyWithoutAUrlAndWithoutAnUploadIsSaid) {
    declare("ready=\"true\"");
    EXPECT_FALSE(map().ready());
    ASSERT_EQ(findings().size(), 1U);
    EXPECT_NE(findings()[0].find("it has no url"), std::string::npos);
}

TEST_F(Urls, AreLookedForBeforeTheEntityAppearsAndNobodyWaitsForTheDisk) {
    rig.resources.slow = true;
    rig.resources.files["/profiles/lab.map"] = 1;
    declare("url=\"lab.map\" ready=\"true\" savable=\"true\"");
    EXPECT_EQ(rig.core().state(), EntityState::INIT);
    rig.core().onLinkDown("the application was restarted once more");
    rig.resources.answerAll();
    rig.core().onStored();
    EXPECT_EQ(rig.core().state(), EntityState::UNAV) << "an answer about the link before";
    declare("url=\"lab.map\" ready=\"true\" savable=\"true\"");
    rig.resources.answerAll();
    rig.core().onStored();
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    rig.resources.slow = false;
    EXPECT_TRUE(map().ready());
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
