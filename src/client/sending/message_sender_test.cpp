// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/sending/message_sender.hpp"

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "client/testing/test_path.hpp"

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;

/// The data lane of a session, which notes what it is given, and when it is written to the socket.
class NotedLane final : public DataLane {
  public:
    void send(Operation, const Header& head, std::string) const override {
        EXPECT_TRUE(added.empty()) << "what was added before is behind this message";
        sent.push_back(head.msg_type);
    }
    void add(Operation, const Header& head, std::string) const override { added.push_back(head.msg_type); }
    void write() const override {
        std::string together;
        for (const auto& one : std::exchange(added, {})) together += (together.empty() ? "" : "+") + one;
        sent.push_back(together);
    }
    std::size_t waiting() const override { return waits; }
    std::size_t waitingBytes() const override { return waits_bytes; }
    void awaitRoom(Duration) const override {}

    mutable std::vector<std::string> sent, added;  // "a+b": written together
    std::size_t waits = 0, waits_bytes = 0;
};

struct MessageSenderTest : testing::Test {
    MessageSenderTest() { sender.connect(lane); }

    Header of(const char* type, const std::string& entity = "robot") {
        Header head;
        head.sequence = ++sequence;
        head.entity = entity;
        head.msg_type = type;
        return head;
    }
    void put(const char* type, std::string bytes = "x") { sender.sendToEntity(of(type), std::move(bytes)); }
    /// One use of the core by a user's thread.
    void use(const char* type, std::string bytes = "x") {
        put(type, std::move(bytes));
        sender.depart(sender.collect(true));
    }
    using Sent = std::vector<std::string>;

    ManualClock clock;
    std::int64_t sequence = 0;
    DirectLinks links{clock, 4, [this](const DirectOffer& offer) {
                          return path = std::make_shared<NotedPath>(offer, Id128{}, clock);
                      }};
    std::shared_ptr<NotedPath> path;
    std::shared_ptr<NotedLane> lane = std::make_shared<NotedLane>();
    int woken = 0;
    MessageSender sender{clock, links, [this] { ++woken; }, [] {}};
};

TEST_F(MessageSenderTest, ASingleMessageIsSentByItsOwnThreadAtOnce) {
    use("A");
    EXPECT_EQ(lane->sent, Sent{"A"});
    EXPECT_EQ(woken, 0);
}

TEST_F(MessageSenderTest, NothingLeavesBeforeTheDeparture) {
    put("A");
    const auto leaving = sender.collect(true);
    EXPECT_TRUE(lane->sent.empty()) << "the lock of the core is still held";
    sender.depart(leaving);
    EXPECT_EQ(lane->sent, Sent{"A"});
}

TEST_F(MessageSenderTest, AUseThatPutsNothingSendsNothingAndWakesNobody) {
    put("A");
    const auto other = sender.collect(true);  // of another thread, which has not got to send it yet
    sender.depart(sender.collect(true));
    sender.depart(sender.collect(false));
    EXPECT_TRUE(lane->sent.empty());
    EXPECT_EQ(woken, 0);
    sender.depart(other);
    EXPECT_EQ(lane->sent, Sent{"A"});
}

TEST_F(MessageSenderTest, MessagesOfOneUseAreWrittenTogether) {
    put("A");
    put("B");
    sender.depart(sender.collect(true));
    EXPECT_EQ(lane->sent, Sent{"A+B"});
}

TEST_F(MessageSenderTest, ABurstIsLeftToTheSendingThreadWhichWritesItTogether) {
    use("A");
    clock.advance(kFast - 1us);
    use("B");
    clock.advance(kFast - 1us);
    use("C");
    EXPECT_EQ(lane->sent, Sent{"A"});
    EXPECT_EQ(woken, 2);
    sender.sendAll();
    EXPECT_EQ(lane->sent, (Sent{"A", "B+C"}));
}

TEST_F(MessageSenderTest, WhoSendsSlowlySendsForHimself) {
    use("A");
    clock.advance(kFast);
    use("B");
    EXPECT_EQ(lane->sent, (Sent{"A", "B"}));
    EXPECT_EQ(woken, 0);
}

TEST_F(MessageSenderTest, AnAnswerInBetweenIsNoBurst) {
    use("A");
    sender.breakBurst();  // something has come from the server
    use("B");
    EXPECT_EQ(lane->sent, (Sent{"A", "B"}));
    EXPECT_EQ(woken, 0);
}

TEST_F(MessageSenderTest, SignalsAreLeftToNobodyAndTakeAlongWhatWasPutBefore) {
    use("A");
    use("B");
    ASSERT_EQ(woken, 1);
    sender.sendReset(of("RESET"));
    sender.depart(sender.collect(true));
    EXPECT_EQ(lane->sent, (Sent{"A", "B", "RESET"}));
    use("C");
    sender.sendClear(of("CLEAR"));
    sender.depart(sender.collect(true));
    EXPECT_EQ(lane->sent.back(), "CLEAR");
}

TEST_F(MessageSenderTest, ALargeMessageIsSentByItsOwnThreadAndAlone) {
    use("A");
    use("B");
    use("LARGE", std::string(kTogetherBytes, 'x'));
    EXPECT_EQ(woken, 1);
    EXPECT_EQ(lane->sent, (Sent{"A", "B", "LARGE"}));
}

TEST_F(MessageSenderTest, WhoIsFasterThanTheSendingThreadWritesTheBurstHimself) {
    use("A");
    std::size_t left = 0;
    while (left < kLeftToSender) {
        ASSERT_EQ(lane->sent.size(), 1U) << left;
        use("B", std::string(2048, 'x'));
        left += 2048 + kMessageOverhead;
    }
    EXPECT_EQ(lane->sent.size(), 2U) << "all in one";
    EXPECT_EQ(lane->sent.back().substr(0, 3), "B+B");
}

TEST_F(MessageSenderTest, ThreadsOfTheLibraryLeaveTheirsToTheSendingThread) {
    put("A");
    sender.depart(sender.collect(false));
    EXPECT_TRUE(lane->sent.empty());
    EXPECT_EQ(woken, 1);
    sender.sendAll();
    EXPECT_EQ(lane->sent, Sent{"A"});
}

TEST_F(MessageSenderTest, AThreadSendsNoFurtherThanItsOwnMessage) {
    put("A");
    const auto mine = sender.collect(true);
    put("B");  // somebody else, who does not stop
    sender.depart(mine);
    EXPECT_EQ(lane->sent, Sent{"A"});
}

TEST_F(MessageSenderTest, WhatIsSentWithoutASessionIsDropped) {
    sender.connect(nullptr);
    use("A");
    sender.connect(lane);
    clock.advance(1s);
    use("B");
    EXPECT_EQ(lane->sent, Sent{"B"});
}

TEST_F(MessageSenderTest, WhatHasNotBeenSentWhenTheSessionIsLostIsForgotten) {
    put("A");
    sender.depart(sender.collect(false));
    sender.forget();
    sender.sendAll();
    EXPECT_TRUE(lane->sent.empty());
    EXPECT_TRUE(sender.admit(0).ok());
}

TEST_F(MessageSenderTest, WhatWasPutInALostSessionGoesByNoOtherOne) {
    const auto before = lane;
    put("A");
    put("B");
    lane = std::make_shared<NotedLane>();
    sender.connect(lane);
    put("C");
    sender.depart(sender.collect(true));
    EXPECT_EQ(before->sent, Sent{"A+B"}) << "where it is dropped";
    EXPECT_EQ(lane->sent, Sent{"C"});
}

TEST_F(MessageSenderTest, WhatWaitsInTheLaneAndInTheQueueIsAdmittedNoFurther) {
    lane->waits = kWaitingMax - 1;
    EXPECT_TRUE(sender.admit(1).ok());
    put("A");  // it is being sent
    EXPECT_EQ(sender.admit(1).code, RefusalCode::Overloaded);
    lane->waits = 0;
    lane->waits_bytes = kWaitingBytesMax;
    EXPECT_EQ(sender.admit(1).code, RefusalCode::Overloaded);
    EXPECT_EQ(sender.admit(kMessageBytesMax + 1).code, RefusalCode::TooLarge);
}

TEST_F(MessageSenderTest, ASignOfLifeIsTakenOnceAndIsNoMessage) {
    sender.keepAlive(7, true);
    const auto beat = sender.takeBeat();
    ASSERT_TRUE(beat);
    EXPECT_EQ(beat->sequence, 7);
    EXPECT_TRUE(beat->busy);
    EXPECT_FALSE(sender.takeBeat());
    EXPECT_EQ(sender.collect(true).last, 0U);
}

/// The robot's lease offers a direct path, which stands; its mark has gone by the servers.
struct MessageSenderByPathTest : MessageSenderTest {
    MessageSenderByPathTest() {
        links.offer(
            {"robot", {1, 1}, "key", "99999999-1111-4111-8111-111111111111", "127.0.0.1:1", "127.0.0.1:2"});
        static_cast<void>(links.turn());
        path->stand();
        for (const auto& [link, begun] : links.turn().begun)
            sender.sendMark(of(kMsgWay), "mark", link, begun);
        sender.depart(sender.collect(true));
        EXPECT_EQ(std::exchange(lane->sent, {}), Sent{kMsgWay});
        clock.advance(kFast);  // what comes next is no burst with it
    }
};

TEST_F(MessageSenderByPathTest, MessagesGoByThePathAndOthersByTheServersInOrder) {
    put(kMsgText);
    sender.sendToEntity(of("OTHER", "another"), "x");
    sender.depart(sender.collect(true));
    EXPECT_EQ(path->sent_types, Sent{kMsgText});
    EXPECT_EQ(lane->sent, Sent{"OTHER"});
}

TEST_F(MessageSenderByPathTest, WhatThePathHasNotAcknowledgedFallsBackBeforeTheNextMessage) {
    use(kMsgText);
    path->close("the cable is out");
    clock.advance(1s);
    use(kMsgTask);
    EXPECT_EQ(lane->sent, (Sent{kMsgText, kMsgTask}));
}

TEST_F(MessageSenderByPathTest, ItFallsBackWithoutANextMessageWhenTheSendingThreadIsWoken) {
    use(kMsgText);
    path->close("the cable is out");
    sender.sendAll();
    EXPECT_EQ(lane->sent, Sent{kMsgText});
}

TEST_F(MessageSenderByPathTest, WhatFallsBackGoesByTheSessionInWhichThePathWasOpened) {
    use(kMsgText);
    const auto before = lane;
    lane = std::make_shared<NotedLane>();
    sender.connect(lane);
    path->close("the cable is out");
    sender.sendAll();
    EXPECT_EQ(before->sent, Sent{kMsgText}) << "where it is dropped";
    EXPECT_TRUE(lane->sent.empty());
}

TEST_F(MessageSenderByPathTest, ABurstIsWrittenBeforeWhatFallsBack) {
    use(kMsgText);
    path->close("the cable is out");
    clock.advance(1s);
    sender.sendToEntity(of("OTHER", "another"), "x");
    put(kMsgTask);
    sender.depart(sender.collect(true));
    EXPECT_EQ(lane->sent, (Sent{"OTHER", kMsgText, kMsgTask}));
}

}  // namespace
}  // namespace axon::client::test
