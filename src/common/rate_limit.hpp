// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <cstdint>

#include "common/clock.hpp"

namespace axon {

/// Tells a flood from traffic: at most so many messages in each second of the clock. Threads: any; two that
/// begin a new second at once may admit a few more.
class RateLimit {
  public:
    explicit RateLimit(std::uint32_t per_second) : per_second_(per_second) {}

    bool admit(TimePoint now) {
        const auto second = std::chrono::duration_cast<std::chrono::seconds>(now.time_since_epoch()).count();
        if (second_.load(std::memory_order_relaxed) != second) {
            second_.store(second, std::memory_order_relaxed);
            count_.store(0, std::memory_order_relaxed);
        }
        return count_.fetch_add(1, std::memory_order_relaxed) < per_second_;
    }

  private:
    const std::uint32_t per_second_;
    std::atomic<std::int64_t> second_{0};
    std::atomic<std::uint32_t> count_{0};
};

}  // namespace axon
