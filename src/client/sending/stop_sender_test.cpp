// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/sending/stop_sender.hpp"

#include <axon/messages.pb.h>
#include <gtest/gtest.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "client/testing/test_environment.hpp"
#include "client/testing/test_path.hpp"

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;
using Noted = std::vector<std::string>;

/// Everything by which a stop leaves, in the order in which it does.
struct StopSenderTest : testing::Test, StopLanes {
    StopSenderTest() {
        sender.connect(std::shared_ptr<const StopLanes>(std::shared_ptr<void>(), this));
        sender.withDesk([](StopDesk& desk) {
            desk.onConnected(kMe);
            desk.onEntity(Presence::Joined, uuid(1), "PeopleBot");
            desk.onEntity(Presence::Joined, uuid(2), "Cyton");
        });
    }
    void sendStopSignal(Lane lane, const Header& head, StopCause) const override {
        note(lane, head.entity.empty() ? "all" : head.entity.substr(7, 1));
    }
    void sendStopSignals(Lane lane, const Header&, const std::vector<std::string>& entities,
                         StopCause) const override {
        note(lane, std::to_string(entities.size()) + " entities");
    }
    void note(Lane lane, const std::string& what) const {
        EXPECT_FALSE(in_desk) << "it leaves after the lock";
        noted.push_back((lane == Lane::Signal ? "signal " : "data ") + what);
    }
    void stop(const std::vector<std::string>& names) {
        sender.withDesk([&](StopDesk& desk) {
            in_desk = true;
            desk.stop(names, 1s,
                      [this](Result<std::vector<Receipt>> answer) { answers.push_back(std::move(answer)); });
            in_desk = false;
        });
    }
    /// The robot of number 1 has a direct path.
    void openPath() {
        links.offer({uuid(1), {1, 1}, "key", kMe.id, "127.0.0.1:1", "127.0.0.1:2"});
        static_cast<void>(links.turn());
        path->stand();
        static_cast<void>(links.turn());
    }
    static Header receiptOf(int number) {
        Header head;
        head.entity = uuid(number);
        head.msg_type = kMsgReceipt;
        return head;
    }

    ManualClock clock;
    SignalMarks marks;
    mutable Noted noted;
    bool in_desk = false;
    int woken = 0;
    std::vector<Result<std::vector<Receipt>>> answers;
    std::shared_ptr<NotedPath> path;
    DirectLinks links{clock, 4, [this](const DirectOffer& offer) {
                          return path = std::make_shared<NotedPath>(offer, Id128{}, clock);
                      }};
    StopSender sender{clock, marks, links,
                      [this](const std::string& entity, std::int64_t, std::int32_t generation) {
                          noted.push_back("datagram " + (entity.empty() ? "all" : entity.substr(7, 1)) +
                                          " after " + std::to_string(generation));
                      },
                      [this] { ++woken; }};
};

TEST_F(StopSenderTest, AStopLeavesOnTheSignalLaneAndAsADatagramOnceTheLockIsFree) {
    marks.raise(uuid(2), 4);
    stop({"Cyton"});
    EXPECT_EQ(noted, (Noted{"signal 2", "datagram 2 after 4"}));
    EXPECT_EQ(woken, 1) << "it is to be sent again when nobody answers";
}

TEST_F(StopSenderTest, AStopOfEverythingIsOneMessage) {
    stop({});
    EXPECT_EQ(noted, (Noted{"signal all", "datagram all after 0"}));
}

TEST_F(StopSenderTest, AStopOfSeveralIsOneMessageAndADatagramForEach) {
    marks.raise(uuid(1), 2);
    stop({"PeopleBot", "Cyton"});
    EXPECT_EQ(noted, (Noted{"signal 2 entities", "datagram 1 after 2", "datagram 2 after 0"}));
}

TEST_F(StopSenderTest, WhereThereIsADirectPathItGoesStraightToo) {
    openPath();
    stop({"PeopleBot"});
    EXPECT_EQ(path->stops.size(), 1U);
    EXPECT_EQ(noted.front(), "signal 1");
    stop({});
    EXPECT_EQ(path->stops.size(), 2U);
    stop({"Cyton"});
    EXPECT_EQ(path->stops.size(), 2U) << "another's";
}

TEST_F(StopSenderTest, WithoutASessionTheOtherWaysAreLeft) {
    openPath();
    sender.connect(nullptr);
    stop({"PeopleBot"});
    EXPECT_EQ(path->stops.size(), 1U);
    EXPECT_EQ(noted, Noted{"datagram 1 after 0"});
}

TEST_F(StopSenderTest, ADrillIsNoDatagram) {
    sender.withDesk([](StopDesk& desk) { desk.drill({"Cyton"}, 1s, [](const auto&) {}); });
    EXPECT_EQ(noted, Noted{"signal 2"});
}

TEST_F(StopSenderTest, AStopLeavesEvenWhenItsCallerThrows) {
    EXPECT_THROW(sender.withDesk([](StopDesk& desk) {
        desk.stop({"Cyton"}, 1s, [](const auto&) {});
        throw std::runtime_error("no memory");
    }),
                 std::runtime_error);
    EXPECT_EQ(noted.front(), "signal 2");
}

TEST_F(StopSenderTest, WhatIsNotConfirmedIsSentAgainOnBothLanesAndOnce) {
    stop({"Cyton"});
    noted.clear();
    clock.advance(kStopFirstResend);
    const auto next = sender.onTimer();
    EXPECT_EQ(noted, (Noted{"signal 2", "data 2", "datagram 2 after 0"}));
    EXPECT_EQ(next, clock.now() + kStopResendPeriod);
    EXPECT_EQ(woken, 1) << "the thread of the timer is awake";
}

TEST_F(StopSenderTest, ItsReceiptIsTakenWhateverItCameBy) {
    stop({"Cyton"});
    proto::ToClient message;
    auto& receipt = *message.mutable_receipt();
    receipt.set_stop_id(kMe.id + ":1");
    receipt.set_stage(proto::StopReceipt::CALLBACK_RETURNED);
    receipt.set_stop_generation(1);
    EXPECT_TRUE(sender.onReceipt(receiptOf(2), message.SerializeAsString()));
    ASSERT_EQ(answers.size(), 1U);
    ASSERT_TRUE(answers.front());
    EXPECT_TRUE(answers.front()->front().confirmed());
    EXPECT_EQ(marks.of(uuid(2)), 1);
}

TEST_F(StopSenderTest, TheAcknowledgementOfADatagramIsTheManagersStage) {
    stop({"Cyton"});
    sender.onDatagramAcknowledged(uuid(2), kMe.id, 1, 3);
    clock.advance(1s);
    static_cast<void>(sender.onTimer());
    ASSERT_EQ(answers.size(), 1U);
    EXPECT_TRUE(answers.front()->front().manager);
    EXPECT_FALSE(answers.front()->front().callback_returned);
    EXPECT_EQ(marks.of(uuid(2)), 3);
}

TEST_F(StopSenderTest, WhatIsNoReceiptIsLeftToOthers) {
    EXPECT_FALSE(sender.onReceipt(receiptOf(2), "\xff no message"));
    proto::ToClient text;
    text.mutable_text()->set_text("hello");
    EXPECT_FALSE(sender.onReceipt(receiptOf(2), text.SerializeAsString()));
    sender.onReply(receiptOf(2), "\xff no message");
    EXPECT_TRUE(answers.empty());
}

}  // namespace
}  // namespace axon::client::test
