// SPDX-License-Identifier: MIT
#include "entity_interfacer/silence_count.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

using namespace std::chrono_literals;

class SilenceCountTest : public ::testing::Test {
  protected:
    bool lookAfter(Duration time, std::uint64_t count) {
        clock_.advance(time);
        return silence_.look(count, clock_.now());
    }
    void SetUp() override { silence_.restart(7, clock_.now()); }

    ManualClock clock_;
    SilenceCount silence_{200ms};
};

TEST_F(SilenceCountTest, ACounterThatGrowsIsNeverSilent) {
    for (std::uint64_t count = 8; count < 100; ++count) EXPECT_FALSE(lookAfter(190ms, count));
}

TEST_F(SilenceCountTest, OneThatStandsIsSilentAfterTheLimit) {
    for (int i = 0; i < 19; ++i) EXPECT_FALSE(lookAfter(10ms, 7));
    EXPECT_TRUE(lookAfter(10ms, 7));
    EXPECT_TRUE(lookAfter(10ms, 7));
}

TEST_F(SilenceCountTest, ASignOfLifeBeginsItAnew) {
    for (int i = 0; i < 19; ++i) EXPECT_FALSE(lookAfter(10ms, 7));
    EXPECT_FALSE(lookAfter(10ms, 8));
    for (int i = 0; i < 19; ++i) EXPECT_FALSE(lookAfter(10ms, 8));
    EXPECT_TRUE(lookAfter(10ms, 8));
}

TEST_F(SilenceCountTest, TimeInWhichNobodyLookedCountsLittle) {
    EXPECT_FALSE(lookAfter(10s, 7));
    EXPECT_FALSE(lookAfter(10s, 7));
    EXPECT_FALSE(lookAfter(10s, 8));
}

TEST_F(SilenceCountTest, ALongLimitIsNoticedAfterThatLimit) {
    SilenceCount silence(10s);
    silence.restart(7, clock_.now());
    for (int i = 0; i < 4; ++i) {
        clock_.advance(2s);
        EXPECT_FALSE(silence.look(7, clock_.now()));
    }
    clock_.advance(2s);
    EXPECT_TRUE(silence.look(7, clock_.now()));
}

TEST_F(SilenceCountTest, WhoeverLooksRarelyNoticesLaterAndNotNever) {
    for (int i = 0; i < 3; ++i) EXPECT_FALSE(lookAfter(100ms, 7));
    EXPECT_TRUE(lookAfter(100ms, 7));
}

}  // namespace
}  // namespace axon
