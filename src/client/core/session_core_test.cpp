// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/session_core.hpp"

#include <axon/messages.pb.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "client/core/content.hpp"
#include "client/testing/test_environment.hpp"

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

class SessionCoreTest : public ::testing::Test, public CoreWorld {
  protected:
    void SetUp() override { connect(); }
    /// Two entities asked for, both reserved; the messages of the second phase.
    std::vector<SentMessage> reserveTwo(Answer<std::vector<Held>>& answer) {
        core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, answer.taker());
        const auto asked = link.take();
        for (const auto& message : asked) answerCheckOut(message);
        return link.take();
    }
};

TEST_F(SessionCoreTest, AnEntityWithoutAProfileIsListedOnlyWithAllAndJoinsWhenItIsReady) {
    observer.entities.clear();
    core.onProfile(Presence::Joined, {uuid(4), "greeter", "", ""}, "");
    core.onStatus({uuid(4), EntityState::UNAV, false, 0, {}, {}, "waiting for the robot application"});
    EXPECT_THAT(core.entities().list(), SizeIs(3));
    ASSERT_THAT(core.entities().list(Listed::All), SizeIs(4));
    EXPECT_THAT(observer.entities, IsEmpty());
    const auto found = core.entities().find("greeter");
    ASSERT_TRUE(found);
    EXPECT_FALSE(found->ready);
    EXPECT_EQ(found->state, EntityState::UNAV);
    EXPECT_EQ(found->reason, "waiting for the robot application");

    join(4, "Greeter");
    ASSERT_THAT(observer.entities, SizeIs(1));
    EXPECT_EQ(observer.entities[0].first, Presence::Joined);
    EXPECT_TRUE(observer.entities[0].second.ready);
    EXPECT_THAT(core.entities().list(), SizeIs(4));
    status(4, EntityState::IDLE);
    EXPECT_EQ(observer.entities.back().first, Presence::Changed);

    // Its Entity Manager has started again, at another entity server, before this one was missed.
    core.onProfile(Presence::Changed, {uuid(4), "greeter", "", ""}, "");
    EXPECT_EQ(observer.entities.back().first, Presence::Left);
    EXPECT_THAT(core.entities().list(), SizeIs(3));
    const auto told = observer.entities.size();
    core.onProfile(Presence::Left, {uuid(4), "greeter", "", ""}, "");
    EXPECT_THAT(observer.entities, SizeIs(told));
}

TEST_F(SessionCoreTest, TheEntityItselfSaysWhyItCannotBeCheckedOutBeforeItIsReady) {
    core.onProfile(Presence::Joined, {uuid(4), "greeter", "", ""}, "");
    status(4, EntityState::INIT);
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"greeter"}, answer.taker());
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].head.entity, uuid(4));
    answerCheckOut(link.sent[0], RefusalCode::Unavailable);
    EXPECT_EQ(answer.refusal.code, RefusalCode::Unavailable);
}

TEST_F(SessionCoreTest, AQueryNeverMeansAnEntityThatIsNotReady) {
    core.onProfile(Presence::Joined, {uuid(4), "greeter", "", ""}, "");
    core.onStatus({uuid(4), EntityState::IDLE, false, 0, {}, {}, {}});
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut(parseQuery("1 STATIONARY").value(), {}, answer.taker());
    EXPECT_EQ(answer.refusal.code, RefusalCode::Unavailable);
    EXPECT_THAT(answer.refusal.message, Not(HasSubstr("greeter")));
}

TEST_F(SessionCoreTest, OneEntityIsTaken) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"Cyton"}, answer.taker());
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].body.check_out().phase(), proto::TAKE);
    EXPECT_EQ(link.sent[0].head.entity, uuid(3));
    EXPECT_EQ(link.sent[0].head.msg_type, kMsgCheckOut);
    EXPECT_EQ(answer.count, 0);

    answerCheckOut(link.sent[0]);

    EXPECT_EQ(answer.count, 1);
    EXPECT_TRUE(answer.refusal.ok());
    EXPECT_THAT(core.leases().held(), ElementsAre(Held{uuid(3), {1, 1}}));
    EXPECT_EQ(core.leases().service({uuid(3), {1, 1}}, "Driving").value().name, "Driving");
}

TEST_F(SessionCoreTest, SeveralAreReservedThenCommittedUnderOneRequest) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, answer.taker());
    const auto reserved = link.take();
    ASSERT_THAT(reserved, SizeIs(2));
    EXPECT_EQ(reserved[0].body.check_out().phase(), proto::RESERVE);
    EXPECT_EQ(reserved[0].body.check_out().request_id(), reserved[1].body.check_out().request_id());

    answerCheckOut(reserved[0]);
    EXPECT_THAT(link.sent, IsEmpty()) << "nothing is committed before all are reserved";
    answerCheckOut(reserved[1]);
    const auto committed = link.take();
    ASSERT_THAT(committed, SizeIs(2));
    EXPECT_EQ(committed[0].body.check_out().phase(), proto::COMMIT);

    answerCheckOut(committed[0]);
    EXPECT_EQ(answer.count, 0);
    answerCheckOut(committed[1]);
    EXPECT_EQ(answer.count, 1);
    EXPECT_THAT(core.leases().held(), SizeIs(2));
}

TEST_F(SessionCoreTest, OneRefusalAbortsTheOthersAndNamesTheHolder) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, answer.taker());
    const auto reserved = link.take();
    answerCheckOut(reserved[0]);
    answerCheckOut(reserved[1], RefusalCode::AlreadyHeld);

    EXPECT_EQ(answer.count, 1);
    EXPECT_EQ(answer.refusal.code, RefusalCode::AlreadyHeld);
    EXPECT_EQ(answer.refusal.holder, "client2@lab");
    EXPECT_THAT(answer.refusal.message, HasSubstr("Cyton"));
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].body.check_out().phase(), proto::ABORT);
    EXPECT_EQ(link.sent[0].head.entity, uuid(1));
    EXPECT_THAT(core.leases().held(), IsEmpty());
}

TEST_F(SessionCoreTest, AReservationThatIsNotAnsweredInTimeAbortsAll) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, answer.taker());
    answerCheckOut(link.take()[0]);
    advance(4999ms);
    EXPECT_EQ(answer.count, 0);
    advance(1ms);

    EXPECT_EQ(answer.count, 1);
    EXPECT_EQ(answer.refusal.code, RefusalCode::TimedOut);
    EXPECT_THAT(answer.refusal.message, HasSubstr("Cyton"));
    ASSERT_THAT(link.sent, SizeIs(2));
    for (const auto& message : link.sent) EXPECT_EQ(message.body.check_out().phase(), proto::ABORT);
}

TEST_F(SessionCoreTest, ACommitThatFailsReleasesWhatWasGranted) {
    Answer<std::vector<Held>> answer;
    const auto committed = reserveTwo(answer);
    answerCheckOut(committed[0]);
    answerCheckOut(committed[1], RefusalCode::Expired);

    EXPECT_EQ(answer.refusal.code, RefusalCode::Expired);
    EXPECT_THAT(core.leases().held(), IsEmpty());
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_TRUE(link.sent[0].body.has_release());
    EXPECT_EQ(link.sent[0].head.held, (LeaseNumber{1, 1}));
    EXPECT_THAT(observer.lost, IsEmpty()) << "nobody was told that it was held";
}

TEST_F(SessionCoreTest, AGrantThatComesTooLateIsGivenBack) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"Cyton"}, answer.taker());
    const auto asked = link.take()[0];
    advance(5s);
    ASSERT_EQ(answer.refusal.code, RefusalCode::TimedOut);
    const auto aborted = link.take();
    ASSERT_THAT(aborted, SizeIs(1));
    EXPECT_EQ(aborted[0].body.check_out().phase(), proto::ABORT);

    answerCheckOut(asked, RefusalCode::Ok, 4);

    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_TRUE(link.sent[0].body.has_release());
    EXPECT_EQ(link.sent[0].head.held, (LeaseNumber{1, 4}));
    EXPECT_EQ(answer.count, 1);
}

TEST_F(SessionCoreTest, ADuplicateGrantChangesNothing) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"Cyton"}, answer.taker());
    const auto asked = link.take()[0];
    answerCheckOut(asked);
    answerCheckOut(asked);
    EXPECT_EQ(answer.count, 1);
    EXPECT_THAT(link.sent, IsEmpty());
    EXPECT_THAT(core.leases().held(), SizeIs(1));
}

TEST_F(SessionCoreTest, WhatCannotBeAskedForIsRefusedAtOnce) {
    const auto code = [&](const std::vector<std::string>& names) {
        Answer<std::vector<Held>> answer;
        core.checkOuts().checkOut(names, answer.taker());
        EXPECT_EQ(answer.count, 1);
        return answer.refusal.code;
    };
    EXPECT_EQ(code({}), RefusalCode::UnknownEntity);
    EXPECT_EQ(code({"PeopleBot"}), RefusalCode::AmbiguousEntity);
    EXPECT_EQ(code({"Cyton", uuid(3)}), RefusalCode::Duplicate);
    EXPECT_EQ(code({"Cyton", "Nobody"}), RefusalCode::UnknownEntity);
    EXPECT_THAT(link.sent, IsEmpty());
    take("Cyton");
    EXPECT_EQ(code({"Cyton"}), RefusalCode::AlreadyHeld);
}

TEST_F(SessionCoreTest, ACheckOutEndsWhenAnEntityLeaves) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, answer.taker());
    core.onProfile(Presence::Left, {uuid(3), "Cyton"}, {});
    EXPECT_EQ(answer.count, 1);
    EXPECT_EQ(answer.refusal.code, RefusalCode::Unavailable);
}

TEST_F(SessionCoreTest, CommandsCarryLeaseAndNewestStopGeneration) {
    const auto held = take("Cyton");
    status(3, EntityState::REG, kMe, {1, 1}, 4);
    status(3, EntityState::REG, kMe, {1, 1}, 3);  // older, overtaken
    core.tasks().run(held, "Driving", {}, {});
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].head.held, (LeaseNumber{1, 1}));
    EXPECT_EQ(link.sent[0].head.stop_generation, 4);
    EXPECT_EQ(link.sent[0].head.msg_type, kMsgTask);
}

TEST_F(SessionCoreTest, AnEndedLeaseIsToldAndRefusedFromThenOn) {
    const auto held = take("Cyton");
    proto::ToClient message;
    message.mutable_lease_ended()->mutable_lease()->set_epoch(1);
    message.mutable_lease_ended()->mutable_lease()->set_number(1);
    message.mutable_lease_ended()->mutable_reason()->set_code(proto::REVOKED_LEASE);
    fromEntity(3, message);

    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].second.code, RefusalCode::RevokedLease);
    EXPECT_EQ(core.commands().sendText(held, "hello").refusal().code, RefusalCode::NotHolder);
    EXPECT_EQ(core.commands().reset(held).refusal().code, RefusalCode::NotHolder);
    fromEntity(3, message);
    EXPECT_THAT(observer.lost, SizeIs(1)) << "once";
}

TEST_F(SessionCoreTest, TheEndOfAnOlderLeaseDoesNotEndTheNewOne) {
    take("Cyton", 2);
    proto::ToClient message;
    message.mutable_lease_ended()->mutable_lease()->set_epoch(1);
    message.mutable_lease_ended()->mutable_lease()->set_number(1);
    fromEntity(3, message);
    EXPECT_THAT(core.leases().held(), SizeIs(1));
}

TEST_F(SessionCoreTest, AHandleOfAnEarlierLeaseIsRefused) {
    const auto earlier = take("Cyton", 1);
    core.leases().release(earlier, [](const Result<void>&) {});
    const auto now = take("Cyton", 2);
    EXPECT_FALSE(core.leases().holds(earlier));
    EXPECT_TRUE(core.leases().holds(now));
    EXPECT_EQ(core.commands().sendText(earlier, "hello").refusal().code, RefusalCode::NotHolder);
}

TEST_F(SessionCoreTest, ARefusalForAStaleLeaseEndsItHere) {
    const auto held = take("Cyton");
    Answer<void> answer;
    core.commands().set(held, "Driving", {"Distance", {std::int64_t{100}}}, answer.taker());
    reply(3, link.sent[0].body.set_param().request_id(), RefusalCode::OlderLease);
    EXPECT_EQ(answer.refusal.code, RefusalCode::OlderLease);
    EXPECT_THAT(observer.lost, SizeIs(1));
    EXPECT_THAT(core.leases().held(), IsEmpty());
}

TEST_F(SessionCoreTest, ANewerHolderInTheStatusEndsTheLease) {
    take("Cyton");
    status(3, EntityState::REG, {"other", "client2@lab"}, {1, 2});
    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].second.holder, "client2@lab");
}

TEST_F(SessionCoreTest, AnEntityWhoseRobotApplicationIsGoneIsLost) {
    take("Cyton");
    status(3, EntityState::UNAV);
    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].second.code, RefusalCode::Unavailable);
}

TEST_F(SessionCoreTest, ReleaseIsDoneWhenTheEntityIsFree) {
    const auto held = take("Cyton");
    Answer<void> answer;
    core.leases().release(held, answer.taker());
    EXPECT_TRUE(link.sent[0].body.has_release());
    EXPECT_EQ(core.commands().sendText(held, "x").refusal().code, RefusalCode::NotHolder)
        << "given up at once";
    status(3, EntityState::BUSY, kMe, {1, 1});
    EXPECT_EQ(answer.count, 0);
    status(3, EntityState::IDLE, {}, {1, 1});
    EXPECT_EQ(answer.count, 1);
    EXPECT_TRUE(answer.refusal.ok());
    EXPECT_THAT(observer.lost, IsEmpty());
}

TEST_F(SessionCoreTest, ARefusalOfAnEarlierLeaseLeavesTheNewOne) {
    take("Cyton", 2);
    proto::ToClient message;
    message.mutable_reply()->mutable_refusal()->set_code(proto::NOT_HOLDER);
    Header head;
    head.entity = uuid(3);
    head.held = {1, 2};
    core.onEntityMsg(head, message.SerializeAsString());
    EXPECT_THAT(core.leases().held(), SizeIs(1));
    head.held = {1, 3};
    core.onEntityMsg(head, message.SerializeAsString());
    EXPECT_THAT(core.leases().held(), IsEmpty());
}

TEST_F(SessionCoreTest, ResetIsRefusedWhileLatched) {
    const auto held = take("Cyton");
    core.onStatus({uuid(3), EntityState::REG, true, 1, kMe, {1, 1}, {}});
    EXPECT_EQ(core.commands().reset(held).refusal().code, RefusalCode::Latched);
    EXPECT_TRUE(core.commands().clear(held).ok());
}

TEST_F(SessionCoreTest, EachRequestTimesOut) {
    const auto held = take("Cyton");
    Answer<void> set, rearm, release, upload, pause;
    Answer<std::vector<Service>> services;
    core.commands().set(held, "Driving", {"Distance", {std::int64_t{100}}}, set.taker());
    core.commands().rearm(uuid(1), rearm.taker());
    core.entities().fetchServices(uuid(2), services.taker());
    core.commands().offer(held, "Driving", "Map", "map.txt", 10, std::string(32, 'x'), upload.taker());
    const auto task = core.tasks().run(held, "Driving", {}, {});
    taskEvent(3, task, proto::TASK_RUNNING);
    core.tasks().control(task, proto::PAUSE, pause.taker());
    EXPECT_EQ(core.nextDeadline(), clock.now() + 5s);

    advance(5s);

    for (const auto* answer : {&set, &rearm, &upload, &pause}) {
        EXPECT_EQ(answer->count, 1);
        EXPECT_EQ(answer->refusal.code, RefusalCode::TimedOut);
    }
    EXPECT_EQ(services.refusal.code, RefusalCode::TimedOut);
    EXPECT_EQ(core.pendingRequests(), 0U);
    core.leases().release(held, release.taker());
    advance(5s);
    EXPECT_EQ(release.refusal.code, RefusalCode::TimedOut);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Unknown)
        << "released, and nobody said how the task ended";
}

TEST_F(SessionCoreTest, ALateReplyIsNotASecondAnswer) {
    const auto held = take("Cyton");
    Answer<void> answer;
    core.commands().set(held, "Driving", {"Distance", {std::int64_t{100}}}, answer.taker());
    const auto id = link.sent[0].body.set_param().request_id();
    advance(5s);
    reply(3, id);
    EXPECT_EQ(answer.count, 1);
}

TEST_F(SessionCoreTest, WhatTheServersCannotDeliverIsRefusedBySequence) {
    const auto held = take("Cyton");
    Answer<void> answer;
    core.commands().set(held, "Driving", {"Distance", {std::int64_t{100}}}, answer.taker());
    core.onRefusal(link.sent[0].head, {RefusalCode::UnknownEntity, "no such entity", {}});
    EXPECT_EQ(answer.count, 1);
    EXPECT_EQ(answer.refusal.code, RefusalCode::UnknownEntity);

    const auto task = core.tasks().run(held, "Driving", {}, {});
    core.onRefusal(link.sent[1].head, {RefusalCode::UnknownEntity, "no such entity", {}});
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Refused);

    Answer<std::vector<Held>> check_out;
    core.checkOuts().checkOut({"PeopleBot#1"}, check_out.taker());
    core.onRefusal(link.sent.back().head, {RefusalCode::UnknownEntity, "no such entity", {}});
    EXPECT_EQ(check_out.refusal.code, RefusalCode::UnknownEntity);
}

TEST_F(SessionCoreTest, ValuesAreCheckedAgainstTheProfileBeforeTheyTravel) {
    const auto held = take("Cyton");
    const auto code = [&](const Argument& argument) {
        Answer<void> answer;
        core.commands().set(held, "Driving", argument, answer.taker());
        return answer.refusal.code;
    };
    EXPECT_EQ(code({"Distanz", {std::int64_t{1}}}), RefusalCode::UnknownParameter);
    EXPECT_EQ(code({"Distance", {std::string("far")}}), RefusalCode::WrongType);
    EXPECT_EQ(code({"Distance", {std::int64_t{1}}, "deg"}), RefusalCode::WrongUnits);
    EXPECT_EQ(code({"Distance", {std::int64_t{5001}}}), RefusalCode::OutOfRange);
    EXPECT_EQ(code({"Distance", {std::string("12x")}, "", true}), RefusalCode::WrongUnits);
    EXPECT_THAT(link.sent, IsEmpty());
    code({"Distance", {std::string("1500")}, "", true});
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].body.set_param().param().values(0).int_(), 1500);
}

TEST_F(SessionCoreTest, ServicesOfAnyEntityCanBeAskedFor) {
    std::vector<Service> got;
    core.entities().fetchServices(
        uuid(1), [&](Result<std::vector<Service>> services) { got = std::move(services).value(); });
    ASSERT_TRUE(link.sent[0].body.status_request().with_services());
    proto::ToClient message;
    message.mutable_status()->set_request_id(link.sent[0].body.status_request().request_id());
    message.mutable_status()->set_state(proto::IDLE);
    message.mutable_status()->add_services()->set_name("Turning");
    fromEntity(1, message);
    ASSERT_THAT(got, SizeIs(1));
    EXPECT_EQ(got[0].name, "Turning");
}

TEST_F(SessionCoreTest, CreditsMoveTheDeadlineOfAnUpload) {
    const auto held = take("Cyton");
    Answer<void> answer;
    const auto transfer = core.commands().offer(held, "Driving", "Map", "map.txt", 100'000,
                                                std::string(32, 'x'), answer.taker());
    advance(4s);
    proto::ToClient credit;
    credit.mutable_resource_credit()->set_transfer_id(transfer.bytes());
    credit.mutable_resource_credit()->set_offset(1000);
    credit.mutable_resource_credit()->set_window(65536);
    fromEntity(3, credit);
    EXPECT_THAT(observer.credits, ElementsAre(std::pair<std::uint64_t, std::uint64_t>{1000, 66536}));
    advance(4s);
    EXPECT_EQ(answer.count, 0);
    credit.mutable_resource_credit()->set_offset(66536);
    credit.mutable_resource_credit()->set_window(0);
    fromEntity(3, credit);
    EXPECT_THAT(observer.credits, SizeIs(1)) << "it says no more than that the disk is at work";
    advance(4s);
    EXPECT_EQ(answer.count, 0);
    EXPECT_TRUE(core.commands().sendChunk(transfer, 1000, std::string(65536, 'x')).ok());
    EXPECT_EQ(core.commands().sendChunk(transfer, 1000, std::string(65537, 'x')).refusal().code,
              RefusalCode::TooLarge);
    proto::ToClient done;
    done.mutable_resource_done()->set_transfer_id(transfer.bytes());
    done.mutable_resource_done()->mutable_refusal()->set_code(proto::HASH_MISMATCH);
    fromEntity(3, done);
    EXPECT_EQ(answer.refusal.code, RefusalCode::HashMismatch);
    EXPECT_EQ(core.commands().sendChunk(transfer, 1000, "x").refusal().code, RefusalCode::Cancelled);
}

TEST_F(SessionCoreTest, ATaskGoesThroughItsStates) {
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {{"Distance", {std::int64_t{1000}}}}, 2s);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Queued);
    EXPECT_EQ(link.sent[0].body.task().task_id(), task.bytes());
    EXPECT_DOUBLE_EQ(link.sent[0].body.task().not_after_s(), 2);
    EXPECT_FALSE(core.tasks().report(task)->accepted) << "nobody has answered";
    taskEvent(3, task, proto::TASK_DISPATCHED);
    EXPECT_TRUE(core.tasks().report(task)->accepted);
    taskEvent(3, task, proto::TASK_RUNNING, -0.0);
    EXPECT_FALSE(std::signbit(core.tasks().report(task)->progress)) << "nobody is at -0 %";
    taskEvent(3, task, proto::TASK_RUNNING, 0.25);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Running);
    EXPECT_DOUBLE_EQ(core.tasks().report(task)->progress, 0.25);
    taskEvent(3, task, proto::TASK_PAUSED);
    taskEvent(3, task, proto::TASK_RUNNING);
    taskEvent(3, task, proto::TASK_SUCCEEDED, 1);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Succeeded);
    EXPECT_THAT(observer.tasks, SizeIs(6));
    advance(10s);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Succeeded);
}

TEST_F(SessionCoreTest, LateAndDuplicateEventsDoNotTurnATaskBack) {
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {}, {});
    taskEvent(3, task, proto::TASK_RUNNING, 0.5);
    taskEvent(3, task, proto::TASK_DISPATCHED);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Running);
    taskEvent(3, task, proto::TASK_STOPPED);
    taskEvent(3, task, proto::TASK_RUNNING, 0.7);
    taskEvent(3, task, proto::TASK_SUCCEEDED, 1);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Stopped);
    EXPECT_THAT(observer.tasks, SizeIs(2));
}

TEST_F(SessionCoreTest, AnotherEntityCannotSpeakForATask) {
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {}, {});
    taskEvent(1, task, proto::TASK_SUCCEEDED);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Queued);
}

TEST_F(SessionCoreTest, ATaskNobodyAnswersBecomesUnknownAndIsCancelled) {
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {}, {});
    link.sent.clear();
    advance(5s);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Unknown);
    EXPECT_EQ(core.tasks().report(task)->reason.code, RefusalCode::OutcomeUnknown);
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].body.task_control().action(), proto::CANCEL);
    taskEvent(3, task, proto::TASK_RUNNING);
    EXPECT_THAT(link.sent, SizeIs(2)) << "alive after all: it is cancelled again";
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Unknown);
}

TEST_F(SessionCoreTest, WhatTheProfileDoesNotHaveIsARefusedTask) {
    const auto held = take("Cyton");
    const auto unknown = core.tasks().run(held, "Flying", {}, {});
    EXPECT_EQ(core.tasks().report(unknown)->state, TaskState::Refused);
    EXPECT_EQ(core.tasks().report(unknown)->reason.code, RefusalCode::UnknownService);
    const auto far = core.tasks().run(held, "Driving", {{"Distance", {std::int64_t{9000}}}}, {});
    EXPECT_EQ(core.tasks().report(far)->reason.code, RefusalCode::OutOfRange);
    EXPECT_THAT(link.sent, IsEmpty());
    EXPECT_FALSE(core.busy());
}

TEST_F(SessionCoreTest, ControlsAreDoneWhenTheTaskSaysSo) {
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {}, {});
    taskEvent(3, task, proto::TASK_RUNNING);
    Answer<void> pause, resume, cancel, late;
    core.tasks().control(task, proto::PAUSE, pause.taker());
    taskEvent(3, task, proto::TASK_RUNNING, 0.1);
    EXPECT_EQ(pause.count, 0);
    taskEvent(3, task, proto::TASK_PAUSED);
    EXPECT_EQ(pause.count, 1);
    core.tasks().control(task, proto::RESUME, resume.taker());
    taskEvent(3, task, proto::TASK_RUNNING);
    EXPECT_TRUE(resume.refusal.ok());
    EXPECT_EQ(resume.count, 1);
    core.tasks().control(task, proto::CANCEL, cancel.taker());
    taskEvent(3, task, proto::TASK_CANCELLED);
    EXPECT_TRUE(cancel.refusal.ok());
    core.tasks().control(task, proto::CANCEL, late.taker());
    EXPECT_EQ(late.refusal.code, RefusalCode::WrongState);
}

TEST_F(SessionCoreTest, TheReportIsToldBeforeTheControlIsDone) {
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {}, {});
    taskEvent(3, task, proto::TASK_RUNNING);
    std::size_t told = 0;
    core.tasks().control(task, proto::PAUSE, [&](const Result<void>&) { told = observer.tasks.size(); });
    taskEvent(3, task, proto::TASK_PAUSED);
    EXPECT_EQ(told, 2U);
    EXPECT_EQ(observer.tasks.back().state, TaskState::Paused);
}

TEST_F(SessionCoreTest, ARefusedPauseLeavesTheTaskRunning) {
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {}, {});
    taskEvent(3, task, proto::TASK_RUNNING);
    Answer<void> pause;
    core.tasks().control(task, proto::PAUSE, pause.taker());
    reply(3, task.bytes(), RefusalCode::NotPausable);
    EXPECT_EQ(pause.refusal.code, RefusalCode::NotPausable);
    reply(3, task.bytes(), RefusalCode::NotPausable);  // of a second one, whose answer has been taken
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Running);
}

TEST_F(SessionCoreTest, HeartbeatsAreFastWhileATaskRuns) {
    advance(0ms);
    EXPECT_THAT(link.beats, SizeIs(1)) << "the first one at once";
    EXPECT_EQ(core.nextHeartbeat(), clock.now() + 2s);
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {}, {});
    EXPECT_EQ(core.nextHeartbeat(), clock.now() + 50ms);
    advance(50ms);
    EXPECT_TRUE(link.beats.back().second);
    EXPECT_EQ(core.nextHeartbeat(), clock.now() + 50ms);
    taskEvent(3, task, proto::TASK_SUCCEEDED);
    advance(50ms);
    EXPECT_EQ(core.nextHeartbeat(), clock.now() + 2s);
}

TEST_F(SessionCoreTest, HeartbeatsStayFastWhileAnEntityThatIsHeldIsBusy) {
    take("Cyton");
    advance(0ms);
    status(3, EntityState::BUSY, kMe, {1, 1});
    EXPECT_LE(core.nextHeartbeat(), clock.now() + 50ms);
    status(1, EntityState::BUSY, {"other", "client2"}, {1, 1});
    status(3, EntityState::REG, kMe, {1, 1});
    advance(50ms);
    EXPECT_EQ(core.nextHeartbeat(), clock.now() + 2s) << "other people's robots do not count";
}

// What an entity says to this client alone is not what the server goes by.
TEST_F(SessionCoreTest, TheServersWatchdogsFollowWhatTheServerHasTold) {
    take("Cyton");
    advance(0ms);
    status(3, EntityState::BUSY, kMe, {1, 1});
    proto::ToClient lie;
    lie.mutable_status()->set_state(proto::EntityState::IDLE);
    Header head;
    head.entity = uuid(3);
    head.msg_type = kMsgStatus;
    core.onEntityMsg(head, lie.SerializeAsString());
    EXPECT_LE(core.nextHeartbeat(), clock.now() + 50ms);
    EXPECT_LE(core.serverDeadline(), clock.now() + 1s);
    status(3, EntityState::REG, kMe, {1, 1});
    lie.mutable_status()->set_state(proto::EntityState::BUSY);
    core.onEntityMsg(head, lie.SerializeAsString());
    EXPECT_GT(core.serverDeadline(), clock.now() + 5s);
}

// The server beats fast for the client that the entity names, whoever has its lease.
TEST_F(SessionCoreTest, AnEntityThatIsHeldAndNamesAnotherChangesNoWatchdogOfTheServer) {
    take("Cyton");
    advance(0ms);
    status(3, EntityState::BUSY, {"other", "client2"}, {1, 1});
    EXPECT_GT(core.serverDeadline(), clock.now() + 5s);
    EXPECT_LE(core.nextHeartbeat(), clock.now() + 50ms) << "what it holds may move";
}

// The server does not believe it either, and goes on beating slowly.
TEST_F(SessionCoreTest, AnEntityThatNamesThisClientUnaskedChangesNoWatchdog) {
    advance(0ms);
    status(1, EntityState::BUSY, kMe, {1, 1});
    EXPECT_EQ(core.nextHeartbeat(), clock.now() + 2s);
    EXPECT_GT(core.serverDeadline(), clock.now() + 5s)
        << "a server that beats slowly would be given up after a second";
}

/// A client and the watchdog that its server has of it, over idle times and tasks.
class WatchedWorld : public CoreWorld {
  public:
    explicit WatchedWorld(const Watchdogs& watchdogs) { begin(watchdogs); }
    void begin(const Watchdogs& watchdogs) {
        server.emplace(watchdogs.busy, watchdogs.idle, clock.now());
        connect(watchdogs);
    }
    /// Beats come when they are due. They may be late by half of the watchdog, and must not be more than
    /// twice as many as need be.
    void live(Duration time) {
        const auto end = clock.now() + time;
        const auto before = link.beats.size();
        for (;;) {
            const auto next = std::min(core.nextHeartbeat(), end);
            if (next > clock.now()) clock.advance(next - clock.now());
            margin = std::min(margin, server->margin(clock.now()));
            if (next == end) break;
            core.onHeartbeatTimer();
            server->heard(clock.now());
        }
        EXPECT_LE(link.beats.size() - before, static_cast<std::size_t>(10 * (time / server->timeout()) + 2));
    }
    void task(const Held& held) {
        const auto task = core.tasks().run(held, "Driving", {}, {});
        live(1ms);
        server->setBusy(true, clock.now());
        live(1ms);  // the status is under way
        status(3, EntityState::BUSY, kMe, held.lease);
        taskEvent(3, task, proto::TASK_RUNNING);
        live(20 * server->timeout());
        taskEvent(3, task, proto::TASK_SUCCEEDED);
        live(20 * server->timeout());  // its status is late
        status(3, EntityState::REG, kMe, held.lease);
        server->setBusy(false, clock.now());
    }
    std::optional<Liveness> server;
    double margin = 1;
};

TEST(ServersWatchdogs, HeartbeatsKeepEachOfThemFedWithLeasesAndTasksAndAfterReconnection) {
    const std::vector<Duration> busy_range{50ms, 51ms, 100ms, 250ms, 999ms, 2000ms};
    const std::vector<Duration> idle_range{1000ms, 1001ms, 2000ms, 10s, 60s, 600s};
    Watchdogs before;
    for (const auto busy : busy_range) {
        for (const auto idle : idle_range) {
            if (busy > idle) continue;
            const Watchdogs now{busy, idle};
            WatchedWorld world(now);
            world.live(3 * idle);
            const auto held = world.take("Cyton", 1, std::chrono::milliseconds{10s});
            world.live(3 * idle);
            world.task(held);
            world.live(3 * idle);
            world.task(held);
            // Another server, with the values of the turn before.
            world.core.onDisconnected("the server has ended");
            world.clock.advance(300ms);
            world.begin(before);
            ASSERT_EQ(world.link.sent.back().body.check_out().phase(), proto::RESUME_LEASE);
            world.answerCheckOut(world.link.sent.back(), RefusalCode::Ok, 1, std::chrono::milliseconds{10s});
            world.live(3 * before.idle);
            world.task(held);
            world.live(3 * before.idle);
            EXPECT_GE(world.margin, 0.75) << busy / 1ms << " ms and " << idle / 1ms << " ms";
            before = now;
        }
    }
}

TEST(ServersWatchdogs, NoneMakesAClientBeatWithoutPause) {
    WatchedWorld world({1ms, 1ms});
    world.advance(0ms);
    EXPECT_EQ(world.core.nextHeartbeat(), world.clock.now() + 10ms);
}

TEST(ServersWatchdogs, ABusyEntityThatWasReleasedCountsUntilItHasLetGo) {
    WatchedWorld world({250ms, 10s});
    const auto held = world.take("Cyton");
    world.status(3, EntityState::BUSY, kMe, held.lease);  // by a task of which this process knows nothing
    world.core.leases().release(held, [](const Result<void>&) {});
    world.server->setBusy(true, world.clock.now());
    world.live(2s);
    EXPECT_GE(world.margin, 0.75);
    world.status(3, EntityState::IDLE);
    world.advance(50ms);
    EXPECT_EQ(world.core.nextHeartbeat(), world.clock.now() + 2s);
}

TEST(ServersWatchdogs, ALeaseIsWaitedForAsLongAsTheServerMayNotHaveNoticedTheLoss) {
    WatchedWorld world({250ms, 60s});
    world.take("Cyton", 1, std::chrono::milliseconds{5s});
    world.core.onDisconnected("the network is gone");
    world.advance(64s);
    EXPECT_THAT(world.observer.lost, IsEmpty())
        << "the server gives the client up after 60 s, and then the grace of 5 s begins";
    world.advance(2s);
    EXPECT_THAT(world.observer.lost, SizeIs(1));
}

TEST_F(SessionCoreTest, ASilentServerIsNoticedSoonerWhileARobotMoves) {
    advance(9999ms);
    EXPECT_FALSE(core.serverSilent());
    advance(1ms);
    EXPECT_TRUE(core.serverSilent());
    core.onServerHeartbeat();
    EXPECT_FALSE(core.serverSilent());
    take("Cyton");
    status(3, EntityState::BUSY, kMe, {1, 1});
    advance(1s);
    EXPECT_TRUE(core.serverSilent());
}

TEST_F(SessionCoreTest, ALostConnectionLeavesNothingOpen) {
    const auto held = take("Cyton");
    const auto task = core.tasks().run(held, "Driving", {}, {});
    taskEvent(3, task, proto::TASK_RUNNING);
    Answer<void> set;
    Answer<std::vector<Held>> check_out;
    core.commands().set(held, "Driving", {"Distance", {std::int64_t{1}}}, set.taker());
    core.checkOuts().checkOut({"PeopleBot#2"}, check_out.taker());

    core.onDisconnected("cable cut");

    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Unknown);
    EXPECT_EQ(core.tasks().report(task)->reason.code, RefusalCode::OutcomeUnknown);
    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].second.code, RefusalCode::NotConnected);
    EXPECT_EQ(set.count, 1);
    EXPECT_EQ(check_out.count, 1);
    EXPECT_EQ(check_out.refusal.code, RefusalCode::NotConnected);
    EXPECT_EQ(core.pendingRequests(), 0U);
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
    EXPECT_EQ(core.nextHeartbeat(), TimePoint::max());
    EXPECT_THAT(core.entities().list(), IsEmpty());
    EXPECT_EQ(core.entities().find("Cyton").refusal().code, RefusalCode::NotConnected);
    EXPECT_EQ(core.commands().sendText(held, "x").refusal().code, RefusalCode::NotConnected);
}

TEST_F(SessionCoreTest, WatchesComeBackWithTheConnection) {
    ASSERT_TRUE(core.watches().watch(uuid(3), {"pose"}).ok());
    core.onDisconnected("restart");
    link.sent.clear();
    connect();
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_TRUE(link.sent[0].body.watch().on());
    EXPECT_THAT(link.sent[0].body.watch().streams(), ElementsAre("pose"));
}

TEST_F(SessionCoreTest, TheLastOfSeveralWatchesTurnsAStreamOff) {
    ASSERT_TRUE(core.watches().watch(uuid(3), {"pose"}).ok());
    ASSERT_TRUE(core.watches().watch(uuid(3), {"pose", "sonar"}).ok());
    link.sent.clear();
    core.watches().unwatch(uuid(3), {"pose"});
    EXPECT_THAT(link.sent, IsEmpty());
    core.watches().unwatch(uuid(3), {"pose", "sonar"});
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_FALSE(link.sent[0].body.watch().on());
    EXPECT_THAT(link.sent[0].body.watch().streams(), ElementsAre("pose", "sonar"));
}

TEST_F(SessionCoreTest, ProfilesThatOvertakeTheHandshakeCount) {
    CoreWorld world;
    world.join(1, "PeopleBot");
    EXPECT_FALSE(world.core.complete());
    world.core.onConnected(kMe, 1);
    EXPECT_TRUE(world.core.complete());
    EXPECT_TRUE(world.core.entities().find("PeopleBot").ok());
}

TEST_F(SessionCoreTest, AnEntityIsThereOnceItsProfileAndItsStatusHaveComeInEitherOrder) {
    for (const bool profile_first : {true, false}) {
        CoreWorld world;
        world.core.onConnected(kMe, 1);
        const auto one = [&](bool profile) {
            if (profile)
                world.announce(1, "PeopleBot");
            else
                world.status(1, EntityState::REG);
        };
        one(profile_first);
        EXPECT_FALSE(world.core.complete()) << "what is listed now has a state that nobody has told";
        EXPECT_THAT(world.core.entities().list(Listed::All), IsEmpty());
        EXPECT_FALSE(world.core.entities().find("PeopleBot").ok());
        EXPECT_THAT(world.observer.entities, IsEmpty());
        one(!profile_first);
        EXPECT_TRUE(world.core.complete());
        ASSERT_THAT(world.observer.entities, SizeIs(1));
        EXPECT_EQ(world.observer.entities[0].first, Presence::Joined);
        EXPECT_EQ(world.observer.entities[0].second.state, EntityState::REG);
    }
}

TEST_F(SessionCoreTest, MalformedMessagesAreCountedAndChangeNothing) {
    take("Cyton");
    Header head;
    head.entity = uuid(3);
    core.onEntityMsg(head, "\xff\xff\xff");
    core.onEntityMsg(head, "");
    proto::ToClient message;
    message.mutable_task()->set_task_id("short");
    message.mutable_task()->set_state(proto::TASK_RUNNING);
    fromEntity(3, message);
    reply(3, "short");
    EXPECT_EQ(core.malformed(), 4U);
    EXPECT_THAT(core.leases().held(), SizeIs(1));
}

TEST_F(SessionCoreTest, OnlyUtf8IsAText) {
    const auto held = take("Cyton");
    EXPECT_EQ(core.commands().sendText(held, "\xff").refusal().code, RefusalCode::Malformed);
    EXPECT_TRUE(core.commands().sendRaw(held, "\xff").ok());
}

TEST(RawMessageTest, IsWhatProtobufWouldWrite) {
    for (const std::size_t size : {0U, 1U, 123U, 127U, 128U, 16380U, 16384U, 3'000'000U}) {
        const std::string bytes(size, '\xff');
        proto::ToEntity message;
        message.mutable_raw()->add_data(bytes);
        EXPECT_EQ(rawMessage(bytes), message.SerializeAsString()) << size << " bytes";
    }
}

TEST(SignalMarksTest, AnEntityManagerThatBeganAnewIsAskedInItsOwnGenerations) {
    CoreWorld world;
    world.connect();
    world.status(3, EntityState::IDLE, {}, {}, 7);
    EXPECT_EQ(world.marks.of(uuid(3)), 7);
    world.status(3, EntityState::IDLE, {}, {}, 5);
    EXPECT_EQ(world.marks.of(uuid(3)), 7) << "while it is there, an older one is only late";
    world.core.onProfile(Presence::Left, {uuid(3), "Cyton", "ROBOT", "MOBILE"}, {});
    EXPECT_EQ(world.marks.of(uuid(3)), 0);
    world.join(3, "Cyton");
    world.status(3, EntityState::IDLE, {}, {}, 1);
    EXPECT_EQ(world.marks.of(uuid(3)), 1);
    // A late receipt of the one that was: what the check-out says is what counts.
    world.marks.raise(uuid(3), 7);
    world.take("Cyton");
    EXPECT_EQ(world.marks.of(uuid(3)), 0) << "the reply's";
}

TEST(BusyTest, CountsWhatIsHeldAndMoves) {
    CoreWorld world;
    world.connect();
    world.status(3, EntityState::BUSY);
    EXPECT_FALSE(world.core.busy()) << "somebody else's";
    const auto held = world.take("Cyton");
    EXPECT_TRUE(world.core.busy());
    world.status(3, EntityState::REG, kMe, held.lease);
    EXPECT_FALSE(world.core.busy());
    world.status(3, EntityState::COLLAB, kMe, held.lease);
    EXPECT_TRUE(world.core.busy());
    world.core.leases().release(held, [](const Result<void>&) {});
    EXPECT_TRUE(world.core.busy()) << "the server goes by what the entity says";
    world.status(3, EntityState::IDLE);
    EXPECT_FALSE(world.core.busy());
}

}  // namespace
}  // namespace axon::client::test
