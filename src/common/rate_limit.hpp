// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <cstdint>

#include "common/clock.hpp"

namespace axon {

/// Entities that one client may drill in a second.
inline constexpr std::uint32_t kDrillsPerSecond = 1000;

/// Tells a flood from traffic: at most so many messages in each second of the clock. Threads: any; two that
/// begin a new second at once may admit a few more.
class RateLimit {
  public:
    explicit RateLimit(std::uint32_t per_second) : per_second_(per_second) {}

    /// `count`: of messages that are like so many. The first that goes beyond is still admitted if it began
    /// within.
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
