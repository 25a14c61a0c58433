// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <cstdint>

#include "common/clock.hpp"

namespace axon {

/// Spaces out events that come too fast and of which only the newest matters: passes a second's worth at
/// once, then evenly. Not thread-safe.
class Pace {
  public:
    explicit Pace(std::uint32_t per_second) : step_(Duration(std::chrono::seconds{1}) / per_second) {}

    /// When the next may go: now, or when what went before has been made up for.
    TimePoint next(TimePoint now) const { return std::max(now, spent_until_ - std::chrono::seconds{1}); }
    /// One event has passed. It counts as `count` events.
    void take(TimePoint now, std::uint32_t count = 1) {
        spent_until_ = std::max(spent_until_, now) + count * step_;
    }

  private:
    const Duration step_;
    TimePoint spent_until_;
};

}  // namespace axon
