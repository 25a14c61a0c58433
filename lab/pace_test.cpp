// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/pace.hpp"

#include <gtest/gtest.h>

namespace axon::lab {
namespace {

using namespace std::chrono_literals;

class PaceTest : public ::testing::Test {
  protected:
    void SetUp() override { pace_.rebase(now_, age_); }
    /// Steps as far as it is told, without a break: how often clients are served, and what was given up.
    int catchUp(double speed = 1) {
        int looks = 0;
        for (bool behind = true; behind; ++looks) {
            const auto order = pace_.next(now_, age_, speed);
            EXPECT_LE(order.until - age_, Pace::kSlice);
            age_ = std::max(age_, order.until);
            given_up_ += order.given_up;
            behind = order.behind;
        }
        return looks;
    }
    TimePoint now_{1000s};
    Duration age_ = 5s;
    Duration given_up_{};
    Pace pace_{250ms};
};

TEST_F(PaceTest, TheWorldKeepsPaceWithTheClockTimesTheSpeed) {
    for (int i = 0; i < 1000; ++i) {
        now_ += Pace::kTick;
        EXPECT_EQ(catchUp(), 1);
    }
    EXPECT_EQ(age_, 13s);
    pace_.rebase(now_, age_);
    now_ += 10ms;
    EXPECT_EQ(catchUp(4), 2) << "40 ms of the world in two slices";
    EXPECT_EQ(age_, 13s + 40ms);
    EXPECT_EQ(given_up_, 0ms);
}

TEST_F(PaceTest, ClientsAreServedInEverySliceWhileItCatchesUp) {
    now_ += 200ms;
    EXPECT_EQ(catchUp(), 10);
    EXPECT_EQ(age_, 5s + 200ms);
    EXPECT_EQ(given_up_, 0ms);
}

TEST_F(PaceTest, WhatIsLongerBehindIsGivenUpOnceAndNotRacedAfter) {
    now_ += 10s;
    catchUp();
    EXPECT_EQ(age_, 5s + 250ms);
    EXPECT_EQ(given_up_, 10s - 250ms);
    now_ += 100ms;
    catchUp();
    EXPECT_EQ(age_, 5s + 350ms);
    EXPECT_EQ(given_up_, 10s - 250ms);
}

TEST_F(PaceTest, WhoseTimeIsEverybodysLosesItSooner) {
    Pace shared{0ms};
    shared.rebase(now_, age_);
    const auto order = shared.next(now_ + 100ms, age_, 2);
    EXPECT_EQ(order.given_up, 200ms - 48ms);
}

}  // namespace
}  // namespace axon::lab
