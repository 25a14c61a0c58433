// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/beats.hpp"

#include <gtest/gtest.h>

namespace axon::direct {
namespace {

using namespace std::chrono_literals;

TEST(EndOfAPath, IsSilentAfterAQuarterOfASecondWhileBusyAndTenSecondsOtherwise) {
    ManualClock clock;
    auto end = livenessOfEnd(clock.now());
    EXPECT_EQ(end.deadline(), clock.now() + 10s);
    clock.advance(9s);
    end.setBusy(true, clock.now());  // counts as a sign of life: nobody could have known
    EXPECT_EQ(end.deadline(), clock.now() + 250ms);
    clock.advance(200ms);
    end.setBusy(true, clock.now());
    EXPECT_EQ(end.deadline(), clock.now() + 50ms);
    end.heard(clock.now());
    EXPECT_EQ(end.deadline(), clock.now() + 250ms);
    end.setBusy(false, clock.now());
    EXPECT_EQ(end.deadline(), clock.now() + 10s);
}

TEST(Retry, DoublesFromOneSecondToThirty) {
    Retry retry;
    for (const auto expected : {1s, 2s, 4s, 8s, 16s, 30s, 30s}) EXPECT_EQ(retry.after(0s), expected);
}

TEST(Retry, BeginsAnewAfterAPathThatStoodAndOnlyThen) {
    Retry retry;
    retry.after(0s);
    EXPECT_EQ(retry.after(29s), 2s);
    EXPECT_EQ(retry.after(30s), 1s);
    EXPECT_EQ(retry.after(0s), 2s);
}

TEST(Unacknowledged, AsksForAnAcknowledgementAfterSomeBytesOrMessages) {
    Unacknowledged bytes;
    EXPECT_FALSE(bytes.add(kAcknowledgeAfter - 1));
    EXPECT_TRUE(bytes.add(1));
    EXPECT_FALSE(bytes.add(kAcknowledgeAfter - 1));
    EXPECT_TRUE(bytes.add(kAcknowledgeAfter));
    for (std::size_t i = 1; i < kAcknowledgeAfterMessages; ++i) EXPECT_FALSE(bytes.add(60));
    EXPECT_TRUE(bytes.add(60));
    EXPECT_FALSE(bytes.add(60)) << "it counts anew";
}

}  // namespace
}  // namespace axon::direct
