// SPDX-License-Identifier: MIT
#include "testing/entity/step_clock.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

#include "common/waiting.hpp"

namespace axon::testing {
namespace {

using namespace std::chrono_literals;

/// A thread that waits in steps, as the loop of a handler does, and notes when each of its steps was. Made,
/// it waits for the first one.
class Walker {
  public:
    Walker(StepClock& clock, Duration step, int steps) {
        const auto others = clock.waiting();
        thread_ = std::thread([this, &clock, step, steps] {
            std::mutex mutex;
            std::condition_variable never;
            std::unique_lock lock(mutex);
            for (int i = 0; i < steps; ++i) {
                axon::waitUntil(never, lock, clock, clock.now() + step, [this] { return given_up_.load(); });
                times_.push_back(clock.elapsed());
            }
        });
        while (clock.waiting() == others) std::this_thread::yield();
    }
    ~Walker() { times(); }
    /// When its steps were. Those that it has not come to until now are taken at once, at the clock's time.
    const std::vector<Duration>& times() {
        given_up_ = true;
        if (thread_.joinable()) thread_.join();
        return times_;
    }

  private:
    std::vector<Duration> times_;  // of its thread, until that has ended
    std::atomic<bool> given_up_{false};
    std::thread thread_;
};

TEST(StepClock, StandsStillUntilTimeIsLetPass) {
    StepClock clock;
    EXPECT_EQ(clock.elapsed(), 0s);
    clock.advance(3s);
    EXPECT_EQ(clock.elapsed(), 3s);
}

TEST(StepClock, NoTimeAndNegativeTimeAreNoTime) {
    StepClock clock;
    clock.advance(0s);
    clock.advance(-5s);
    EXPECT_EQ(clock.elapsed(), 0s);
}

TEST(StepClock, AnAdvanceTakesAWaitingThreadThroughEachOfItsSteps) {
    StepClock clock;
    Walker walker(clock, 50ms, 20);
    clock.advance(10s);
    ASSERT_EQ(walker.times().size(), 20U);
    for (std::size_t i = 0; i < 20; ++i) EXPECT_EQ(walker.times()[i], 50ms * (i + 1));
    EXPECT_EQ(clock.elapsed(), 10s);
}

TEST(StepClock, ThreadsWithDifferentStepsStayInOrder) {
    StepClock clock;
    Walker quick(clock, 20ms, 30);
    Walker slow(clock, 70ms, 8);
    clock.advance(600ms);
    ASSERT_EQ(quick.times().size(), 30U);
    ASSERT_EQ(slow.times().size(), 8U);
    EXPECT_EQ(quick.times().back(), 600ms);
    EXPECT_EQ(slow.times().back(), 560ms);
}

TEST(StepClock, AThreadThatHasEndedIsNotWaitedForAgain) {
    StepClock clock;
    { Walker walker(clock, 1h, 1); }
    clock.advance(3h);
    EXPECT_EQ(clock.elapsed(), 3h);
}

TEST(StepClock, AStepGoesNoFurtherThanItMay) {
    StepClock clock;
    clock.step(100ms);
    EXPECT_EQ(clock.elapsed(), 100ms);
}

TEST(StepClock, WhoFollowsIsCalledUntilItsTokenIsGone) {
    StepClock clock;
    int calls = 0;
    auto token = clock.follow([&] { ++calls; });
    clock.advance(1s);
    EXPECT_EQ(calls, 1);
    token.reset();
    clock.advance(1s);
    EXPECT_EQ(calls, 1);
}

}  // namespace
}  // namespace axon::testing
