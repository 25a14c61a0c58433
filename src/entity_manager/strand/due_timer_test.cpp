// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/strand/due_timer.hpp"

#include <gtest/gtest.h>

#include <asio/io_context.hpp>

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

/// Shows what it is told to; the timer is told to ask again soon.
class StandingClock final : public Clock {
  public:
    TimePoint now() const override { return now_; }
    Duration realTimeUntil(TimePoint deadline) const override {
        ++looks;
        return std::min<Duration>(deadline - now_, 100us);
    }
    void advance(Duration by) { now_ += by; }
    mutable int looks = 0;

  private:
    TimePoint now_{1000s};
};

class DueTimerTest : public ::testing::Test {
  protected:
    /// Lets the timer look at its clock that often, or until it is idle.
    void look(int times) {
        io_.restart();
        for (const int until = clock_.looks + times; clock_.looks < until && io_.run_one() > 0;) {
        }
    }
    auto ringing(int& rings) {
        return [&rings] { ++rings; };
    }
    asio::io_context io_;
    StandingClock clock_;
    DueTimer timer_{io_.get_executor(), clock_};
    int rings_ = 0, others_ = 0;
};

TEST_F(DueTimerTest, RingsOnceWhenItsClockShowsTheTimeAndNotBefore) {
    timer_.at(clock_.now() + 10s, ringing(rings_));
    look(20);
    EXPECT_EQ(rings_, 0) << "no time has passed";
    EXPECT_EQ(timer_.due(), clock_.now() + 10s);
    clock_.advance(10s);
    look(20);
    EXPECT_EQ(rings_, 1);
    EXPECT_EQ(timer_.due(), TimePoint::max());
    clock_.advance(100s);
    look(20);
    EXPECT_EQ(rings_, 1);
}

TEST_F(DueTimerTest, TheLastTimeThatWasSetCountsEarlierOrLater) {
    timer_.at(clock_.now() + 10s, ringing(rings_));
    look(3);
    timer_.at(clock_.now() + 2s, ringing(others_));
    clock_.advance(2s);
    look(20);
    EXPECT_EQ(rings_, 0);
    EXPECT_EQ(others_, 1);

    for (const bool cancelled : {false, true}) {
        SCOPED_TRACE(cancelled);
        rings_ = others_ = 0;
        timer_.at(clock_.now(), ringing(rings_));
        // asio finds both of them due in one look; this one comes first and changes what the other is for.
        asio::steady_timer first(io_, asio::steady_timer::time_point::min());
        first.async_wait([&](const asio::error_code&) {
            if (cancelled) timer_.cancel();
            timer_.at(clock_.now() + 5s, ringing(others_));
        });
        look(20);
        EXPECT_EQ(rings_, 0) << "it was under way when it was put off";
        EXPECT_EQ(others_, 0);
        clock_.advance(5s);
        look(20);
        EXPECT_EQ(rings_, 0);
        EXPECT_EQ(others_, 1);
    }
}

TEST_F(DueTimerTest, WhatWasCancelledDoesNotRingAndItCanBeSetAnewFromItsCall) {
    timer_.at(clock_.now() + 1s, ringing(rings_));
    clock_.advance(1s);
    timer_.cancel();
    look(20);
    EXPECT_EQ(rings_, 0);

    timer_.at(clock_.now(), [this] {
        ++rings_;
        timer_.at(clock_.now() + 1s, ringing(others_));
    });
    look(20);
    EXPECT_EQ(rings_, 1);
    EXPECT_EQ(others_, 0);
    clock_.advance(1s);
    look(20);
    EXPECT_EQ(others_, 1);
}

TEST_F(DueTimerTest, NothingRingsAfterItsEnd) {
    {
        DueTimer ended(io_.get_executor(), clock_);
        ended.at(clock_.now(), ringing(rings_));
    }
    look(20);
    EXPECT_EQ(rings_, 0);
}

}  // namespace
}  // namespace axon::entity_manager
