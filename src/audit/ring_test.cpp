// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/ring.hpp"

#include <gtest/gtest.h>

#include <map>
#include <string>
#include <thread>

namespace axon::audit {
namespace {

TEST(AuditRing, GivesBackWhatWasPushedInItsOrder) {
    Ring ring(4);
    Ring::Kept kept;
    EXPECT_FALSE(ring.pop(kept));
    for (int round = 0; round < 10; ++round) {
        const auto name = std::to_string(round);
        EXPECT_TRUE(ring.push({Kind::Stop, "user", name, "client", "peer", "entity", "what", "OK"}, round));
        EXPECT_TRUE(ring.push({.kind = Kind::Rearm, .outcome = "NOT_HOLDER"}, -round));
        ASSERT_TRUE(ring.pop(kept));
        EXPECT_EQ(kept.kind, Kind::Stop);
        EXPECT_EQ(kept.at_us, round);
        EXPECT_EQ(kept.text(0), "user");
        EXPECT_EQ(kept.text(1), name);
        EXPECT_EQ(kept.text(2), "client");
        EXPECT_EQ(kept.text(3), "peer");
        EXPECT_EQ(kept.text(4), "entity");
        EXPECT_EQ(kept.text(5), "what");
        EXPECT_EQ(kept.text(6), "OK");
        ASSERT_TRUE(ring.pop(kept));
        EXPECT_EQ(kept.text(0), "");
        EXPECT_EQ(kept.text(6), "NOT_HOLDER");
    }
}

TEST(AuditRing, TakesNothingWhenItIsFullAndAgainWhenItIsNot) {
    Ring ring(4);
    for (int i = 0; i < 4; ++i) EXPECT_TRUE(ring.push({}, i));
    EXPECT_FALSE(ring.push({}, 4));
    Ring::Kept kept;
    ASSERT_TRUE(ring.pop(kept));
    EXPECT_EQ(kept.at_us, 0);
    EXPECT_TRUE(ring.push({}, 5));
    EXPECT_FALSE(ring.push({}, 6));
}

TEST(AuditRing, CutsWhatIsTooLongBetweenTwoCharacters) {
    Ring ring(2);
    const std::string much(5000, 'x');
    std::string umlauts;
    for (int i = 0; i < 100; ++i) umlauts += "ä";
    ASSERT_TRUE(ring.push({Kind::Stop, much, "a" + umlauts, much, much, much, much, much}, 0));
    Ring::Kept kept;
    ASSERT_TRUE(ring.pop(kept));
    EXPECT_EQ(kept.text(0), std::string(64, 'x'));
    EXPECT_EQ(kept.text(1), ("a" + umlauts).substr(0, 63));
    EXPECT_EQ(kept.text(5).size(), 512U);
    EXPECT_EQ(kept.ends.back(), Ring::kBytes - 1) << "more than its slot has";
}

TEST(AuditRing, NothingIsLostTwiceOrTornBetweenThreads) {
    constexpr int kThreads = 4, kEach = 5000;
    Ring ring(64);
    std::vector<std::thread> threads;
    threads.reserve(kThreads);
    for (int t = 0; t < kThreads; ++t)
        threads.emplace_back([&ring, t] {
            const auto name = std::string(20, static_cast<char>('a' + t));
            for (int i = 0; i < kEach;) {
                if (ring.push({.kind = Kind::Command, .name = name}, i))
                    ++i;
                else
                    std::this_thread::yield();
            }
        });
    std::map<std::string, std::int64_t> next;
    Ring::Kept kept;
    for (int got = 0; got < kThreads * kEach;) {
        if (!ring.pop(kept)) {
            std::this_thread::yield();
            continue;
        }
        ++got;
        const std::string name(kept.text(1));
        ASSERT_EQ(name, std::string(20, name.empty() ? '?' : name[0]));
        ASSERT_EQ(kept.at_us, next[name]++);
    }
    for (auto& thread : threads) thread.join();
    EXPECT_EQ(next.size(), 4U);
    EXPECT_FALSE(ring.pop(kept));
}

}  // namespace
}  // namespace axon::audit
