// SPDX-License-Identifier: MIT
#include "common/life_signs.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

using namespace std::chrono_literals;

class LifeSignsTest : public testing::Test {
  protected:
    LifeSignsTest() {
        signs.allow(250ms, clock.now());
        signs.heard(clock.now());
    }
    void beats(Duration period, int how_many) {
        for (int i = 0; i < how_many; ++i) {
            clock.advance(period);
            signs.heard(clock.now());
        }
    }
    ManualClock clock;
    LifeSigns signs;
};

TEST_F(LifeSignsTest, RemembersTheLongestGapOfTheLastMinuteAndForgetsItThen) {
    beats(50ms, 10);
    beats(180ms, 1);
    beats(50ms, 1000);  // 50 s
    EXPECT_EQ(signs.longest(clock.now()).length, 180ms);
    EXPECT_EQ(signs.longest(clock.now()).allowed, 250ms);
    EXPECT_GE(signs.longest(clock.now()).part(), LifeSigns::kWarnFrom);
    EXPECT_EQ(describe(signs.longest(clock.now())),
              "180 ms of 250 ms allowed was its longest silence in the last minute");
    beats(50ms, 500);
    EXPECT_EQ(signs.longest(clock.now()).length, 50ms);
}

TEST_F(LifeSignsTest, TheSilenceThatLastsCounts) {
    clock.advance(200ms);
    EXPECT_EQ(signs.longest(clock.now()).length, 200ms);
    EXPECT_EQ(signs.last(), clock.now() - 200ms);
}

TEST_F(LifeSignsTest, EachGapIsMeasuredAgainstWhatWasAllowedThen) {
    signs.allow(10s, clock.now());
    beats(2s, 3);
    EXPECT_DOUBLE_EQ(signs.longest(clock.now()).part(), 0.2);
    // A task begins in the middle of a long silence that was allowed.
    clock.advance(1900ms);
    signs.allow(250ms, clock.now());
    beats(50ms, 2);
    EXPECT_DOUBLE_EQ(signs.longest(clock.now()).part(), 0.2);
    EXPECT_EQ(signs.longest(clock.now()).allowed, 10s);
}

TEST(LifeSigns, NothingHeardIsNoGap) {
    ManualClock clock;
    LifeSigns signs;
    signs.heard(clock.now());
    clock.advance(1h);
    EXPECT_EQ(signs.longest(clock.now()).part(), 0);
}

}  // namespace
}  // namespace axon
