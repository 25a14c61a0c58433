// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/stops/stop_desk.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/testing/test_environment.hpp"

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

struct GivenStop {
    Lane lane;
    Header head;
    std::vector<std::string> entities = {};
    StopCause cause = StopCause::Requested;
};

class RecordingStopLink final : public StopLink {
  public:
    void sendStopSignal(Lane lane, const Header& head, StopCause cause) override {
        sent.push_back({lane, head, {}, cause});
    }
    void sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                         StopCause cause) override {
        sent.push_back({lane, head, std::move(entities), cause});
    }
    std::vector<GivenStop> sent;
};

class StopDeskTest : public ::testing::Test {
  protected:
    StopDeskTest() {
        desk.onConnected(kMe);
        desk.onEntity(Presence::Joined, uuid(1), "PeopleBot");
        desk.onEntity(Presence::Joined, uuid(2), "PeopleBot");
        desk.onEntity(Presence::Joined, uuid(3), "Cyton");
    }
    void stop(const std::vector<std::string>& names, Duration deadline = 1s) {
        desk.stop(names, deadline, [this](Result<std::vector<Receipt>> result) {
            ++answers;
            if (result) {
                receipts = std::move(result).value();
            } else {
                refusal = result.refusal();
            }
        });
    }
    void receipt(int number, proto::StopReceipt::Stage stage, std::int64_t sequence = 1,
                 const std::string& by = kMe.id) {
        proto::StopReceipt message;
        message.set_stop_id(by + ":" + std::to_string(sequence));
        message.set_stop_generation(7);
        message.set_stage(stage);
        message.set_state(proto::REG);
        desk.onReceipt(uuid(number), message);
    }
    void advance(Duration by) {
        clock.advance(by);
        desk.onTimer();
    }

    ManualClock clock;
    RecordingStopLink link;
    SignalMarks marks;
    StopDesk desk{clock, link, marks};
    int answers = 0;
    std::vector<Receipt> receipts;
    Refusal refusal;
};

TEST_F(StopDeskTest, AReceiptCollectsItsStagesWithTheirTimes) {
    stop({"Cyton"});
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].lane, Lane::Signal);
    EXPECT_EQ(link.sent[0].head.entity, uuid(3));
    clock.advance(1ms);
    desk.onStopAccepted(1, uuid(3), 1);
    clock.advance(1ms);
    receipt(3, proto::StopReceipt::MANAGER);
    EXPECT_EQ(answers, 0);
    clock.advance(1ms);
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED);

    EXPECT_EQ(answers, 1);
    ASSERT_THAT(receipts, SizeIs(1));
    EXPECT_TRUE(receipts[0].confirmed());
    EXPECT_EQ(receipts[0].server, Seconds(1ms));
    EXPECT_EQ(receipts[0].manager, Seconds(2ms));
    EXPECT_EQ(receipts[0].callback_returned, Seconds(3ms));
    EXPECT_FALSE(receipts[0].standstill);
    EXPECT_EQ(receipts[0].stop_generation, 7);
    EXPECT_EQ(receipts[0].state, EntityState::REG);
    EXPECT_EQ(marks.of(uuid(3)), 7) << "commands after this stop carry its generation";
}

TEST_F(StopDeskTest, AReceiptThatComesTwiceIsOne) {
    stop({"Cyton", "PeopleBot#1"});
    clock.advance(1ms);
    receipt(3, proto::StopReceipt::MANAGER);
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED);
    clock.advance(1ms);  // by the topic between the servers, after the direct ones
    receipt(3, proto::StopReceipt::MANAGER);
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED);
    EXPECT_EQ(answers, 0) << "the other one has not answered";
    receipt(1, proto::StopReceipt::CALLBACK_RETURNED);
    receipt(1, proto::StopReceipt::CALLBACK_RETURNED);
    EXPECT_EQ(answers, 1);
    ASSERT_THAT(receipts, SizeIs(2));
    for (const auto& one : receipts) {
        EXPECT_TRUE(one.confirmed());
        if (one.entity == uuid(3)) {
            EXPECT_EQ(one.manager, Seconds(1ms)) << "the first counts";
        }
    }
}

TEST_F(StopDeskTest, WhatComesAgainLateTakesNothingBack) {
    stop({"Cyton"});
    proto::StopReceipt first;
    first.set_stop_id(kMe.id + ":1");
    first.set_stage(proto::StopReceipt::MANAGER);
    first.set_state(proto::BUSY);
    first.set_at_us(100);
    auto second = first;
    second.set_state(proto::ERR);
    second.set_fault("the motors did not answer");
    second.set_at_us(200);
    desk.onReceipt(uuid(3), first);
    desk.onReceipt(uuid(3), second);
    desk.onReceipt(uuid(3), first);
    advance(10s);
    ASSERT_THAT(receipts, SizeIs(1));
    EXPECT_EQ(receipts[0].fault, "the motors did not answer");
    EXPECT_EQ(receipts[0].state, EntityState::ERR);
}

TEST_F(StopDeskTest, ALateStageIsSentAgainOnBothLanesAt100ThenEach250Milliseconds) {
    stop({"Cyton"});
    link.sent.clear();
    advance(99ms);
    EXPECT_THAT(link.sent, IsEmpty());
    EXPECT_EQ(desk.nextDeadline(), clock.now() + 1ms);
    advance(1ms);
    ASSERT_THAT(link.sent, SizeIs(2));
    EXPECT_EQ(link.sent[0].lane, Lane::Signal);
    EXPECT_EQ(link.sent[1].lane, Lane::Data);
    EXPECT_EQ(link.sent[0].head.sequence, 1) << "the same stop, not another one";
    advance(249ms);
    EXPECT_THAT(link.sent, SizeIs(2));
    advance(1ms);
    EXPECT_THAT(link.sent, SizeIs(4));
    advance(650ms);
    EXPECT_EQ(answers, 1) << "the deadline answers with what is known";
    EXPECT_FALSE(receipts.at(0).confirmed());
    EXPECT_EQ(desk.nextDeadline(), TimePoint::max());
}

TEST_F(StopDeskTest, OnlyTheFirstSendingTellsWhichGenerationWasKnown) {
    marks.raise(uuid(3), 6);
    stop({"Cyton"});
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].head.stop_generation, 6);
    marks.raise(uuid(3), 7);  // by this stop itself, whose receipt is lost
    advance(100ms);
    ASSERT_THAT(link.sent, SizeIs(3));
    EXPECT_EQ(link.sent[1].head.stop_generation, 0);
    EXPECT_EQ(link.sent[2].head.stop_generation, 0);
}

TEST_F(StopDeskTest, OnlyWhatIsNotConfirmedIsSentAgain) {
    stop({"Cyton", "PeopleBot#1"});
    receipt(3, proto::StopReceipt::MANAGER);
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED);
    link.sent.clear();
    advance(100ms);
    ASSERT_THAT(link.sent, SizeIs(2));
    EXPECT_EQ(link.sent[0].head.entity, uuid(1));
    EXPECT_EQ(link.sent[1].head.entity, uuid(1));
}

TEST_F(StopDeskTest, WhileAnswersComeNothingIsSentAgainForASecond) {
    stop({"Cyton", "PeopleBot#1"}, 5s);
    link.sent.clear();
    for (int i = 0; i < 9; ++i) {
        advance(90ms);
        receipt(1, proto::StopReceipt::MANAGER);
    }
    EXPECT_THAT(link.sent, IsEmpty());
    advance(90ms);
    EXPECT_THAT(link.sent, IsEmpty()) << "900 ms";
    receipt(1, proto::StopReceipt::MANAGER);
    advance(90ms);
    receipt(1, proto::StopReceipt::MANAGER);
    advance(20ms);
    EXPECT_THAT(link.sent, SizeIs(2)) << "a second has passed";
    advance(100ms);
    link.sent.clear();
    advance(150ms);
    EXPECT_THAT(link.sent, SizeIs(2));
}

TEST_F(StopDeskTest, OfEverythingOnlyThoseThatAreMissingAreAskedAgainOnceAllAreKnown) {
    stop({}, 5s);
    link.sent.clear();
    advance(100ms);
    ASSERT_THAT(link.sent, SizeIs(2));
    EXPECT_THAT(link.sent[0].entities, IsEmpty()) << "nobody has said how many there are";
    desk.onStopAccepted(1, {}, 3);
    receipt(1, proto::StopReceipt::CALLBACK_RETURNED);
    link.sent.clear();
    advance(250ms);
    ASSERT_THAT(link.sent, SizeIs(2));
    EXPECT_THAT(link.sent[0].entities, ElementsAre(uuid(2), uuid(3)));
    EXPECT_EQ(link.sent[0].head.sequence, 1) << "the same stop";
}

TEST_F(StopDeskTest, AStopOfSeveralIsOneMessageOnEachLane) {
    stop({"Cyton", "PeopleBot#1", "PeopleBot#2"});
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].head.entity, "");
    EXPECT_EQ(link.sent[0].head.sequence, 1);
    EXPECT_THAT(link.sent[0].entities, ElementsAre(uuid(1), uuid(2), uuid(3)));
    receipt(2, proto::StopReceipt::CALLBACK_RETURNED);
    link.sent.clear();
    advance(100ms);
    ASSERT_THAT(link.sent, SizeIs(2));
    EXPECT_EQ(link.sent[1].lane, Lane::Data);
    EXPECT_EQ(link.sent[1].head.sequence, 1) << "the same stop";
    EXPECT_THAT(link.sent[1].entities, ElementsAre(uuid(1), uuid(3)));
}

TEST_F(StopDeskTest, AStopOfThousandsIsSeveralMessagesOfOneNumber) {
    std::vector<std::string> names;
    for (int i = 100; i < 5'100; ++i) {
        names.push_back("R" + std::to_string(i));
        desk.onEntity(Presence::Joined, "22222222-1111-4111-8111-" + std::to_string(100'000'000'000 + i),
                      names.back());
    }
    stop(names);
    ASSERT_THAT(link.sent, SizeIs(2));
    EXPECT_EQ(link.sent[0].entities.size() + link.sent[1].entities.size(), names.size());
    EXPECT_LE(link.sent[0].entities.size(), 8192U) << "what a server takes";
    EXPECT_EQ(link.sent[0].head.sequence, link.sent[1].head.sequence);
}

TEST_F(StopDeskTest, TheServersStageOfSeveralIsMarkedWhenItReachedThemAll) {
    stop({"Cyton", "PeopleBot#1"});
    clock.advance(1ms);
    desk.onStopAccepted(1, {}, 1);
    clock.advance(1ms);
    receipt(1, proto::StopReceipt::CALLBACK_RETURNED);
    desk.onStopAccepted(1, {}, 2);
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED);
    ASSERT_THAT(receipts, SizeIs(2));
    EXPECT_EQ(receipts[0].server, Seconds(2ms)) << "one of two may have been either";
    EXPECT_EQ(receipts[1].server, Seconds(2ms));
}

TEST_F(StopDeskTest, StoppingEverythingIsOneRequest) {
    stop({});
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].head.entity, "");
    desk.onStopAccepted(1, {}, 3);
    receipt(1, proto::StopReceipt::NO_APPLICATION);
    receipt(2, proto::StopReceipt::CALLBACK_RETURNED);
    EXPECT_EQ(answers, 0);
    receipt(3, proto::StopReceipt::STANDSTILL);
    EXPECT_EQ(answers, 1);
    ASSERT_THAT(receipts, SizeIs(3));
    EXPECT_TRUE(receipts[0].no_application);
    for (const auto& one : receipts) EXPECT_TRUE(one.confirmed() && one.server);
}

TEST_F(StopDeskTest, AStopOfEverythingKnowsHowManyItReached) {
    stop({});
    receipt(1, proto::StopReceipt::CALLBACK_RETURNED);
    receipt(2, proto::StopReceipt::CALLBACK_RETURNED);
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED);
    EXPECT_EQ(answers, 0) << "nobody has said yet that these are all";
    desk.onStopAccepted(1, {}, 5);
    EXPECT_EQ(answers, 0);
    receipt(4, proto::StopReceipt::CALLBACK_RETURNED);  // not known here, and stopped as well
    advance(1s);
    ASSERT_EQ(answers, 1);
    ASSERT_THAT(receipts, SizeIs(5));
    for (const auto& one : receipts) EXPECT_EQ(one.confirmed(), !one.entity.empty()) << one.name;
}

TEST_F(StopDeskTest, AStopNeedsNoListOfEntities) {
    desk.onDisconnected();
    desk.onConnected(kMe);
    stop({});
    ASSERT_THAT(link.sent, SizeIs(1)) << "sent before the first profile has come";
    desk.onEntity(Presence::Joined, uuid(1), "PeopleBot");
    desk.onStopAccepted(1, {}, 1);
    EXPECT_EQ(answers, 0);
    receipt(1, proto::StopReceipt::CALLBACK_RETURNED);
    EXPECT_EQ(answers, 1);
    ASSERT_THAT(receipts, SizeIs(1));
    EXPECT_EQ(receipts[0].name, "PeopleBot");
    EXPECT_TRUE(receipts[0].confirmed() && receipts[0].server);
}

TEST_F(StopDeskTest, AStopThatReachesNothingHasNoReceipts) {
    desk.onDisconnected();
    desk.onConnected(kMe);
    stop({});
    desk.onStopAccepted(1, {}, 0);
    EXPECT_EQ(answers, 1);
    EXPECT_TRUE(refusal.ok());
    EXPECT_THAT(receipts, IsEmpty());
}

TEST_F(StopDeskTest, ReceiptsHaveTheNamesOfWhenItWasGiven) {
    stop({"Cyton"});
    desk.onEntity(Presence::Left, uuid(3), "Cyton");
    advance(1s);
    ASSERT_THAT(receipts, SizeIs(1));
    EXPECT_EQ(receipts[0].name, "Cyton");
    desk.onEntity(Presence::Joined, uuid(3), "Cyton");
    stop({"Cyton"});
    desk.onEntity(Presence::Changed, uuid(3), "Another");
    advance(1s);
    ASSERT_THAT(receipts, SizeIs(1));
    EXPECT_EQ(receipts[0].name, "Cyton");
    stop({});
    desk.onDisconnected();
    advance(1s);
    ASSERT_THAT(receipts, SizeIs(3));
    EXPECT_EQ(receipts[0].name, "PeopleBot#1");
}

TEST_F(StopDeskTest, TheServersStageIsThatOfTheEntityItNames) {
    stop({"PeopleBot#1", "Cyton"});
    desk.onStopAccepted(1, uuid(1), 1);
    desk.onStopAccepted(1, uuid(3), 0);  // it knows no such entity
    advance(1s);
    ASSERT_THAT(receipts, SizeIs(2));
    EXPECT_TRUE(receipts[0].server);
    EXPECT_FALSE(receipts[1].server);
}

TEST_F(StopDeskTest, InDoubtItStops) {
    stop({"PeopleBot"});
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_THAT(link.sent[0].entities, ElementsAre(uuid(1), uuid(2))) << "both that the name may mean";
    link.sent.clear();
    stop({"Nobody", "Cyton"});
    EXPECT_THAT(link.sent, SizeIs(1)) << "an unknown name does not hold up the others";
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED, 2);
    EXPECT_EQ(answers, 1);
    EXPECT_EQ(refusal.code, RefusalCode::UnknownEntity);
}

TEST_F(StopDeskTest, OtherPeoplesReceiptsRaiseTheGenerationAndNothingElse) {
    stop({"Cyton"});
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED, 1, "someone-else");
    EXPECT_EQ(answers, 0);
    EXPECT_EQ(marks.of(uuid(3)), 7);
}

TEST_F(StopDeskTest, WithoutAConnectionItIsRefusedAtOnce) {
    desk.onDisconnected();
    stop({});
    EXPECT_EQ(refusal.code, RefusalCode::NotConnected);
    EXPECT_THAT(link.sent, IsEmpty());
}

TEST_F(StopDeskTest, AnOpenOrderIsSentAgainOverANewConnection) {
    stop({"Cyton"}, 10s);
    desk.onDisconnected();
    advance(2s);
    EXPECT_THAT(link.sent, SizeIs(1));
    desk.onConnected(kMe);
    desk.onTimer();
    ASSERT_GE(link.sent.size(), 2U);
    EXPECT_EQ(link.sent[1].head.entity, uuid(3));
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED);
    EXPECT_EQ(answers, 1);
}

TEST_F(StopDeskTest, AStopThatAQueueDoesNotTakeIsGivenAgain) {
    stop({"Cyton"});
    desk.onRefusal(1, uuid(3), {RefusalCode::Overloaded, "full", {}});
    EXPECT_EQ(answers, 0) << "it is repeated until its deadline";
    desk.onRefusal(1, uuid(3), {RefusalCode::UnknownEntity, "gone", {}});
    EXPECT_EQ(answers, 1);
}

TEST_F(StopDeskTest, AnEntityThatIsGoneIsRefused) {
    stop({"Cyton"});
    desk.onRefusal(1, uuid(3), {RefusalCode::UnknownEntity, "gone", {}});
    EXPECT_EQ(answers, 1);
    EXPECT_EQ(refusal.code, RefusalCode::UnknownEntity);
}

TEST_F(StopDeskTest, ClosingAnswersEveryOrder) {
    stop({"Cyton"});
    stop({});
    desk.endOrders();
    EXPECT_EQ(answers, 2);
}

TEST_F(StopDeskTest, ADrillIsSentOnceAndSaysWhatNeverArrived) {
    desk.drill({"Cyton"}, 1s, [this](Result<std::vector<Receipt>> result) {
        ++answers;
        receipts = std::move(result).value();
    });
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].cause, StopCause::Drill);
    receipt(3, proto::StopReceipt::MANAGER);
    advance(500ms);
    desk.onConnected(kMe);
    advance(499ms);
    EXPECT_THAT(link.sent, SizeIs(1)) << "a second one would hide that the first was lost";
    EXPECT_EQ(answers, 0);
    advance(1ms);
    EXPECT_EQ(answers, 1);
    EXPECT_TRUE(receipts.at(0).manager);
    EXPECT_FALSE(receipts.at(0).callback_returned);
    EXPECT_EQ(desk.nextDeadline(), TimePoint::max());
}

TEST_F(StopDeskTest, ADrillOfEverythingNamesWhatIsKnown) {
    desk.drill({}, 1s, [this](Result<std::vector<Receipt>> result) {
        ++answers;
        receipts = std::move(result).value();
    });
    ASSERT_THAT(link.sent, SizeIs(1)) << "one message";
    for (int i = 1; i <= 3; ++i) receipt(i, proto::StopReceipt::CALLBACK_RETURNED);
    EXPECT_EQ(answers, 1);
    EXPECT_THAT(receipts, SizeIs(3));
}

TEST_F(StopDeskTest, ManyOrdersHaveEachTheirOwnTimes) {
    int answered = 0;
    for (int i = 0; i < 20; ++i) {
        desk.stop({"Cyton"}, std::chrono::milliseconds(100 * (20 - i)),
                  [&](const Result<std::vector<Receipt>>&) { ++answered; });
    }
    EXPECT_EQ(desk.nextDeadline(), clock.now() + 100ms);
    advance(1s);
    EXPECT_EQ(answered, 10);
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED, 3);
    EXPECT_EQ(answered, 11);
    EXPECT_EQ(desk.openOrders(), 9U);
    desk.endOrders();
    EXPECT_EQ(answered, 20);
    EXPECT_EQ(desk.nextDeadline(), TimePoint::max());
}

TEST_F(StopDeskTest, ALostApplicationIsNotConfirmedUntilItComesBack) {
    stop({"Cyton"}, 1s);
    const auto lost = [&](proto::StopReceipt::Absence absence) {
        proto::StopReceipt message;
        message.set_stop_id(kMe.id + ":1");
        message.set_stage(proto::StopReceipt::NO_APPLICATION);
        message.set_absence(absence);
        message.set_absence_reason("it has been silent for 250 ms");
        message.set_absent_for_ms(12'500);
        desk.onReceipt(uuid(3), message);
    };
    lost(proto::StopReceipt::SILENT);
    EXPECT_EQ(answers, 0) << "it may come back";
    link.sent.clear();
    advance(100ms);
    EXPECT_THAT(link.sent, SizeIs(2)) << "asked again";
    advance(900ms);
    ASSERT_EQ(answers, 1);
    ASSERT_THAT(receipts, SizeIs(1));
    EXPECT_FALSE(receipts[0].confirmed());
    EXPECT_FALSE(receipts[0].no_application);
    EXPECT_EQ(receipts[0].application_lost, "it has been silent for 250 ms");
    EXPECT_EQ(receipts[0].application_lost_for, Seconds(12.5));

    stop({"Cyton"}, 1s);
    proto::StopReceipt gone;
    gone.set_stop_id(kMe.id + ":2");
    gone.set_stage(proto::StopReceipt::NO_APPLICATION);
    gone.set_absence(proto::StopReceipt::GONE);
    desk.onReceipt(uuid(3), gone);
    EXPECT_EQ(answers, 1);
    receipt(3, proto::StopReceipt::CALLBACK_RETURNED, 2);
    EXPECT_EQ(answers, 2);
    EXPECT_TRUE(receipts.at(0).confirmed());
    EXPECT_EQ(receipts.at(0).application_lost, "");

    stop({"Cyton"}, 1s);
    proto::StopReceipt none;
    none.set_stop_id(kMe.id + ":3");
    none.set_stage(proto::StopReceipt::NO_APPLICATION);
    none.set_absence(proto::StopReceipt::NONE);
    desk.onReceipt(uuid(3), none);
    EXPECT_EQ(answers, 3);
    EXPECT_TRUE(receipts.at(0).confirmed() && receipts.at(0).no_application);
}

TEST_F(StopDeskTest, StandstillIsWaitedForOnlyOfThoseThatAreToComeToRestAndOnlyWhereItIsWanted) {
    const auto returned = [&](int number, std::int64_t sequence, bool follows) {
        proto::StopReceipt message;
        message.set_stop_id(kMe.id + ":" + std::to_string(sequence));
        message.set_stage(proto::StopReceipt::CALLBACK_RETURNED);
        message.set_standstill_follows(follows);
        desk.onReceipt(uuid(number), message);
    };
    stop({"Cyton", "PeopleBot#1"}, 1s);
    returned(3, 1, true);
    returned(1, 1, false);
    EXPECT_EQ(answers, 1) << "nobody wants to wait";

    const auto stopAndWait = [&] {
        desk.stop(
            {"Cyton", "PeopleBot#1"}, 1s,
            [this](Result<std::vector<Receipt>> result) {
                ++answers;
                receipts = std::move(result).value();
            },
            5s);
    };
    stopAndWait();
    returned(3, 2, true);
    returned(1, 2, false);
    EXPECT_EQ(answers, 1);
    link.sent.clear();
    advance(1500ms);
    EXPECT_EQ(answers, 1) << "the deadline is that of the confirmations";
    EXPECT_THAT(link.sent, IsEmpty()) << "what is confirmed is not asked again";
    receipt(3, proto::StopReceipt::STANDSTILL, 2);
    ASSERT_EQ(answers, 2);
    for (const auto& one : receipts) EXPECT_EQ(one.standstill.has_value(), one.entity == uuid(3));

    stopAndWait();  // it says that it will, and does not
    returned(3, 3, true);
    returned(1, 3, false);
    advance(4900ms);
    EXPECT_EQ(answers, 2);
    advance(100ms);
    ASSERT_EQ(answers, 3);
    for (const auto& one : receipts) EXPECT_TRUE(one.confirmed());

    stopAndWait();  // one that is not confirmed is not waited for so long
    returned(3, 4, true);
    advance(1s);
    EXPECT_EQ(answers, 4);

    stopAndWait();  // its application is lost meanwhile
    returned(3, 5, true);
    returned(1, 5, false);
    EXPECT_EQ(answers, 4);
    returned(3, 5, false);
    EXPECT_EQ(answers, 5);
}

TEST_F(StopDeskTest, AResetIsAnsweredByItsReceiptsOrRefusedAndIsNeverSentAgain) {
    const auto await = [&](std::int64_t sequence) {
        desk.await(uuid(3), sequence, 5s, [this](Result<std::vector<Receipt>> result) {
            ++answers;
            if (result)
                receipts = std::move(result).value();
            else
                refusal = result.refusal();
        });
    };
    await(7);
    proto::StopReceipt message;
    message.set_stop_id(kMe.id + ":7");
    message.set_stage(proto::StopReceipt::MANAGER);
    message.set_tasks_ended(1);
    message.set_tasks_removed(2);
    desk.onReceipt(uuid(3), message);
    advance(1s);
    EXPECT_EQ(answers, 0);
    message.set_stage(proto::StopReceipt::CALLBACK_RETURNED);
    desk.onReceipt(uuid(3), message);
    ASSERT_EQ(answers, 1);
    EXPECT_TRUE(receipts.at(0).confirmed());
    EXPECT_EQ(receipts.at(0).tasks_ended, 1);
    EXPECT_EQ(receipts.at(0).tasks_removed, 2);

    await(8);
    desk.onReply(uuid(3), "somebody-else:8", {RefusalCode::WrongState, "not mine", {}});
    desk.onReply(uuid(3), kMe.id + ":9", {RefusalCode::WrongState, "not this one", {}});
    EXPECT_EQ(answers, 1);
    desk.onReply(uuid(3), kMe.id + ":8", {RefusalCode::WrongState, "it takes part in a collaboration", {}});
    ASSERT_EQ(answers, 2);
    EXPECT_EQ(refusal.code, RefusalCode::WrongState);

    await(10);
    desk.withdraw(10);
    desk.onDisconnected();
    desk.onConnected(kMe);
    await(11);
    advance(5s);
    ASSERT_EQ(answers, 3);
    EXPECT_FALSE(receipts.at(0).confirmed());
    EXPECT_THAT(link.sent, IsEmpty());
    EXPECT_EQ(desk.openOrders(), 0U);
}

}  // namespace
}  // namespace axon::client::test
