// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/core/session_core.hpp"
#include "client/testing/test_environment.hpp"

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class CheckOutsTest : public ::testing::Test, public CoreWorld {
  protected:
    void SetUp() override { connect(); }
    CheckOutOptions waiting(Seconds time) {
        CheckOutOptions options;
        options.wait = time;
        options.on_waiting = [this](const Waiting& one) { told.push_back(one); };
        return options;
    }
    void idle(int number) { status(number, EntityState::IDLE); }
    void heldByAnother(int number) {
        status(number, EntityState::REG, {"other", "client2@lab", Role::Operator}, {1, 5});
    }
    void ask(const std::string& request, const std::string& reason, bool withdrawn = false) {
        proto::ToClient message;
        auto& hand_over = *message.mutable_hand_over();
        hand_over.set_request_id(request);
        hand_over.set_by("client2@lab");
        hand_over.set_reason(reason);
        hand_over.set_answer_within_s(30);
        hand_over.set_withdrawn(withdrawn);
        fromEntity(3, message);
    }
    /// The answer to a RESUME_LEASE that was sent.
    void answerResume(const SentMessage& asked, RefusalCode code = RefusalCode::Ok, int lease = 1) {
        answerCheckOut(asked, code, lease, 5s);
    }
    /// Of what was sent, the messages of that phase.
    static std::vector<SentMessage> phase(const std::vector<SentMessage>& sent, proto::CheckOutPhase phase) {
        std::vector<SentMessage> some;
        for (const auto& message : sent) {
            if (message.body.has_check_out() && message.body.check_out().phase() == phase)
                some.push_back(message);
        }
        return some;
    }
    void loseConnection() {
        core.onDisconnected("cable cut");
        link.sent.clear();
    }

    std::vector<Waiting> told;
    Answer<std::vector<Held>> answer;
};

TEST_F(CheckOutsTest, WhoWaitsIsToldThePlaceAndGetsIt) {
    heldByAnother(3);
    core.checkOuts().checkOut({"Cyton"}, waiting(60s), answer.taker());
    const auto asked = link.take().at(0);
    EXPECT_TRUE(asked.body.check_out().wait());
    answerPlace(asked, 2);
    answerPlace(asked, 2);
    ASSERT_THAT(told, SizeIs(1)) << "only what is new";
    EXPECT_EQ(told[0].place, 2);
    EXPECT_THAT(told[0].message, HasSubstr("client2@lab"));
    answerPlace(asked, 1);
    EXPECT_THAT(told, SizeIs(2));
    EXPECT_EQ(answer.count, 0);
    answerCheckOut(asked);
    EXPECT_EQ(answer.count, 1);
    EXPECT_TRUE(answer.refusal.ok());
    EXPECT_THAT(core.leases().held(), SizeIs(1));
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
}

TEST_F(CheckOutsTest, APlaceIsAskedForAgainEveryFiveSeconds) {
    core.checkOuts().checkOut({"Cyton"}, waiting(60s), answer.taker());
    const auto asked = link.take().at(0);
    answerPlace(asked, 1);
    advance(4999ms);
    EXPECT_THAT(link.sent, IsEmpty());
    advance(1ms);
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].body.check_out().phase(), proto::TAKE);
    EXPECT_EQ(link.sent[0].body.check_out().request_id(), asked.body.check_out().request_id());
    EXPECT_TRUE(link.sent[0].body.check_out().wait());
}

TEST_F(CheckOutsTest, WhenTheTimeIsUpThePlaceIsGivenBack) {
    heldByAnother(3);
    core.checkOuts().checkOut({"Cyton"}, waiting(7s), answer.taker());
    answerPlace(link.take().at(0), 3);
    advance(5s);
    link.sent.clear();
    advance(2s);
    EXPECT_EQ(answer.refusal.code, RefusalCode::TimedOut);
    EXPECT_THAT(answer.refusal.message, HasSubstr("was 3"));
    EXPECT_EQ(answer.refusal.holder, "client2@lab");
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].body.check_out().phase(), proto::ABORT);
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
}

TEST_F(CheckOutsTest, AWaitCanBeGivenUpAndALateGrantGoesBack) {
    const auto id = core.checkOuts().checkOut({"Cyton"}, waiting(60s), answer.taker());
    const auto asked = link.take().at(0);
    answerPlace(asked, 1);
    core.checkOuts().giveUp(id);
    core.checkOuts().giveUp(id);
    EXPECT_EQ(answer.count, 1);
    EXPECT_EQ(answer.refusal.code, RefusalCode::Cancelled);
    EXPECT_THAT(phase(link.take(), proto::ABORT), SizeIs(1));
    answerCheckOut(asked);
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_TRUE(link.sent[0].body.has_release());
}

TEST_F(CheckOutsTest, AWaitEndsWithTheEntityAndWithTheConnection) {
    Answer<std::vector<Held>> second;
    core.checkOuts().checkOut({"Cyton"}, waiting(60s), answer.taker());
    answerPlace(link.take().at(0), 1);
    core.onProfile(Presence::Left, {uuid(3), "Cyton"}, {});
    EXPECT_EQ(answer.refusal.code, RefusalCode::Unavailable);
    core.checkOuts().checkOut({"PeopleBot#1"}, waiting(60s), second.taker());
    answerPlace(link.take().at(0), 1);
    loseConnection();
    EXPECT_EQ(second.refusal.code, RefusalCode::NotConnected);
}

TEST_F(CheckOutsTest, TheHolderIsAskedOnceAndRefuses) {
    heldByAnother(3);
    auto options = waiting(60s);
    options.wait.reset();
    options.ask = true;
    options.reason = "a demonstration";
    core.checkOuts().checkOut({"Cyton"}, options, answer.taker());
    const auto asked = link.take().at(0);
    EXPECT_TRUE(asked.body.check_out().ask());
    EXPECT_FALSE(asked.body.check_out().wait());
    EXPECT_EQ(asked.body.check_out().reason(), "a demonstration");
    answerPlace(asked, 0);
    ASSERT_THAT(told, SizeIs(1));
    EXPECT_THAT(told[0].message, HasSubstr("client2@lab has been asked"));
    advance(29s);
    EXPECT_THAT(link.sent, IsEmpty()) << "one question is enough";
    answerCheckOut(asked, RefusalCode::HandOverRefused);
    EXPECT_EQ(answer.refusal.code, RefusalCode::HandOverRefused);
}

TEST_F(CheckOutsTest, AQuestionThatNobodyAnswersIsWithdrawnWhenTheTimeIsUp) {
    auto options = waiting(10s);
    options.ask = true;
    core.checkOuts().checkOut({"Cyton"}, options, answer.taker());
    const auto asked = link.take().at(0);
    EXPECT_TRUE(asked.body.check_out().wait()) << "in line when the answer is no";
    answerPlace(asked, 1);
    EXPECT_THAT(told.at(0).message, HasSubstr("has been asked; place 1"));
    advance(5s);
    advance(5s);
    EXPECT_EQ(answer.refusal.code, RefusalCode::TimedOut);
    EXPECT_THAT(phase(link.take(), proto::ABORT), SizeIs(1));
}

TEST_F(CheckOutsTest, ForceAndItsReasonTravelInEachPhase) {
    CheckOutOptions options;
    options.force = true;
    options.reason = "fire drill";
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, options, answer.taker());
    const auto reserved = link.take();
    for (const auto& message : reserved) {
        EXPECT_TRUE(message.body.check_out().force());
        EXPECT_EQ(message.body.check_out().reason(), "fire drill");
        answerCheckOut(message);
    }
    for (const auto& message : phase(link.take(), proto::COMMIT))
        EXPECT_TRUE(message.body.check_out().force());
}

TEST_F(CheckOutsTest, WhatMakesNoSenseIsRefusedAtOnce) {
    CheckOutOptions both;
    both.ask = both.force = true;
    core.checkOuts().checkOut({"Cyton"}, both, answer.taker());
    EXPECT_EQ(answer.refusal.code, RefusalCode::Malformed);
    CheckOutOptions asks;
    asks.ask = true;
    core.checkOuts().checkOut({"Cyton", "PeopleBot#1"}, asks, answer.taker());
    EXPECT_EQ(answer.refusal.code, RefusalCode::NotSupported);
    core.checkOuts().checkOut(parseQuery("1 ROBOT").value(), asks, answer.taker());
    EXPECT_EQ(answer.refusal.code, RefusalCode::Malformed);
    EXPECT_THAT(link.sent, IsEmpty());
}

TEST_F(CheckOutsTest, TheHandOverPolicyGoesWithTheLease) {
    CheckOutOptions options;
    options.hand_over = {20s, true};
    core.checkOuts().checkOut({"Cyton"}, options, answer.taker());
    const auto& policy = link.sent.at(0).body.check_out().hand_over();
    EXPECT_DOUBLE_EQ(policy.answer_within_s(), 20);
    EXPECT_TRUE(policy.yield());
}

TEST_F(CheckOutsTest, SeveralAreParkedUntilAllAreFree) {
    idle(1);
    heldByAnother(3);
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, waiting(60s), answer.taker());
    const auto reserved = link.take();
    answerCheckOut(reserved[0]);
    answerCheckOut(reserved[1], RefusalCode::AlreadyHeld);
    EXPECT_EQ(answer.count, 0);
    ASSERT_THAT(told, SizeIs(1));
    EXPECT_THAT(told[0].message, HasSubstr("Cyton"));
    const auto aborted = link.take();
    ASSERT_THAT(aborted, SizeIs(1));
    EXPECT_EQ(aborted[0].head.entity, uuid(1));
    advance(5s);
    EXPECT_THAT(link.sent, IsEmpty()) << "Cyton is still held";

    idle(3);
    const auto again = phase(link.take(), proto::RESERVE);
    ASSERT_THAT(again, SizeIs(2));
    EXPECT_NE(again[0].body.check_out().request_id(), reserved[0].body.check_out().request_id());
    for (const auto& message : again) answerCheckOut(message);
    for (const auto& message : link.take()) answerCheckOut(message);
    EXPECT_EQ(answer.count, 1);
    EXPECT_THAT(core.leases().held(), SizeIs(2));
}

TEST_F(CheckOutsTest, WhoLosesARaceTriesAgainALittleLater) {
    idle(1);
    idle(3);
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, waiting(60s), answer.taker());
    answerCheckOut(link.take().at(0), RefusalCode::Reserved);
    link.sent.clear();
    idle(1);
    EXPECT_THAT(link.sent, IsEmpty()) << "not at once: the other one would be as quick";
    advance(400ms);
    EXPECT_THAT(phase(link.take(), proto::RESERVE), SizeIs(2));
}

TEST_F(CheckOutsTest, SeveralThatDoNotBecomeFreeInTimeAreRefusedWithTheReason) {
    heldByAnother(3);
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, waiting(8s), answer.taker());
    answerCheckOut(link.take().at(1), RefusalCode::AlreadyHeld);
    advance(5s);
    advance(3s);
    EXPECT_EQ(answer.refusal.code, RefusalCode::TimedOut);
    EXPECT_EQ(answer.refusal.holder, "client2@lab");
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
}

TEST_F(CheckOutsTest, ACheckOutOfSeveralThatFailsLeavesANewerOneAlone) {
    idle(1);
    idle(3);
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, {}, answer.taker());
    for (const auto& message : link.take()) answerCheckOut(message);  // reserved
    const auto committed = link.take();
    ASSERT_THAT(committed, SizeIs(2));
    answerCheckOut(committed[0], RefusalCode::Ok, 1);  // and the other one is silent
    ASSERT_THAT(core.leases().held(), SizeIs(1));
    core.leases().release(core.leases().held()[0], [](const Result<void>&) {});

    Answer<std::vector<Held>> newer;
    core.checkOuts().checkOut({"PeopleBot#1"}, {}, newer.taker());
    answerCheckOut(link.sent.back(), RefusalCode::Ok, 2);
    ASSERT_TRUE(newer.refusal.ok());
    advance(1h);
    EXPECT_EQ(answer.count, 1);
    EXPECT_FALSE(answer.refusal.ok());
    ASSERT_THAT(core.leases().held(), SizeIs(1)) << "or the entity keeps a holder who does not know of it";
    EXPECT_EQ(core.leases().held()[0].lease.number, 2);
}

TEST_F(CheckOutsTest, AParkedCheckOutEndsWhenAnEntityLeaves) {
    heldByAnother(3);
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, waiting(60s), answer.taker());
    answerCheckOut(link.take().at(1), RefusalCode::AlreadyHeld);
    core.onProfile(Presence::Left, {uuid(1), "PeopleBot"}, {});
    EXPECT_EQ(answer.refusal.code, RefusalCode::Unavailable);
}

TEST_F(CheckOutsTest, AQueryChoosesAmongWhatIsFreeAndReady) {
    core.onStatus({uuid(1), EntityState::IDLE, true, 1, {}, {}, {}});
    idle(2);
    join(4, "Arm", "STATIONARY");
    idle(4);
    core.checkOuts().checkOut(parseQuery("1 ROBOT/MOBILE + 1 STATIONARY").value(), {}, answer.taker());
    const auto asked = link.take();
    ASSERT_THAT(asked, SizeIs(2));
    EXPECT_EQ(asked[0].head.entity, uuid(2)) << "the first PeopleBot is stopped";
    EXPECT_EQ(asked[1].head.entity, uuid(4));
    EXPECT_EQ(asked[0].body.check_out().phase(), proto::RESERVE);
    for (const auto& message : asked) answerCheckOut(message);
    for (const auto& message : link.take()) answerCheckOut(message);
    EXPECT_THAT(core.leases().held(), SizeIs(2));
}

TEST_F(CheckOutsTest, AQueryTriesOthersWhenARaceIsLost) {
    for (int i = 1; i <= 3; ++i) idle(i);
    core.checkOuts().checkOut(parseQuery("1 ROBOT").value(), {}, answer.taker());
    const auto first = link.take().at(0);
    EXPECT_EQ(first.body.check_out().phase(), proto::TAKE);
    answerCheckOut(first, RefusalCode::AlreadyHeld);
    const auto second = link.take().at(0);
    EXPECT_NE(second.head.entity, first.head.entity);
    core.onRefusal(second.head, {RefusalCode::UnknownEntity, "gone", {}});
    const auto third = link.take().at(0);
    answerCheckOut(third);
    EXPECT_EQ(answer.count, 1);
    EXPECT_TRUE(answer.refusal.ok());
}

TEST_F(CheckOutsTest, AQueryThatCannotBeServedSaysWhatIsMissing) {
    idle(1);
    heldByAnother(2);
    status(3, EntityState::UNAV);
    core.checkOuts().checkOut(parseQuery("3 ROBOT/MOBILE + 1 MACHINE").value(), {}, answer.taker());
    EXPECT_EQ(answer.refusal.code, RefusalCode::AlreadyHeld);
    EXPECT_EQ(answer.refusal.holder, "client2@lab");
    EXPECT_THAT(answer.refusal.message, HasSubstr("2 of 3 ROBOT/MOBILE are missing"));
    EXPECT_THAT(answer.refusal.message, HasSubstr("PeopleBot#2 is held by client2@lab"));
    EXPECT_THAT(answer.refusal.message, HasSubstr("Cyton is UNAV"));
    EXPECT_THAT(answer.refusal.message, HasSubstr("1 of 1 MACHINE is missing: there is none"));
    EXPECT_THAT(link.sent, IsEmpty());
}

TEST_F(CheckOutsTest, AQueryIsAnsweredWhenEverybodyWasFaster) {
    for (int i = 1; i <= 3; ++i) idle(i);
    core.checkOuts().checkOut(parseQuery("1 ROBOT").value(), {}, answer.taker());
    for (int i = 0; i < 3; ++i) answerCheckOut(link.take().at(0), RefusalCode::AlreadyHeld);
    EXPECT_EQ(answer.count, 1);
    EXPECT_EQ(answer.refusal.code, RefusalCode::AlreadyHeld);
    EXPECT_THAT(link.sent, IsEmpty());
}

TEST_F(CheckOutsTest, AQueryWaitsUntilEnoughAreFree) {
    heldByAnother(1);
    core.checkOuts().checkOut(parseQuery("1 ROBOT").value(), waiting(60s), answer.taker());
    EXPECT_THAT(link.sent, IsEmpty());
    ASSERT_THAT(told, SizeIs(1));
    idle(1);
    ASSERT_THAT(link.sent, SizeIs(1));
    answerCheckOut(link.take().at(0));
    EXPECT_TRUE(answer.refusal.ok());
    EXPECT_THAT(core.leases().held(), SizeIs(1));
}

TEST_F(CheckOutsTest, ASilentEntityIsPassedOver) {
    idle(1);
    idle(2);
    core.checkOuts().checkOut(parseQuery("1 ROBOT").value(), {}, answer.taker());
    link.sent.clear();
    advance(5s);
    const auto sent = link.take();
    EXPECT_THAT(phase(sent, proto::ABORT), SizeIs(1));
    const auto second = phase(sent, proto::TAKE);
    ASSERT_THAT(second, SizeIs(1));
    answerCheckOut(second[0]);
    EXPECT_TRUE(answer.refusal.ok());
}

TEST_F(CheckOutsTest, AQueryLooksForAnotherWhenTheOneItHasAskedLeaves) {
    idle(1);
    idle(2);
    core.checkOuts().checkOut(parseQuery("1 ROBOT").value(), {}, answer.taker());
    const auto first = link.take().at(0);
    core.onProfile(Presence::Left, {first.head.entity, "PeopleBot", "ROBOT", "MOBILE"}, {});
    EXPECT_EQ(answer.count, 0);
    const auto second = link.take();
    ASSERT_THAT(second, SizeIs(1));
    EXPECT_NE(second[0].head.entity, first.head.entity);
    answerCheckOut(second[0]);
    EXPECT_TRUE(answer.refusal.ok());
}

TEST_F(CheckOutsTest, WhatIsTakenByForceAndGivenUpIsAborted) {
    CheckOutOptions force;
    force.force = true;
    core.checkOuts().checkOut({"Cyton"}, force, answer.taker());
    link.sent.clear();
    advance(5s);
    EXPECT_EQ(answer.refusal.code, RefusalCode::TimedOut);
    EXPECT_THAT(phase(link.sent, proto::ABORT), SizeIs(1));
}

TEST_F(CheckOutsTest, WhoWaitsOnAfterTheHolderKeepsItIsToldSo) {
    heldByAnother(3);
    auto options = waiting(60s);
    options.ask = true;
    core.checkOuts().checkOut({"Cyton"}, options, answer.taker());
    const auto asked = link.take().at(0);
    answerPlace(asked, 1);
    EXPECT_THAT(told.back().message, HasSubstr("has been asked"));
    answerPlace(asked, 2, "client2@lab keeps it: ten more minutes.");
    EXPECT_EQ(told.back().message,
              "client2@lab keeps it: ten more minutes; place 2 in the wait list of Cyton, which is held by "
              "client2@lab.");
    answerPlace(asked, 1);
    EXPECT_THAT(told.back().message, HasSubstr("keeps it")) << "it is not asked again";
}

TEST_F(CheckOutsTest, AQueryByServiceAsksTheCandidatesFirst) {
    idle(1);
    idle(3);
    core.checkOuts().checkOut(parseQuery("1 ROBOT with gripping").value(), {}, answer.taker());
    const auto questions = link.take();
    ASSERT_THAT(questions, SizeIs(2));
    for (const auto& question : questions) {
        ASSERT_TRUE(question.body.status_request().with_services());
        proto::ToClient message;
        message.mutable_status()->set_request_id(question.body.status_request().request_id());
        message.mutable_status()->set_state(proto::IDLE);
        message.mutable_status()->add_services()->set_name(question.head.entity == uuid(3) ? "Gripping"
                                                                                           : "Driving");
        Header head;
        head.entity = question.head.entity;
        core.onEntityMsg(head, message.SerializeAsString());
    }
    const auto asked = phase(link.take(), proto::TAKE);
    ASSERT_THAT(asked, SizeIs(1));
    EXPECT_EQ(asked[0].head.entity, uuid(3));
}

TEST_F(CheckOutsTest, AServiceThatNobodyOffersIsNamed) {
    idle(3);
    core.checkOuts().checkOut(parseQuery("1 ROBOT with Flying").value(), {}, answer.taker());
    link.sent.clear();
    advance(5s);
    EXPECT_EQ(answer.count, 1);
    EXPECT_THAT(answer.refusal.message, HasSubstr("Cyton does not offer Flying"));
    EXPECT_EQ(core.pendingRequests(), 0U);
}

TEST_F(CheckOutsTest, TheHolderIsToldAndAnswersOnce) {
    const auto held = take("Cyton");
    EXPECT_EQ(core.leases().answerHandOver(held, true, "").refusal().code, RefusalCode::WrongState);
    ask("question-1", "a demonstration");
    ask("question-1", "a demonstration");
    ASSERT_THAT(observer.hand_overs, SizeIs(1));
    EXPECT_EQ(observer.hand_overs[0].by, "client2@lab");
    EXPECT_EQ(core.leases().question(held)->reason, "a demonstration");
    const auto within = observer.hand_overs[0].answer_within;
    advance(2s);
    EXPECT_DOUBLE_EQ(core.leases().question(held)->answer_within.count(), within.count() - 2)
        << "what is left of the time";
    ASSERT_TRUE(core.leases().answerHandOver(held, false, "in the middle of something").ok());
    ASSERT_THAT(link.sent, SizeIs(1));
    const auto& said = link.sent[0].body.hand_over_answer();
    EXPECT_EQ(said.request_id(), "question-1");
    EXPECT_FALSE(said.accept());
    EXPECT_EQ(said.reason(), "in the middle of something");
    EXPECT_EQ(link.sent[0].head.held, held.lease);
    EXPECT_EQ(core.leases().answerHandOver(held, true, "").refusal().code, RefusalCode::WrongState);
}

TEST_F(CheckOutsTest, AWithdrawnQuestionCannotBeAnswered) {
    const auto held = take("Cyton");
    ask("question-1", "");
    ask("question-0", "", true);
    EXPECT_TRUE(core.leases().question(held)) << "another one was withdrawn";
    ask("question-1", "", true);
    EXPECT_FALSE(core.leases().question(held));
    ASSERT_THAT(observer.hand_overs, SizeIs(2));
    EXPECT_TRUE(observer.hand_overs[1].withdrawn);
}

TEST_F(CheckOutsTest, WhoRefusesAlwaysIsNotAsked) {
    const auto held = take("Cyton");
    ASSERT_TRUE(core.leases().setHandOverPolicy(held, {30s, false, true}).ok());
    EXPECT_FALSE(link.take().at(0).body.hand_over_policy().yield());
    ask("question-1", "");
    EXPECT_THAT(observer.hand_overs, IsEmpty());
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_FALSE(link.sent[0].body.hand_over_answer().accept());
}

TEST_F(CheckOutsTest, ALeaseIsResumedWithItsKey) {
    const auto held = take("Cyton", 4, 5s);
    loseConnection();
    EXPECT_THAT(observer.orphaned, ElementsAre(held));
    EXPECT_THAT(observer.lost, IsEmpty());
    EXPECT_TRUE(core.leases().holds(held) && core.leases().orphaned(held));
    EXPECT_EQ(core.commands().sendText(held, "x").refusal().code, RefusalCode::NotConnected);

    connect();
    const auto asked = phase(link.take(), proto::RESUME_LEASE);
    ASSERT_THAT(asked, SizeIs(1));
    EXPECT_EQ(asked[0].head.entity, uuid(3));
    EXPECT_EQ(asked[0].body.check_out().resume().number(), 4U);
    EXPECT_EQ(asked[0].body.check_out().resume().key(), "0123456789abcdef");
    EXPECT_EQ(core.commands().sendText(held, "x").refusal().code, RefusalCode::NotConnected)
        << "not before the answer";

    answerResume(asked[0], RefusalCode::Ok, 4);
    EXPECT_THAT(observer.resumed, ElementsAre(held));
    EXPECT_FALSE(core.leases().orphaned(held));
    EXPECT_TRUE(core.commands().sendText(held, "x").ok());
    EXPECT_EQ(core.pendingRequests(), 0U);
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
}

TEST_F(CheckOutsTest, AProfileThatOvertakesTheHandshakeIsResumedToo) {
    take("Cyton", 1, 5s);
    loseConnection();
    join(3, "Cyton");
    EXPECT_THAT(link.sent, IsEmpty());
    core.onConnected(kMe, 1);
    EXPECT_THAT(phase(link.take(), proto::RESUME_LEASE), SizeIs(1));
}

TEST_F(CheckOutsTest, ARefusedResumeIsALostLease) {
    const auto held = take("Cyton", 1, 5s);
    const auto task = core.tasks().run(held, "Driving", {}, {});
    loseConnection();
    EXPECT_FALSE(isFinal(core.tasks().report(task)->state)) << "nobody knows yet";
    connect();
    answerResume(phase(link.take(), proto::RESUME_LEASE).at(0), RefusalCode::RevokedLease);
    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].second.code, RefusalCode::RevokedLease);
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Unknown);
    EXPECT_THAT(core.leases().held(), IsEmpty());
}

TEST_F(CheckOutsTest, WithoutGraceTheLeaseGoesWithTheConnection) {
    take("Cyton", 1, 0s);
    loseConnection();
    EXPECT_THAT(observer.lost, SizeIs(1));
    SessionCoreSettings settings;
    settings.resume = false;
    CoreWorld world(settings);
    world.connect();
    world.take("Cyton", 1, 5s);
    world.core.onDisconnected("cable cut");
    EXPECT_THAT(world.observer.lost, SizeIs(1));
}

TEST_F(CheckOutsTest, ALeaseIsLostWhenTheConnectionIsNotBackInTime) {
    const auto held = take("Cyton", 1, 5s);
    loseConnection();
    advance(14999ms);
    EXPECT_TRUE(core.leases().holds(held));
    core.onDisconnected("no server");  // a login that failed does not make the time longer
    advance(1ms);
    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].second.code, RefusalCode::NotConnected);
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
}

TEST_F(CheckOutsTest, AResumeThatNobodyAnswersIsAskedAgain) {
    take("Cyton", 1, 5s);
    loseConnection();
    connect();
    link.sent.clear();
    advance(5s);
    EXPECT_THAT(phase(link.take(), proto::RESUME_LEASE), SizeIs(1));
    advance(10s);
    EXPECT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(core.pendingRequests(), 0U);
}

TEST_F(CheckOutsTest, AnEntityThatIsNotThereYetIsResumedWhenItJoins) {
    take("Cyton", 1, 5s);
    loseConnection();
    core.onConnected(kMe, 3);
    EXPECT_THAT(link.sent, IsEmpty());
    join(3, "Cyton");
    const auto asked = phase(link.take(), proto::RESUME_LEASE);
    ASSERT_THAT(asked, SizeIs(1));
    core.onRefusal(asked[0].head, {RefusalCode::UnknownEntity, "gone again", {}});
    EXPECT_THAT(observer.lost, IsEmpty());
    core.onProfile(Presence::Left, {uuid(3), "Cyton"}, {});
    join(3, "Cyton");
    EXPECT_THAT(phase(link.take(), proto::RESUME_LEASE), SizeIs(1));
}

TEST_F(CheckOutsTest, AnEntityThatLeavesHasTheGraceToComeBack) {
    const auto held = take("Cyton", 1, 5s);
    const auto task = core.tasks().run(held, "Driving", {}, {});
    core.onProfile(Presence::Left, {uuid(3), "Cyton"}, {});
    EXPECT_TRUE(core.leases().orphaned(held));
    join(3, "Cyton");
    answerResume(phase(link.take(), proto::RESUME_LEASE).at(0));
    EXPECT_FALSE(core.leases().orphaned(held));
    core.onProfile(Presence::Left, {uuid(3), "Cyton"}, {});
    advance(4900ms);
    EXPECT_THAT(observer.lost, IsEmpty()) << "another server takes it";
    advance(100ms);
    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].second.code, RefusalCode::Unavailable);
    EXPECT_THAT(observer.lost[0].second.message, HasSubstr("Cyton has left"));
    EXPECT_EQ(core.tasks().report(task)->state, TaskState::Unknown);
}

TEST_F(CheckOutsTest, AnEntityThatWasAwayIsResumedAlsoIfNobodyToldThatItHadLeft) {
    const auto held = take("Cyton", 1, 5s);
    link.sent.clear();
    EntityStatus waits{uuid(3), EntityState::REG, true, 0, kMe, held.lease, {}};
    waits.orphaned = true;
    auto of_an_earlier_lease = waits;
    of_an_earlier_lease.held.number = 0;
    core.onStatus(of_an_earlier_lease);
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
    core.onStatus(waits);
    advance(900ms);
    core.onStatus(waits);
    EXPECT_THAT(link.sent, IsEmpty()) << "the news of it may follow";
    advance(100ms);
    EXPECT_TRUE(core.leases().orphaned(held));
    auto asked = phase(link.take(), proto::RESUME_LEASE);
    ASSERT_THAT(asked, SizeIs(1));
    core.onStatus(waits);
    EXPECT_THAT(link.sent, IsEmpty()) << "it is being asked";
    core.onRefusal(asked[0].head, {RefusalCode::UnknownEntity, "it is on its way", {}});
    advance(500ms);
    asked = phase(link.take(), proto::RESUME_LEASE);
    ASSERT_THAT(asked, SizeIs(1)) << "nothing will tell that it joins";
    answerResume(asked[0]);
    EXPECT_FALSE(core.leases().orphaned(held));
    EXPECT_THAT(observer.resumed, ElementsAre(held));
    EXPECT_THAT(observer.lost, IsEmpty());
}

TEST_F(CheckOutsTest, AnEntityThatWaitedForUsForAMomentOnlyWasNotLost) {
    const auto held = take("Cyton", 1, 5s);
    link.sent.clear();
    EntityStatus its{uuid(3), EntityState::REG, true, 0, kMe, held.lease, {}};
    its.orphaned = true;
    core.onStatus(its);
    its.orphaned = false;
    core.onStatus(its);
    advance(5s);
    EXPECT_FALSE(core.leases().orphaned(held));
    EXPECT_THAT(link.sent, IsEmpty());
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
}

TEST_F(CheckOutsTest, TheServerIsNotExpectedToBeatFastForAnEntityThatHasLeft) {
    take("Cyton", 1, 5s);
    status(3, EntityState::BUSY, kMe, {1, 1});
    EXPECT_LE(core.serverDeadline(), clock.now() + 1s);
    core.onProfile(Presence::Left, {uuid(3), "Cyton"}, {});
    EXPECT_GT(core.serverDeadline(), clock.now() + 5s) << "the connection would be given up after a second";
}

TEST_F(CheckOutsTest, AServerThatEndsTakesItsEntitiesWithItAndTheLeaseIsStillResumed) {
    const auto held = take("Cyton", 1, 5s);
    core.onProfile(Presence::Left, {uuid(3), "Cyton"}, {});
    loseConnection();
    advance(10s);
    EXPECT_TRUE(core.leases().holds(held)) << "the time of the connection counts, not that of the entity";
    connect();
    EXPECT_THAT(phase(link.take(), proto::RESUME_LEASE), SizeIs(1));
}

TEST_F(CheckOutsTest, TasksAreToldAsTheyEndedAndAreUnknownOnlyWhereNobodyKnows) {
    const auto held = take("Cyton", 1, 5s);
    const auto ended = core.tasks().run(held, "Driving", {}, {});
    const auto runs = core.tasks().run(held, "Driving", {}, {});
    const auto remembered = core.tasks().run(held, "Driving", {}, {});
    const auto never_heard_of = core.tasks().run(held, "Driving", {}, {});
    for (const auto task : {ended, runs}) taskEvent(3, task, proto::TASK_RUNNING);
    loseConnection();
    EXPECT_EQ(core.tasks().report(runs)->state, TaskState::Running);
    connect();
    answerResume(phase(link.take(), proto::RESUME_LEASE).at(0));
    const auto asked = link.take();
    ASSERT_THAT(asked, SizeIs(1));
    ASSERT_TRUE(asked[0].body.has_status_request());
    const auto later = core.tasks().run(held, "Driving", {}, {});

    taskEvent(3, ended, proto::TASK_STOPPED);
    proto::ToClient message;
    auto& status = *message.mutable_status();
    status.set_request_id(asked[0].body.status_request().request_id());
    status.set_state(proto::BUSY);
    status.add_tasks()->set_task_id(runs.bytes());
    status.mutable_tasks(0)->set_state(proto::TASK_RUNNING);
    status.add_ended()->set_task_id(remembered.bytes());
    status.mutable_ended(0)->set_state(proto::TASK_FAILED);
    fromEntity(3, message);

    EXPECT_EQ(core.tasks().report(ended)->state, TaskState::Stopped);
    EXPECT_EQ(core.tasks().report(remembered)->state, TaskState::Failed);
    EXPECT_EQ(core.tasks().report(runs)->state, TaskState::Running);
    EXPECT_EQ(core.tasks().report(never_heard_of)->state, TaskState::Unknown);
    EXPECT_EQ(core.tasks().report(later)->state, TaskState::Queued) << "asked for after the question";
}

TEST_F(CheckOutsTest, ANewerHolderEndsAnOrphanedLease) {
    take("Cyton", 1, 5s);
    loseConnection();
    connect();
    status(3, EntityState::REG, {"other", "client2@lab"}, {1, 2});
    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].second.holder, "client2@lab");
    EXPECT_EQ(core.pendingRequests(), 0U);
}

TEST_F(CheckOutsTest, ClosingKeepsNothing) {
    const auto held = take("Cyton", 1, 5s);
    const auto other = take("PeopleBot#1", 1, 5s);
    loseConnection();
    Answer<void> released;
    core.leases().release(held, released.taker());
    EXPECT_TRUE(released.refusal.ok()) << "given up, though nobody can be told";
    core.onDisconnected("closed", true);
    ASSERT_THAT(observer.lost, SizeIs(1));
    EXPECT_EQ(observer.lost[0].first, other);
    EXPECT_EQ(core.pendingRequests(), 0U);
    EXPECT_EQ(core.nextDeadline(), TimePoint::max());
}

TEST_F(CheckOutsTest, ATicketTakesALeaseToAnotherProcess) {
    const auto ticket = core.leases().ticket(take("Cyton", 4, 5s)).value();
    CoreWorld other;
    other.connect();
    const auto read = LeaseTicket::parse(ticket.toText());
    ASSERT_TRUE(read.ok());
    other.core.checkOuts().resume(read.value(), answer.taker());
    const auto asked = other.link.take().at(0);
    EXPECT_EQ(asked.body.check_out().phase(), proto::RESUME_LEASE);
    EXPECT_EQ(asked.body.check_out().resume().key(), "0123456789abcdef");
    other.answerCheckOut(asked, RefusalCode::Ok, 4, 5s);
    EXPECT_TRUE(answer.refusal.ok());
    EXPECT_THAT(other.core.leases().held(), ElementsAre(Held{uuid(3), {1, 4}}));
}

TEST_F(CheckOutsTest, OnlyATicketIsATicket) {
    for (const auto& text : std::vector<std::string>{
             "", "axon-lease", "axon-lease:x:1:1:y", "axon-lease:" + uuid(3) + ":1:-1:" + uuid(1),
             "axon-lease:" + uuid(3) + ":1:99999999999:" + uuid(1), "other:" + uuid(3) + ":1:1:" + uuid(1)}) {
        EXPECT_EQ(LeaseTicket::parse(text).refusal().code, RefusalCode::Malformed) << text;
    }
    EXPECT_TRUE(LeaseTicket::parse("axon-lease:" + uuid(3) + ":1:1:" + uuid(1)).ok());
}

TEST(FinishedTasksTest, ATableOfOneForgetsWhileALeaseEnds) {
    SessionCoreSettings settings;
    settings.tasks_kept = 1;
    CoreWorld world(settings);
    world.connect();
    const auto held = world.take("Cyton");
    std::vector<Id128> tasks;
    for (int i = 0; i < 5; ++i) tasks.push_back(world.core.tasks().run(held, "Driving", {}, {}));
    Answer<void> pause;
    world.taskEvent(3, tasks[0], proto::TASK_RUNNING);
    world.core.tasks().control(tasks[0], proto::PAUSE, pause.taker());
    // The refusal of one task ends the lease, which ends the others: the first report is forgotten on the
    // way.
    proto::ToClient message;
    message.mutable_task()->set_task_id(tasks[4].bytes());
    message.mutable_task()->set_state(proto::TASK_REFUSED);
    message.mutable_task()->mutable_reason()->set_code(proto::NOT_HOLDER);
    world.fromEntity(3, message);
    EXPECT_EQ(pause.count, 1);
    EXPECT_THAT(world.observer.tasks, SizeIs(6));
    EXPECT_THAT(world.observer.lost, SizeIs(1));
    EXPECT_FALSE(world.core.busy());
}

TEST(ManyRequestsTest, EachIsFoundByItsSequenceAndByItsEntity) {
    CoreWorld world;
    world.connect();
    const auto held = world.take("Cyton");
    std::vector<Answer<void>> answers(50);
    for (auto& answer : answers)
        world.core.commands().set(held, "Driving", {"Distance", {std::int64_t{1}}}, answer.taker());
    const auto sent = world.link.take();
    world.core.onRefusal(sent[20].head, {RefusalCode::Overloaded, "no", {}});
    EXPECT_EQ(answers[20].refusal.code, RefusalCode::Overloaded);
    auto head = sent[21].head;
    head.entity = uuid(1);
    world.core.onRefusal(head, {RefusalCode::Overloaded, "of another entity", {}});
    EXPECT_EQ(answers[21].count, 0);
    world.core.onProfile(Presence::Left, {uuid(1), "PeopleBot"}, {});
    EXPECT_EQ(world.core.pendingRequests(), 49U);
    world.core.onProfile(Presence::Left, {uuid(3), "Cyton"}, {});
    EXPECT_EQ(world.core.pendingRequests(), 0U);
    for (const auto& answer : answers) EXPECT_EQ(answer.count, 1);
}

}  // namespace
}  // namespace axon::client::test
