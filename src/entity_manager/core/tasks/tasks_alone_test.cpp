// SPDX-License-Identifier: GPL-2.0-or-later
// Tasks from the request to the end, without the rest of the Entity Manager. What stops, losses and runs mean
// for them together with it is claimed in tasks_test.cpp, client_loss_test.cpp and composite_tasks_test.cpp.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "entity_manager/core/tasks/tasks.hpp"
#include "messages/values.hpp"
#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::IsEmpty;

/// Driving blocks; the others run side by side, and Looking goes on without its client for a while.
proto::ServicesProfile someServices() {
    proto::ServicesProfile profile;
    for (const auto* name : {"Driving", "Looking", "Singing"}) {
        auto& service = *profile.add_services();
        service.set_name(name);
        service.set_is_active(true);
        service.set_is_blocking(std::string_view(name) == "Driving");
        if (std::string_view(name) != "Looking") continue;
        service.set_on_client_loss(proto::FINISH_TASK);
        service.set_max_duration_s(20);
    }
    return profile;
}

struct NotingBackEnd final : BackEndPort {
    bool send(const proto::EmToEi&) override { return true; }
    void stop(std::uint32_t, StopCause) override {}
    void setBusy(bool busy) override { told.push_back(busy); }
    std::vector<bool> told;
};

/// What the run, the profiles and the uploads would say.
struct NotingOthers final : Tasks::Others {
    bool takesPart() const override { return in_run; }
    bool isReserved() const override { return in_run; }
    bool tellStep(proto::TaskEvent& event) override {
        if (in_run) steps.push_back(event.state());
        return in_run;
    }
    void lookAgain() override {}
    void removeResource(const std::string&, const std::string&) override {}
    bool in_run = false;
    std::vector<proto::TaskState> steps;
};

struct TheTasks : testing::Test {
    TheTasks() {
        profiler.load(someServices(), "self", {});
        turn.lease.emplace();
        turn.lease->number = {1, 1};
        turn.lease->holder = {"client", "Ada", Role::Operator};
        turn.on_fire = [this](Incident& incident) {
            switch (incident.event) {
                case Event::TaskGranted:
                    turn.in_state = EntityState::BUSY;
                    break;
                case Event::LastTaskEnded:
                    turn.in_state = EntityState::REG;
                    tasks.dispatchNext();
                    break;
                case Event::TaskEnded:
                case Event::ApplicationReady:
                    tasks.dispatchNext();
                    break;
                case Event::ClientLost:
                    turn.in_state = EntityState::REG;
                    tasks.end(incident, proto::TASK_STOPPED, true);
                    break;
                default:
                    break;
            }
        };
    }
    static Id128 idOf(char name) { return *Id128::fromBytes(std::string(16, name)); }
    RefusalCode admit(char name, const std::string& service, double not_after_s = 0) {
        proto::TaskRequest request;
        request.set_task_id(idOf(name).bytes());
        request.set_service(service);
        request.set_not_after_s(not_after_s);
        return tasks.admit(request, 0).code;
    }
    void grant(char name) {
        proto::TaskAnswer answer;
        answer.set_task_id(idOf(name).bytes());
        tasks.answered(answer);
    }
    void report(char name, proto::TaskState state) {
        proto::TaskEvent event;
        event.set_task_id(idOf(name).bytes());
        event.set_state(state);
        tasks.updated(event);
    }
    /// The names of what the application has been given since it was asked last.
    std::string dispatched() {
        std::string names;
        for (const auto& message : std::exchange(turn.to_application, {}))
            if (message.has_task()) names += message.task().task_id()[0];
        return names;
    }
    /// What the holder was told of this task last.
    proto::TaskState stateOf(char name) const {
        for (auto told = turn.told.rbegin(); told != turn.told.rend(); ++told)
            if (told->message.task().task_id() == idOf(name).bytes()) return told->message.task().state();
        return proto::TASK_UNSPECIFIED;
    }
    /// As the signal thread and then the strand do it.
    void stop() {
        turn.stopped.generation = stop_generations.raise();
        turn.stopped.standing = false;
        Incident stopped{Event::Stop};
        stopped.reason = {RefusalCode::Stopped, "Stopped.", {}};
        turn.in_state = EntityState::REG;
        tasks.end(stopped, proto::TASK_STOPPED, true);
        tasks.voidQueue(stopped);
    }

    SeededRandom random{1};
    test::FakeTurn turn;
    test::MemoryJournal noted;
    test::MemoryResources store;
    JournalWriter journal{turn, &noted};
    NotingBackEnd back_end;
    NotingOthers others;
    StopGenerations stop_generations;
    ServiceProfiler profiler;
    TaskMemory memory;
    Tasks tasks{turn,   others,   journal, back_end,    store, stop_generations,
                random, profiler, memory,  {3, 5s, 10s}};
};

TEST_F(TheTasks, WaitInTheOrderOfTheirArrivalBehindWhatExcludesThem) {
    admit('a', "Driving");
    admit('b', "Looking");
    admit('c', "Singing");
    EXPECT_EQ(dispatched(), "a");
    EXPECT_EQ(stateOf('b'), proto::TASK_QUEUED);
    grant('a');
    report('a', proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched(), "bc") << "these exclude each other no longer";
}

TEST_F(TheTasks, AreHeldBackByAnEarlierOneThatMustWait) {
    admit('a', "Looking");
    admit('b', "Driving");
    admit('c', "Singing");
    EXPECT_EQ(dispatched(), "a") << "or the blocking one might wait for ever";
    grant('a');
    report('a', proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched(), "b");
}

TEST_F(TheTasks, OfOneServiceDoNotRunSideBySide) {
    admit('a', "Looking");
    admit('b', "Looking");
    EXPECT_EQ(dispatched(), "a");
    EXPECT_EQ(tasks.waiting(), 1U);
}

TEST_F(TheTasks, AreRefusedWhereTheQueueIsFullOrTheirIdIsKnown) {
    for (const auto name : {'a', 'b', 'c', 'd'}) EXPECT_EQ(admit(name, "Driving"), RefusalCode::Ok);
    EXPECT_EQ(admit('e', "Driving"), RefusalCode::QueueFull) << "one has begun, three wait";
    EXPECT_EQ(admit('a', "Driving"), RefusalCode::Duplicate);
}

TEST_F(TheTasks, AreNotDispatchedWhileLatchedUnlinkedUnheldOrBeforeTheRobotStands) {
    const auto lease = turn.lease;
    const auto staysQueued = [this](char name) {
        admit(name, "Driving");
        return dispatched().empty();
    };
    turn.latch = true;
    EXPECT_TRUE(staysQueued('a'));
    turn.latch = false;
    turn.link = false;
    EXPECT_TRUE(staysQueued('b'));
    turn.link = true;
    turn.stopped.standing = false;
    EXPECT_TRUE(staysQueued('c'));
    turn.stopped.standing = true;
    turn.lease.reset();
    tasks.dispatchNext();
    EXPECT_EQ(dispatched(), "");
    turn.lease = lease;
    tasks.dispatchNext();
    EXPECT_EQ(dispatched(), "a");
}

TEST_F(TheTasks, AreNotDispatchedUnderAnOlderGenerationThanTheSignalThreadHasRaised) {
    turn.stopped.standing = false;
    admit('a', "Driving");
    turn.stopped.standing = true;
    turn.stopped.generation = stop_generations.raise();
    turn.stopped.all_handled = false;
    tasks.restamp();
    tasks.dispatchNext();
    EXPECT_EQ(dispatched(), "") << "a stop that may void it is under way";
    turn.stopped.all_handled = true;
    tasks.restamp();
    tasks.dispatchNext();
    EXPECT_EQ(dispatched(), "a") << "it was one that does not void it";
}

TEST_F(TheTasks, BeginAfterTheirEntryIsInTheJournal) {
    noted.slow = true;
    admit('a', "Driving");
    EXPECT_EQ(dispatched(), "");
    noted.answerAll();
    tasks.dispatchNext();
    EXPECT_EQ(dispatched(), "a");
    ASSERT_EQ(noted.records.size(), 1U);
    EXPECT_EQ(noted.records[0].kind, JournalRecord::Kind::Dispatched);
    EXPECT_EQ(noted.records[0].task, idOf('a'));
}

TEST_F(TheTasks, DoNotBeginWhereTheJournalTakesNoEntry) {
    noted.full = true;
    admit('a', "Driving");
    EXPECT_EQ(dispatched(), "");
    EXPECT_EQ(stateOf('a'), proto::TASK_REFUSED);
}

TEST_F(TheTasks, ThatTheDiskHoldsUpAreToldToWaitAfterAMoment) {
    noted.slow = true;
    admit('a', "Driving");
    EXPECT_EQ(stateOf('a'), proto::TASK_UNSPECIFIED);
    EXPECT_EQ(tasks.nextDeadline(), turn.now() + 100ms);
    turn.clock.advance(100ms);
    tasks.onTimer();
    EXPECT_EQ(stateOf('a'), proto::TASK_QUEUED);
}

TEST_F(TheTasks, ThatWaitLongerThanTheyMayAreRefused) {
    admit('a', "Driving");
    admit('b', "Driving", 2.0);
    grant('a');
    EXPECT_EQ(tasks.nextDeadline(), turn.now() + 2s);
    turn.clock.advance(2s);
    tasks.onTimer();
    EXPECT_EQ(stateOf('b'), proto::TASK_REFUSED);
    EXPECT_EQ(toRefusal(turn.told.back().message.task().reason()).code, RefusalCode::Expired);
}

TEST_F(TheTasks, ThatTheApplicationDoesNotAnswerAreCancelledAndExcludeOthersUntilTheyEndThere) {
    admit('a', "Driving");
    admit('b', "Driving");
    EXPECT_EQ(tasks.nextDeadline(), turn.now() + 5s);
    turn.clock.advance(5s);
    dispatched();
    tasks.onTimer();
    EXPECT_EQ(stateOf('a'), proto::TASK_UNKNOWN);
    ASSERT_EQ(turn.to_application.size(), 1U);
    EXPECT_EQ(turn.to_application[0].cancel().task_id(), idOf('a').bytes());
    EXPECT_EQ(dispatched(), "") << "the first may have begun";
    report('a', proto::TASK_CANCELLED);
    EXPECT_EQ(dispatched(), "b");
}

TEST_F(TheTasks, ThatAreStoppedExcludeOthersUntilTheirHandlersHaveReturned) {
    admit('a', "Driving");
    grant('a');
    admit('b', "Driving");
    dispatched();
    stop();
    EXPECT_EQ(stateOf('a'), proto::TASK_STOPPED);
    EXPECT_EQ(stateOf('b'), proto::TASK_STOPPED) << "a stop voids the queue";
    EXPECT_EQ(tasks.begun() + tasks.waiting(), 0U);
    turn.stopped.standing = true;
    admit('c', "Driving");
    EXPECT_EQ(dispatched(), "");
    report('a', proto::TASK_STOPPED);
    EXPECT_EQ(dispatched(), "c");
}

TEST_F(TheTasks, WaitWhileTheApplicationIsBusyByItsOwnAccount) {
    proto::StatusNote note;
    note.set_busy(true);
    tasks.applicationIs(note);
    EXPECT_EQ(turn.fired.back().event, Event::ApplicationBusy);
    admit('a', "Driving");
    EXPECT_EQ(dispatched(), "");
    note.set_busy(false);
    tasks.applicationIs(note);
    EXPECT_EQ(dispatched(), "a");
}

TEST_F(TheTasks, GoOnWithoutTheirClientOnlyWhereAllThatRunsMay) {
    admit('a', "Looking");
    EXPECT_FALSE(tasks.survivesClientLoss()) << "it has not been granted";
    grant('a');
    EXPECT_TRUE(tasks.survivesClientLoss());
    tasks.settle();
    EXPECT_TRUE(stop_generations.sparesClientLoss()) << "the signal thread is told";
    admit('b', "Singing");
    grant('b');
    EXPECT_FALSE(tasks.survivesClientLoss());
    report('b', proto::TASK_SUCCEEDED);
    turn.latch = true;
    EXPECT_FALSE(tasks.survivesClientLoss());
}

TEST_F(TheTasks, ThatGoOnWithoutTheirClientEndWithTheirDurationUnlessItIsBack) {
    admit('a', "Looking");
    grant('a');
    tasks.spare();
    EXPECT_TRUE(tasks.finishesAlone());
    EXPECT_EQ(tasks.nextDeadline(), turn.now() + 20s);
    tasks.attend();
    EXPECT_FALSE(tasks.finishesAlone());
    EXPECT_EQ(tasks.nextDeadline(), TimePoint::max());
    tasks.spare();
    turn.clock.advance(20s);
    tasks.onTimer();
    EXPECT_EQ(turn.fired.back().event, Event::ClientLost);
    EXPECT_EQ(stateOf('a'), proto::TASK_STOPPED);
}

TEST_F(TheTasks, OfAHolderThatWasAwayAreToldAgainWhenTheyHaveEnded) {
    admit('a', "Looking");
    grant('a');
    const auto lost_at = turn.now();
    report('a', proto::TASK_SUCCEEDED);
    turn.told.clear();
    tasks.tellFinals(lost_at);
    EXPECT_EQ(stateOf('a'), proto::TASK_SUCCEEDED);
}

TEST_F(TheTasks, ThatAreStepsOfARunAreToldToItsMasterAndOthersAreRefusedMeanwhile) {
    others.in_run = true;
    admit('a', "Driving");
    EXPECT_THAT(others.steps, ElementsAre(proto::TASK_DISPATCHED));
    EXPECT_THAT(turn.told, IsEmpty());
    Header head;
    proto::ToEntity body;
    tasks.consider({Event::Task, &head, &body});
    ASSERT_EQ(turn.refused.size(), 1U);
    EXPECT_EQ(turn.refused[0].code, RefusalCode::WrongState);
}

TEST_F(TheTasks, TheLinkBeatsFastFromBeforeTheFirstUntilTheLastHandlerHasReturned) {
    admit('a', "Driving");
    EXPECT_THAT(back_end.told, ElementsAre(true));
    grant('a');
    stop();
    tasks.settle();
    EXPECT_THAT(back_end.told, ElementsAre(true)) << "its handler may still move the robot";
    report('a', proto::TASK_STOPPED);
    tasks.settle();
    EXPECT_THAT(back_end.told, ElementsAre(true, false));
}

TEST_F(TheTasks, AControlThatTheLinkDoesNotTakeIsRefusedAndChangesNothing) {
    admit('a', "Driving");
    tasks.dispatchNext();
    grant('a');
    Header head;
    head.sender = turn.lease->holder;
    proto::ToEntity cancel;
    cancel.mutable_task_control()->set_task_id(idOf('a').bytes());
    cancel.mutable_task_control()->set_action(proto::CANCEL);
    turn.link_takes = false;
    tasks.control({Event::Cancel, &head, &cancel});
    ASSERT_EQ(turn.refused.size(), 1U);
    EXPECT_EQ(turn.refused[0].code, RefusalCode::TooLarge);
    EXPECT_TRUE(turn.replies.empty());
    turn.link_takes = true;
    tasks.control({Event::Cancel, &head, &cancel});
    ASSERT_EQ(turn.replies.size(), 1U) << "it can still be cancelled";
    EXPECT_TRUE(turn.replies[0].ok());
    EXPECT_TRUE(turn.to_application.back().has_cancel());
}

}  // namespace
}  // namespace axon::entity_manager
