// SPDX-License-Identifier: GPL-2.0-or-later
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <limits>
#include <memory>

#include "datagrams/datagram_lane.hpp"
#include "datagrams/endpoint.hpp"
#include "datagrams/stop_datagram.hpp"
#include "datagrams/stop_repeater.hpp"
#include "datagrams/stop_sentry.hpp"
#include "support/loopback.hpp"

namespace axon::datagrams {
namespace {

using namespace std::chrono_literals;
using Verdict = StopSentry::Verdict;

const std::string kKey = "0123456789abcdef";
const std::string kOtherKey = "fedcba9876543210";
const Sender kClient1{"11111111-1111-4111-8111-111111111111", "client1", Role::Operator};
const Sender kClient2{"22222222-2222-4222-8222-222222222222", "client2", Role::Operator};
constexpr LeaseNumber kLease{3, 7};

Id128 idOf(const Sender& sender) {
    return Id128::parse(sender.id).value();
}

StopDatagram stopOf(std::int64_t sequence, const Sender& sender = kClient1, LeaseNumber lease = kLease) {
    StopDatagram stop;
    stop.lease = lease;
    stop.generation = 5;
    stop.sequence = sequence;
    stop.sent_at_us = 1'000'000;
    stop.sender = idOf(sender);
    return stop;
}

std::string bytesOf(const StopDatagram& datagram, const std::string& key = kKey) {
    const auto bytes = encode(datagram, key);
    return {bytes.data(), bytes.size()};
}

std::string hex(std::string_view bytes) {
    static constexpr char kDigits[] = "0123456789abcdef";
    std::string text;
    for (const unsigned char c : bytes) text += {kDigits[c >> 4U], kDigits[c & 15U]};
    return text;
}

TEST(StopDatagram, HasTheBytesOfItsPage) {
    // The MAC was computed by an independent program (docs/reference/datagrams.md).
    EXPECT_EQ(hex(bytesOf(stopOf(9))),
              "4178537401010100"
              "0000000300000007"
              "00000005"
              "0000000000000009"
              "00000000000f4240"
              "11111111111141118111111111111111"
              "94b84b1ee9f7093501edb4232d62db3b");
}

TEST(StopDatagram, IsReadBackUnderItsKeyAndUnderNoOther) {
    for (const auto kind : {StopDatagram::Kind::Stop, StopDatagram::Kind::Ack}) {
        auto datagram = stopOf(9);
        datagram.kind = kind;
        EXPECT_EQ(decode(bytesOf(datagram), kKey), datagram);
        EXPECT_EQ(decode(bytesOf(datagram), kOtherKey), std::nullopt);
        EXPECT_EQ(decode(bytesOf(datagram), ""), std::nullopt);
        EXPECT_EQ(leaseOf(bytesOf(datagram)), kLease);
    }
}

TEST(StopDatagram, OfAnyOtherLengthIsNone) {
    const auto bytes = bytesOf(stopOf(1));
    for (std::size_t size = 0; size < bytes.size(); ++size)
        EXPECT_EQ(decode(bytes.substr(0, size), kKey), std::nullopt) << size;
    EXPECT_EQ(decode(bytes + '\0', kKey), std::nullopt);
}

TEST(StopDatagram, WithAnyBitTurnedIsRefused) {
    const auto bytes = bytesOf(stopOf(1));
    for (std::size_t bit = 0; bit < bytes.size() * 8; ++bit) {
        auto turned = bytes;
        turned[bit / 8] = static_cast<char>(turned[bit / 8] ^ (1 << (bit % 8)));
        EXPECT_EQ(decode(turned, kKey), std::nullopt) << "bit " << bit;
    }
}

TEST(StopDatagram, WithFieldsOutOfRangeIsRefusedThoughItsMacIsRight) {
    auto anonymous = stopOf(1);
    anonymous.sender = Id128{};
    auto drill = stopOf(1);
    drill.cause = StopCause::Drill;
    auto lost = stopOf(1);
    lost.cause = StopCause::ClientLost;
    auto neither = stopOf(1);
    neither.kind = static_cast<StopDatagram::Kind>(3);
    for (const auto& wrong :
         {anonymous, drill, lost, neither, stopOf(0), stopOf(-1), stopOf(1LL << 53),
          stopOf(1, kClient1, {0, 1}), stopOf(1, kClient1, {1, 0}), stopOf(1, kClient1, {-1, 1}),
          stopOf(1, kClient1, {1, std::numeric_limits<std::int32_t>::min()})})
        EXPECT_EQ(decode(bytesOf(wrong), kKey), std::nullopt);
}

class StopSentryTest : public ::testing::Test {
  protected:
    Verdict judge(const StopDatagram& datagram, const std::string& key = kKey) {
        return sentry.judge(bytesOf(datagram, key)).verdict;
    }
    StopSentry sentry;
};

TEST_F(StopSentryTest, ObeysTheHolderOnceAndKnowsCopies) {
    sentry.hold(kLease, kKey, kClient1);
    const auto judged = sentry.judge(bytesOf(stopOf(1)));
    EXPECT_EQ(judged.verdict, Verdict::New);
    EXPECT_EQ(judged.sender, kClient1);
    EXPECT_EQ(judged.key, kKey);
    EXPECT_EQ(judge(stopOf(1)), Verdict::Again);
    auto later_copy = stopOf(1);
    later_copy.sent_at_us += 4000;
    EXPECT_EQ(judge(later_copy), Verdict::Again);
    EXPECT_EQ(judge(stopOf(2)), Verdict::New);
    EXPECT_EQ(sentry.counters().accepted, 2U);
    EXPECT_EQ(sentry.counters().again, 2U);
}

TEST_F(StopSentryTest, RefusesEverythingWhileNobodyHoldsTheLease) {
    EXPECT_EQ(judge(stopOf(1)), Verdict::Refused);
    sentry.hold(kLease, kKey, kClient1);
    sentry.end();
    EXPECT_EQ(judge(stopOf(1)), Verdict::Refused);
    EXPECT_EQ(sentry.counters().foreign, 2U);
}

TEST_F(StopSentryTest, RefusesAnotherKeyAnotherLeaseAndSomebodyWhoNeverHeldIt) {
    sentry.hold(kLease, kKey, kClient1);
    EXPECT_EQ(judge(stopOf(1), kOtherKey), Verdict::Refused);
    EXPECT_EQ(judge(stopOf(1, kClient1, {3, 6})), Verdict::Refused);
    EXPECT_EQ(judge(stopOf(1, kClient1, {2, 7})), Verdict::Refused);
    EXPECT_EQ(judge(stopOf(1, kClient2)), Verdict::Refused) << "a right key is not enough";
    auto ack = stopOf(1);
    ack.kind = StopDatagram::Kind::Ack;
    EXPECT_EQ(judge(ack), Verdict::Refused) << "an acknowledgement sent back is no stop";
    EXPECT_EQ(sentry.counters().foreign, 5U);
    EXPECT_EQ(judge(stopOf(1)), Verdict::New) << "and none of them used up the holder's number";
}

TEST_F(StopSentryTest, AcceptsStopsOutOfOrderInsideTheWindowAndNoneBehindIt) {
    sentry.hold(kLease, kKey, kClient1);
    EXPECT_EQ(judge(stopOf(100)), Verdict::New);
    EXPECT_EQ(judge(stopOf(37)), Verdict::New) << "63 behind the newest";
    EXPECT_EQ(judge(stopOf(37)), Verdict::Again);
    EXPECT_EQ(judge(stopOf(36)), Verdict::Refused);
    EXPECT_EQ(judge(stopOf(163)), Verdict::New);
    EXPECT_EQ(judge(stopOf(100)), Verdict::Again);
    EXPECT_EQ(judge(stopOf(99)), Verdict::Refused);
    EXPECT_EQ(judge(stopOf(1'000'000)), Verdict::New) << "a jump empties the window";
    EXPECT_EQ(judge(stopOf(163)), Verdict::Refused);
    EXPECT_EQ(sentry.counters().old, 3U);
}

TEST_F(StopSentryTest, AReplayAcrossLeasesIsRefused) {
    sentry.hold(kLease, kKey, kClient1);
    EXPECT_EQ(judge(stopOf(1)), Verdict::New);
    sentry.end();
    sentry.hold({3, 8}, kOtherKey, kClient1);
    EXPECT_EQ(judge(stopOf(1)), Verdict::Refused);
    EXPECT_EQ(judge(stopOf(1, kClient1, {3, 8})), Verdict::Refused) << "the old key";
    EXPECT_EQ(judge(stopOf(1, kClient1, {3, 8}), kOtherKey), Verdict::New) << "a new lease counts anew";
}

TEST_F(StopSentryTest, AfterAResumeBothSessionsAreHeardAndNeitherCanBeReplayed) {
    sentry.hold(kLease, kKey, kClient1);
    EXPECT_EQ(judge(stopOf(5)), Verdict::New);
    sentry.hold(kLease, kKey, kClient2);
    EXPECT_EQ(judge(stopOf(5)), Verdict::Again) << "the old session's stop is a copy still";
    EXPECT_EQ(judge(stopOf(6)), Verdict::New) << "it was under way when the lease was resumed";
    EXPECT_EQ(judge(stopOf(1, kClient2)), Verdict::New) << "the new session counts from 1";
    EXPECT_EQ(judge(stopOf(1, kClient2)), Verdict::Again);
}

TEST_F(StopSentryTest, OnlyTheLastFewHoldersCount) {
    sentry.hold(kLease, kKey, kClient1);
    EXPECT_EQ(judge(stopOf(1)), Verdict::New);
    for (int i = 3; i < 7; ++i) {
        const auto digit = std::to_string(i);
        sentry.hold(kLease, kKey,
                    {digit + "1111111-1111-4111-8111-111111111111", "client" + digit, Role::Operator});
    }
    EXPECT_EQ(judge(stopOf(1)), Verdict::Refused);
    EXPECT_EQ(judge(stopOf(2)), Verdict::Refused);
}

TEST_F(StopSentryTest, AHolderWithoutASessionUuidHasNoDatagrams) {
    sentry.hold(kLease, kKey, {"client1", "client1", Role::Operator});
    EXPECT_EQ(judge(stopOf(1)), Verdict::Refused);
    sentry.hold(kLease, "short", kClient1);
    EXPECT_EQ(judge(stopOf(1), "short"), Verdict::Refused);
}

TEST_F(StopSentryTest, CountsWhatItCannotRead) {
    sentry.hold(kLease, kKey, kClient1);
    EXPECT_EQ(sentry.judge("").verdict, Verdict::Refused);
    EXPECT_EQ(sentry.judge(std::string(kStopDatagramBytes, 'x')).verdict, Verdict::Refused);
    EXPECT_EQ(sentry.judge(std::string(9000, '\0')).verdict, Verdict::Refused);
    EXPECT_EQ(sentry.counters().unreadable, 3U);
}

class StopRepeaterTest : public ::testing::Test {
  protected:
    void SetUp() override {
        repeater.admit("left", {kAt, kLease, kKey, idOf(kClient1)});
        repeater.admit("right", {kAt, kLease, kOtherKey, idOf(kClient1)});
    }
    std::vector<int> copiesUntil(std::chrono::milliseconds end) {
        std::vector<int> at;
        const auto begun = clock.now();
        while (true) {
            for (const auto& out : repeater.take()) {
                EXPECT_EQ(out.to, kAt);
                at.push_back(static_cast<int>((clock.now() - begun) / 1ms));
            }
            const auto next = repeater.nextDeadline();
            if (next > begun + end) return at;
            clock.set(next);
            repeater.onTimer();
        }
    }
    std::string ackOf(std::int64_t sequence, const std::string& key = kKey, std::uint32_t generation = 6) {
        auto ack = stopOf(sequence);
        ack.kind = StopDatagram::Kind::Ack;
        ack.generation = generation;
        return bytesOf(ack, key);
    }

    const Endpoint kAt{0x7f000001, 4000};
    ManualClock clock;
    StopRepeater repeater{clock};
};

TEST_F(StopRepeaterTest, SendsAtItsTimesAndThenNoMore) {
    repeater.stop("left", 9, 5);
    EXPECT_EQ(copiesUntil(10s), (std::vector<int>{0, 4, 10, 20, 35, 55, 80, 110, 150}));
    EXPECT_EQ(repeater.rows(), 0U);
    EXPECT_EQ(repeater.nextDeadline(), TimePoint::max());
}

TEST_F(StopRepeaterTest, EachCopyIsTheSameStopAtItsOwnTime) {
    repeater.stop("left", 9, 5);
    const auto first = repeater.take();
    clock.advance(4ms);
    repeater.onTimer();
    const auto second = repeater.take();
    ASSERT_EQ(first.size(), 1U);
    ASSERT_EQ(second.size(), 1U);
    auto one = decode({first[0].bytes.data(), first[0].bytes.size()}, kKey);
    const auto other = decode({second[0].bytes.data(), second[0].bytes.size()}, kKey);
    ASSERT_TRUE(one && other);
    EXPECT_EQ(other->sent_at_us - one->sent_at_us, 4000);
    one->sent_at_us = other->sent_at_us;
    EXPECT_EQ(one, other);
    EXPECT_EQ(one->sequence, 9);
}

TEST_F(StopRepeaterTest, AnAcknowledgementEndsTheRowAndNothingBeginsItAnew) {
    repeater.stop("left", 9, 5);
    clock.advance(4ms);
    repeater.onTimer();
    const auto acknowledged = repeater.onDatagram(kAt, ackOf(9));
    ASSERT_TRUE(acknowledged);
    EXPECT_EQ(acknowledged->entity, "left");
    EXPECT_EQ(acknowledged->sequence, 9);
    EXPECT_EQ(acknowledged->generation, 6U);
    EXPECT_FALSE(repeater.onDatagram(kAt, ackOf(9))) << "the ack of the second copy";
    repeater.take();
    repeater.stop("left", 9, 5);
    EXPECT_TRUE(copiesUntil(10s).empty());
    repeater.stop("left", 10, 5);
    EXPECT_EQ(repeater.take().size(), 1U) << "another stop is another row";
}

TEST_F(StopRepeaterTest, WhatIsNoAcknowledgementOfTheRowChangesNothing) {
    repeater.stop("left", 9, 5);
    EXPECT_FALSE(repeater.onDatagram(kAt, bytesOf(stopOf(9)))) << "its own stop, sent back";
    EXPECT_FALSE(repeater.onDatagram(kAt, ackOf(8)));
    EXPECT_FALSE(repeater.onDatagram(kAt, ackOf(9, kOtherKey)))
        << "of another Entity Manager with the same lease number";
    EXPECT_FALSE(repeater.onDatagram({kAt.address, 4001}, ackOf(9))) << "from elsewhere";
    EXPECT_FALSE(repeater.onDatagram(kAt, "nonsense"));
    EXPECT_EQ(repeater.rows(), 1U);
}

TEST_F(StopRepeaterTest, AStopOfEverythingGoesToEveryTarget) {
    repeater.stop("", 9, 0);
    EXPECT_EQ(repeater.take().size(), 2U);
    EXPECT_EQ(repeater.onDatagram(kAt, ackOf(9, kOtherKey))->entity, "right") << "the key tells them apart";
    EXPECT_EQ(repeater.onDatagram(kAt, ackOf(9))->entity, "left");
    EXPECT_EQ(repeater.rows(), 0U);
}

TEST_F(StopRepeaterTest, AnUnansweredStopThatIsGivenAgainBeginsAnew) {
    repeater.stop("left", 9, 5);
    repeater.stop("left", 9, 5);
    EXPECT_EQ(copiesUntil(10s).size(), 9U) << "while it runs, nothing is added";
    repeater.stop("left", 9, 5);
    EXPECT_EQ(copiesUntil(10s).size(), 9U);
}

TEST_F(StopRepeaterTest, AThreadThatSleptSendsOneCopyForAllItMissed) {
    repeater.stop("left", 9, 5);
    repeater.take();
    clock.advance(60ms);
    repeater.onTimer();
    EXPECT_EQ(repeater.take().size(), 1U);
}

TEST_F(StopRepeaterTest, TheEndOfALeaseEndsItsRowsButNotThoseOfTheNext) {
    repeater.stop("left", 9, 5);
    repeater.take();
    repeater.forget("left", {3, 6});
    EXPECT_EQ(repeater.rows(), 1U) << "an older lease";
    repeater.forget("left", kLease);
    EXPECT_EQ(repeater.rows(), 0U);
    EXPECT_TRUE(copiesUntil(10s).empty());
    repeater.stop("left", 10, 5);
    EXPECT_TRUE(repeater.take().empty());
    repeater.stop("somebody else's", 11, 5);
    EXPECT_TRUE(repeater.take().empty());
}

TEST_F(StopRepeaterTest, HasABound) {
    for (std::int64_t i = 1; i <= static_cast<std::int64_t>(StopRepeater::kRows) + 10; ++i)
        repeater.stop("left", i, 5);
    EXPECT_EQ(repeater.rows(), StopRepeater::kRows);
}

TEST(EndpointText, IsReadAndWritten) {
    EXPECT_EQ(Endpoint::parse("127.0.0.1:5500"), (Endpoint{0x7f000001, 5500}));
    EXPECT_EQ((Endpoint{0xc0a80a01, 65535}).toString(), "192.168.10.1:65535");
    for (const auto* wrong : {"", ":", "127.0.0.1", "127.0.0.1:", "127.0.0.1:65536", "127.0.0:1",
                              "127.0.0.1.1:1", "127.0.0.256:1", "localhost:1", " 127.0.0.1:1", "127.0.0.1:-1",
                              "127.00.0.1:1", "127.0.0.1:1 ", "[::1]:1", "127.0.0.1:0x10"})
        EXPECT_EQ(Endpoint::parse(wrong), std::nullopt) << wrong;
}

TEST(DatagramLane, CarriesBothWaysAndSurvivesAFlood) {
    const SteadyClock clock{};
    const auto address = parseAddress(test::loopbackAddress()).value();
    std::atomic<int> good{0}, bad{0}, answered{0};
    const DatagramLane server(
        "test-server", Endpoint{address, 0}, clock,
        [&](const DatagramLane& lane, const Endpoint& from, std::string_view bytes) {
            if (bytes != "hello") return ++bad, false;
            ++good;
            lane.send(from, "welcome");
            return true;
        },
        nullptr);
    DatagramLane client(
        "test-client", {address, 0}, clock,
        [&](const DatagramLane&, const Endpoint& from, std::string_view bytes) {
            answered += from == server.local() && bytes == "welcome";
            return true;
        },
        nullptr);
    for (int i = 0; i < 500; ++i) client.send(server.local(), "noise");
    client.send(server.local(), std::string(2000, 'x'));
    ASSERT_TRUE(test::waitUntil([&] {
        client.send(server.local(), "hello");
        return answered > 0;
    }));
    EXPECT_GT(bad, 0);
    EXPECT_GE(good, answered);
}

TEST(DatagramLane, CallsWhatIsDueWhenItIsWoken) {
    const SteadyClock clock{};
    std::atomic<int> calls{0};
    DatagramLane lane(
        "test-due", {parseAddress(test::loopbackAddress()).value(), 0}, clock,
        [](const DatagramLane&, const Endpoint&, std::string_view) { return true; },
        [&](const DatagramLane&) {
            ++calls;
            return TimePoint::max();
        });
    ASSERT_TRUE(test::waitUntil([&] { return calls == 1; }));
    lane.wake();
    EXPECT_TRUE(test::waitUntil([&] { return calls >= 2; }));
}

TEST(DatagramLane, AnAddressOfAnotherMachineIsAMisconfiguration) {
    const SteadyClock clock{};
    EXPECT_THROW(DatagramLane(
                     "test", {0xc0000201, 0}, clock,
                     [](const DatagramLane&, const Endpoint&, std::string_view) { return true; }, nullptr),
                 std::system_error);
}

}  // namespace
}  // namespace axon::datagrams
