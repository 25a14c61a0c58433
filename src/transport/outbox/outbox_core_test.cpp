// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/outbox/outbox_core.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "common/ids.hpp"

namespace axon::transport {
namespace {

using Core = OutboxCore<int>;
using Verdict = Core::Verdict;

OutboxLimits small() {
    OutboxLimits limits;
    limits.window_bytes = 100;
    limits.data_bytes = 300;
    limits.data_messages = 5;
    limits.control_bytes = 400;
    limits.control_messages = 4;
    limits.signals_unsent = 3;
    return limits;
}

Verdict offer(Core& core, Traffic traffic, int number, std::size_t bytes = 100,
              SenderKey from = kServersOwn) {
    return core.offer(
        traffic, bytes, [number] { return number; }, from);
}

/// Of which each sender may have 4 messages or 100 bytes, and 2 signals, and all senders 12 messages or 300
/// bytes.
OutboxLimits shared() {
    auto limits = small();
    limits.control_messages = 16;
    limits.signals_unsent = 8;
    return limits;
}

std::vector<int> pump(Core& core) {
    std::vector<int> out;
    if (!core.startPump()) return out;
    while (auto item = core.next()) out.push_back(item->parcel);
    return out;
}

TEST(OutboxCore, SendsAtOnceWhileNothingIsInTheWay) {
    Core core(small());
    bool copied = false;
    EXPECT_EQ(core.offer(Traffic::Control, 50, [&] { return copied = true, 1; }), Verdict::Send);
    EXPECT_EQ(core.offer(Traffic::Data, 60, [&] { return copied = true, 2; }), Verdict::Send);
    EXPECT_FALSE(copied);
    EXPECT_EQ(offer(core, Traffic::Data, 3), Verdict::Queued);
    EXPECT_EQ(core.counts().unsent_bytes, 110U);
}

TEST(OutboxCore, DropsTheOldestDataAndKeepsControl) {
    Core core(small());
    ASSERT_EQ(offer(core, Traffic::Control, 0), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Data, 1), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Control, 2, 10), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Data, 3), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Data, 4), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Data, 5), Verdict::Queued);  // 1 goes
    EXPECT_EQ(core.counts().dropped, 1U);
    core.sent(Traffic::Control, 100);
    EXPECT_EQ(pump(core), (std::vector<int>{2, 3}));
    core.sent(Traffic::Control, 10);
    core.sent(Traffic::Control, 100);
    EXPECT_EQ(pump(core), (std::vector<int>{4}));
}

TEST(OutboxCore, AMessageLargerThanTheBoundWaitsAlone) {
    Core core(small());
    ASSERT_EQ(offer(core, Traffic::Data, 0), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Data, 1, 10), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Data, 2, 301), Verdict::Queued);  // 1 goes
    EXPECT_EQ(core.counts().waiting, 1U);
    EXPECT_EQ(core.counts().dropped, 1U);
    core.sent(Traffic::Data, 100);
    EXPECT_EQ(pump(core), (std::vector<int>{2}));
}

TEST(OutboxCore, DisconnectsWhereControlOverflows) {
    Core core(small());
    ASSERT_EQ(offer(core, Traffic::Control, 0), Verdict::Send);
    for (int i = 1; i <= 4; ++i) EXPECT_EQ(offer(core, Traffic::Control, i, 10), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Control, 5, 10), Verdict::Overflow);
    EXPECT_EQ(offer(core, Traffic::Control, 6, 10), Verdict::Closed);
    EXPECT_EQ(core.counts().waiting, 0U);
}

TEST(OutboxCore, NeverQueuesASignal) {
    Core core(small());
    ASSERT_EQ(offer(core, Traffic::Data, 0), Verdict::Send);
    ASSERT_EQ(offer(core, Traffic::Data, 1), Verdict::Queued);
    for (int i = 2; i <= 4; ++i) EXPECT_EQ(offer(core, Traffic::Signal, i), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Signal, 5), Verdict::Overflow);
}

TEST(OutboxCore, UnsentDataIsNotCountedAsSignals) {
    Core core(small());
    for (int i = 0; i < 20; ++i) ASSERT_EQ(offer(core, Traffic::Data, i, 1), Verdict::Send);
    for (int i = 20; i < 23; ++i) EXPECT_EQ(offer(core, Traffic::Signal, i, 1), Verdict::Send);
    core.sent(Traffic::Data, 1);
    core.sent(Traffic::Signal, 1);
    EXPECT_EQ(offer(core, Traffic::Signal, 24, 1), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Signal, 25, 1), Verdict::Overflow);
}

TEST(OutboxCore, LeavesOutAHeartbeatBehindAnUnsentOneAndBehindNothingElse) {
    Core core(small());
    EXPECT_EQ(offer(core, Traffic::Signal, 0), Verdict::Send);
    while (offer(core, Traffic::Data, 1) != Verdict::Queued) {
    }
    EXPECT_EQ(offer(core, Traffic::Heartbeat, 2), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Heartbeat, 3), Verdict::Dropped);
    EXPECT_EQ(core.counts().dropped, 1U);
    core.sent(Traffic::Signal, 100);
    EXPECT_EQ(offer(core, Traffic::Heartbeat, 4), Verdict::Dropped);
    core.sent(Traffic::Heartbeat, 100);
    EXPECT_EQ(offer(core, Traffic::Heartbeat, 5), Verdict::Send);
}

TEST(OutboxCore, NothingPassesAMessageThatIsBeingTakenOutOfTheQueue) {
    Core core(small());
    ASSERT_EQ(offer(core, Traffic::Control, 0), Verdict::Send);
    ASSERT_EQ(offer(core, Traffic::Control, 1, 10), Verdict::Queued);
    core.sent(Traffic::Control, 100);
    ASSERT_TRUE(core.startPump());
    const auto item = core.next();
    ASSERT_TRUE(item);
    // 1 has left the queue and is not with Ice yet.
    EXPECT_EQ(offer(core, Traffic::Control, 2, 10), Verdict::Queued);
    EXPECT_FALSE(core.startPump());
    EXPECT_EQ(core.next()->parcel, 2);
    EXPECT_FALSE(core.next());
    EXPECT_EQ(offer(core, Traffic::Control, 3, 10), Verdict::Send);
}

TEST(OutboxCore, NothingWaitsForAWindowThatIsOpen) {
    Core core(small());
    for (int i = 0; i < 4; ++i) offer(core, Traffic::Control, i);
    ASSERT_EQ(core.counts().waiting, 3U);
    core.openWindow();
    EXPECT_EQ(pump(core), (std::vector<int>{1, 2, 3}));
    EXPECT_EQ(offer(core, Traffic::Control, 4), Verdict::Send);
}

TEST(OutboxCoreShares, OneSenderHasAQuarterAndIsRefusedWithoutHarmToOthers) {
    Core core(shared());
    ASSERT_EQ(offer(core, Traffic::Control, 0), Verdict::Send);
    for (int i = 1; i <= 4; ++i) EXPECT_EQ(offer(core, Traffic::Control, i, 1, 7), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Control, 5, 1, 7), Verdict::Refused) << "its messages";
    EXPECT_EQ(offer(core, Traffic::Control, 6, 90, 8), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Control, 7, 11, 8), Verdict::Refused) << "its bytes";
    EXPECT_EQ(offer(core, Traffic::Control, 8, 10, 8), Verdict::Queued);
    EXPECT_EQ(core.counts().dropped, 0U);
    core.sent(Traffic::Control, 100);
    EXPECT_EQ(pump(core), (std::vector<int>{1, 2, 3, 4, 6, 8}));
    for (const auto bytes : {1U, 1U, 1U, 1U, 90U}) core.sent(Traffic::Control, bytes);
    ASSERT_EQ(offer(core, Traffic::Control, 9), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Control, 10, 1, 7), Verdict::Queued) << "what has gone does not count";
}

TEST(OutboxCoreShares, AnyOneMessageMayWaitWhateverItsSize) {
    Core core(shared());
    ASSERT_EQ(offer(core, Traffic::Control, 0), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Control, 1, 250, 7), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Control, 2, 1, 7), Verdict::Refused);
}

TEST(OutboxCoreShares, ManySendersTogetherLeaveAQuarterToTheServer) {
    Core core(shared());
    ASSERT_EQ(offer(core, Traffic::Control, 0), Verdict::Send);
    for (SenderKey from = 1; from <= 12; ++from)
        EXPECT_EQ(offer(core, Traffic::Control, 1, 1, from), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Control, 2, 1, 13), Verdict::Refused);
    for (int i = 0; i < 4; ++i) EXPECT_EQ(offer(core, Traffic::Control, 3, 1), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Control, 4, 1), Verdict::Overflow) << "only the server's own disconnects";
}

TEST(OutboxCoreShares, OneSenderHasAQuarterOfTheSignals) {
    Core core(shared());
    for (int i = 0; i < 2; ++i) EXPECT_EQ(offer(core, Traffic::Signal, i, 1, 7), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Signal, 2, 1, 7), Verdict::Refused);
    EXPECT_EQ(offer(core, Traffic::Signal, 3, 1, 8), Verdict::Send);
    core.sent(Traffic::Signal, 1, 7);
    EXPECT_EQ(offer(core, Traffic::Signal, 4, 1, 7), Verdict::Send);
    for (SenderKey from = 20; from < 25; ++from)
        EXPECT_EQ(offer(core, Traffic::Signal, 5, 1, from), Verdict::Send)
            << "nobody's stop is refused for others'";
    EXPECT_EQ(offer(core, Traffic::Signal, 6, 1, 30), Verdict::Overflow)
        << "the robot is cut off, and stops by itself";
    core.sent(Traffic::Signal, 1, 7);
    core.sent(Traffic::Signal, 1, 20);
}

TEST(OutboxCoreShares, TheOldestDataOfWhoHasMostGivesWay) {
    Core core(small());  // of data 5 messages and 300 bytes
    ASSERT_EQ(offer(core, Traffic::Control, 0), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Data, 1, 20, 7), Verdict::Queued);
    for (int i = 2; i <= 4; ++i) EXPECT_EQ(offer(core, Traffic::Data, i, 80, 8), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Data, 5, 80, 8), Verdict::Queued);  // 2 goes
    EXPECT_EQ(offer(core, Traffic::Data, 6, 20, 7), Verdict::Queued);
    EXPECT_EQ(offer(core, Traffic::Data, 7, 10, 7), Verdict::Queued);  // 3 goes: there are five
    core.sent(Traffic::Control, 100);
    std::vector<int> out;
    while (core.startPump()) {
        while (auto item = core.next()) {
            out.push_back(item->parcel);
            core.sent(item->traffic, item->bytes, item->from);
        }
    }
    EXPECT_EQ(out, (std::vector<int>{1, 4, 5, 6, 7}));
}

TEST(OutboxCoreShares, ManyTinyDataDoNotDriveOutTheLargeOnesOfOthers) {
    Core core(small());  // of data 5 messages and 300 bytes
    ASSERT_EQ(offer(core, Traffic::Control, 0), Verdict::Send);
    EXPECT_EQ(offer(core, Traffic::Data, 1, 200, 7), Verdict::Queued);
    for (int i = 2; i <= 20; ++i) EXPECT_EQ(offer(core, Traffic::Data, i, 1, 8), Verdict::Queued);
    core.sent(Traffic::Control, 100);
    EXPECT_EQ(pump(core), (std::vector<int>{1}));
    EXPECT_EQ(core.counts().waiting, 4U);
    EXPECT_EQ(core.counts().dropped, 15U);
}

/// Random traffic against a socket that takes some of it: order kept, bounds kept, control never lost unless
/// the consumer is disconnected.
TEST(OutboxCoreProperty, KeepsOrderAndBounds) {
    for (std::uint64_t seed = 1; seed <= 300; ++seed) {
        SCOPED_TRACE("seed " + std::to_string(seed));
        SeededRandom random(seed);
        const auto limits = small();
        Core core(limits);
        std::vector<int> control_offered;
        std::vector<int> control_sent;
        int last_sent = -1;
        std::vector<std::size_t> unsent;
        bool overflow = false;
        const auto record = [&](int number, bool control, std::size_t bytes) {
            EXPECT_GT(number, last_sent);
            last_sent = number;
            if (control) control_sent.push_back(number);
            unsent.push_back(bytes);
        };
        std::vector<bool> is_control;
        for (int number = 0; number < 400 && !overflow; ++number) {
            const bool control = random.next() % 4 == 0;
            is_control.push_back(control);
            const std::size_t bytes = 1 + random.next() % 90;
            const auto verdict =
                offer(core, control ? Traffic::Control : Traffic::Data, number, bytes, random.next() % 3);
            if (control && (verdict == Verdict::Send || verdict == Verdict::Queued))
                control_offered.push_back(number);
            if (verdict == Verdict::Send) record(number, control, bytes);
            overflow = verdict == Verdict::Overflow;
            const auto counts = core.counts();
            ASSERT_LE(counts.unsent_bytes, limits.window_bytes + 90);
            ASSERT_LE(counts.waiting, limits.data_messages + limits.control_messages);
            while (!unsent.empty() && random.next() % 3 == 0) {
                core.sent(Traffic::Control, unsent.front());
                unsent.erase(unsent.begin());
            }
            if (core.startPump()) {
                while (auto item = core.next()) {
                    record(item->parcel, is_control[static_cast<std::size_t>(item->parcel)], item->bytes);
                }
            }
        }
        if (overflow) continue;
        while (!unsent.empty()) {
            core.sent(Traffic::Control, unsent.front());
            unsent.erase(unsent.begin());
            if (core.startPump()) {
                while (auto item = core.next()) {
                    record(item->parcel, is_control[static_cast<std::size_t>(item->parcel)], item->bytes);
                }
            }
        }
        EXPECT_EQ(control_sent, control_offered);
        EXPECT_EQ(core.counts().waiting, 0U);
    }
}

}  // namespace
}  // namespace axon::transport
