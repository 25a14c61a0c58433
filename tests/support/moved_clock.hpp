// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <atomic>

#include "common/clock.hpp"

namespace axon::test {

/// Stands still until it is moved, and lets nobody who waits for it sleep for long. Threads: any.
class MovedClock final : public Clock {
  public:
    TimePoint now() const override { return TimePoint{std::chrono::seconds{1000}} + Duration{by_.load()}; }
    Duration realTimeUntil(TimePoint deadline) const override {
        return std::min<Duration>(deadline - now(), std::chrono::milliseconds{1});
    }
    void advance(Duration by) { by_ += by.count(); }

  private:
    std::atomic<Duration::rep> by_{0};
};

}  // namespace axon::test
