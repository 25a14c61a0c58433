// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <cstdint>

#include "common/clock.hpp"

namespace axon {

/// Entities that one client may drill in a second.
inline constexpr std::uint32_t kDrillsPerSecond = 1000;

/// Admits at most `per_second` messages in each second of the clock. Threads: any. If two threads begin a new
/// second at the same time, a few more can be admitted.
class RateLimit {
  public:
    explicit RateLimit(std::uint32_t per_second) : per_second_(per_second) {}

    /// `count`: how many messages this one counts as. A message that begins within the limit is admitted even
    /// if it ends beyond it.
    bool admit(TimePoint now, std::uint32_t count = 1) {
        const auto second = std::chrono::duration_cast<std::chrono::seconds>(now.time_since_epoch()).count();
        if (second_.load(std::memory_order_relaxed) != second) {
            second_.store(second, std::memory_order_relaxed);
            count_.store(0, std::memory_order_relaxed);
        }
        return count_.fetch_add(count, std::memory_order_relaxed) < per_second_;
    }

  private:
    const std::uint32_t per_second_;
    std::atomic<std::int64_t> second_{0};
    std::atomic<std::uint32_t> count_{0};
};

}  // namespace axon
