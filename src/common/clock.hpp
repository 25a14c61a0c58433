// SPDX-License-Identifier: MIT
#pragma once
#include <chrono>
#include <cstdint>

namespace axon {

/// All of Axon counts time on one monotonic clock, never on the wall clock: CLOCK_MONOTONIC, or in trials
/// that of a virtual laboratory (shared_clock.hpp).
using Duration = std::chrono::nanoseconds;
using TimePoint = std::chrono::time_point<std::chrono::steady_clock, Duration>;

/// Where a pure core gets its time from, and how long a thread waits for it. Tests and simulations inject
/// ManualClock; programs inject SteadyClock, or what clockFromEnvironment() says. Threads: any.
class Clock {
  public:
    virtual ~Clock() = default;
    virtual TimePoint now() const = 0;
    /// How long a thread really waits (on CLOCK_MONOTONIC) before it looks again whether `deadline` has come;
    /// zero or less once it has. Never longer than that takes, but it can be shorter: a waiting thread asks
    /// again until now() has reached the deadline.
    virtual Duration realTimeUntil(TimePoint deadline) const { return deadline - now(); }
};

class SteadyClock final : public Clock {
  public:
    TimePoint now() const override { return std::chrono::steady_clock::now(); }
};

/// Stands still until it is told to move. Not thread-safe: for single-threaded tests and simulations.
class ManualClock final : public Clock {
  public:
    TimePoint now() const override { return now_; }
    void advance(Duration by) { now_ += by; }
    void set(TimePoint to) { now_ = to; }

  private:
    TimePoint now_{std::chrono::seconds{1000}};  // not zero, so that "never" and "at the start" differ
};

/// Microseconds since the clock's epoch, as the contracts carry them.
inline std::int64_t toMicroseconds(TimePoint t) {
    return std::chrono::duration_cast<std::chrono::microseconds>(t.time_since_epoch()).count();
}

}  // namespace axon
