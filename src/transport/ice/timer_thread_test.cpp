// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/timer_thread.hpp"

#include <gtest/gtest.h>

#include <atomic>

#include "support/loopback.hpp"

namespace axon::transport {
namespace {

using namespace std::chrono_literals;
using test::waitUntil;

/// Stands still until it is told to move, and counts who asks how long to wait.
class StandingClock final : public Clock {
  public:
    TimePoint now() const override { return TimePoint{Duration{ns_}}; }
    Duration realTimeUntil(TimePoint deadline) const override {
        ++looks_;
        return std::min<Duration>(deadline - now(), 1ms);
    }
    void advance(Duration by) { ns_ += by.count(); }
    unsigned looks() const { return looks_; }

  private:
    std::atomic<std::int64_t> ns_{Duration{1000s}.count()};
    mutable std::atomic<unsigned> looks_{0};
};

TEST(TimerThread, TicksWhenItsClockSaysSoOrWhenItIsWokenAndNotBefore) {
    StandingClock clock;
    std::atomic<int> ticks{0};
    TimerThread timer("test-timer", Lane::Data, Duration{}, clock, [&] {
        ++ticks;
        return clock.now() + 10s;
    });
    ASSERT_TRUE(waitUntil([&] { return ticks == 1; }));
    const auto looks = clock.looks();
    ASSERT_TRUE(waitUntil([&] { return clock.looks() > looks + 20; })) << "it looks again and again";
    EXPECT_EQ(ticks, 1) << "no time has passed";
    clock.advance(10s);
    ASSERT_TRUE(waitUntil([&] { return ticks == 2; })) << "long before ten seconds of the machine";
    timer.wake();
    ASSERT_TRUE(waitUntil([&] { return ticks == 3; }));
}

TEST(TimerThread, TurnsInRealTimeWhereItIsAskedToWhileItsClockStands) {
    const StandingClock standing;
    const SteadyClock steady;
    for (const Clock* clock : {static_cast<const Clock*>(&standing), static_cast<const Clock*>(&steady)}) {
        std::atomic<int> ticks{0};
        std::atomic<int> turns{0};
        const TimerThread timer(
            "test-timer", Lane::Data, Duration{}, *clock,
            [&] {
                ++ticks;
                return clock->now() + 1h;
            },
            [&] {
                ++turns;
                return 2ms;
            });
        EXPECT_TRUE(waitUntil([&] { return turns > 20 && ticks > 20; }));
    }
}

}  // namespace
}  // namespace axon::transport
