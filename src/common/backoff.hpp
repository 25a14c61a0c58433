// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <utility>

#include "common/clock.hpp"

namespace axon {

/// How long to wait before something that has failed is tried again: `first`, then twice as long each time,
/// up to `last`; from `first` again after reset(). Whoever tries says what a success is. I/O-free, not
/// thread-safe.
class Backoff {
  public:
    Backoff(Duration first, Duration last) : first_(first), last_(last), next_(first) {}

    /// The wait before the next attempt; the one after it is longer.
    Duration next() { return std::exchange(next_, std::min(next_ * 2, last_)); }
    void reset() { next_ = first_; }

  private:
    Duration first_;
    Duration last_;
    Duration next_;
};

}  // namespace axon
