// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/held_statuses.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::front_end_server {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::IsEmpty;
using Verdict = HeldStatuses::Verdict;

constexpr TimePoint kStart{10s};  // a second of the clock begins

void useUp(HeldStatuses& its, TimePoint now) {
    for (std::uint32_t i = 0; i < kStatusesAtOnce; ++i) EXPECT_EQ(its.offer("used", now), Verdict::Now);
}

TEST(HeldStatusesTest, AFewInASecondAreToldAtOnce) {
    HeldStatuses its({});
    useUp(its, kStart);
    EXPECT_EQ(its.due(), TimePoint::max());
    EXPECT_EQ(its.offer("e1", kStart), Verdict::First);
    EXPECT_EQ(its.offer("e2", kStart), Verdict::Held);
    EXPECT_EQ(its.offer("e1", kStart), Verdict::Held);
    EXPECT_THAT(its.take(kStart + kStatusesHeld), ElementsAre("e1", "e2"));
    EXPECT_THAT(its.take(kStart + 2 * kStatusesHeld), IsEmpty());
    EXPECT_EQ(its.offer("e1", kStart + 999ms), Verdict::First);
    EXPECT_EQ(its.offer("e2", kStart + 1s), Verdict::Held);  // not past e1
    EXPECT_THAT(its.take(kStart + 1s), ElementsAre("e1", "e2"));
    EXPECT_EQ(its.offer("e1", kStart + 1s), Verdict::Now);
}

TEST(HeldStatusesTest, WhatIsHeldIsDueAtItsPhaseAndNeverLaterThanTheBound) {
    for (const auto phase : {0ms, 30ms, 99ms, 130ms})
        for (auto now = kStart; now < kStart + 2 * kStatusesHeld; now += 7ms) {
            HeldStatuses its(phase);
            useUp(its, now);
            ASSERT_EQ(its.offer("e1", now), Verdict::First);
            EXPECT_GT(its.due(), now);
            EXPECT_LE(its.due(), now + kStatusesHeld);
            EXPECT_EQ((its.due() - phase).time_since_epoch() % kStatusesHeld, 0ns);
            EXPECT_THAT(its.take(its.due() - 1ns), IsEmpty());
            EXPECT_THAT(its.take(its.due()), ElementsAre("e1"));
            EXPECT_EQ(its.due(), TimePoint::max());
        }
}

TEST(HeldStatusesTest, WhatIsToldAtOnceIsNotHeld) {
    HeldStatuses its({});
    its.drop("e1");
    useUp(its, kStart);
    for (const auto* entity : {"e1", "e2", "e3"}) its.offer(entity, kStart);
    its.drop("e2");
    EXPECT_THAT(its.take(kStart + kStatusesHeld), ElementsAre("e1", "e3"));
    its.offer("e1", kStart + kStatusesHeld);
    its.drop("e1");
    EXPECT_EQ(its.due(), TimePoint::max());
    EXPECT_EQ(its.offer("e2", kStart + 3 * kStatusesHeld), Verdict::First);
    EXPECT_EQ(its.due(), kStart + 4 * kStatusesHeld);
    EXPECT_THAT(its.take(kStart + 4 * kStatusesHeld), ElementsAre("e2"));
}

}  // namespace
}  // namespace axon::front_end_server
