// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <condition_variable>
#include <mutex>

#include "common/clock.hpp"

namespace axon {

/// Waits until the condition holds or the clock says `deadline`; returns the condition. `lock` holds the
/// mutex of the condition, as with std::condition_variable.
template <class Condition>
bool waitUntil(std::condition_variable& changed, std::unique_lock<std::mutex>& lock, const Clock& clock,
               TimePoint deadline, Condition condition) {
    constexpr Duration kLongest = std::chrono::hours{1};  // "never" would overflow a sum with the time
    while (!condition()) {
        const auto left = clock.realTimeUntil(deadline);
        if (left <= Duration::zero()) return false;
        changed.wait_for(lock, std::min(left, kLongest));
    }
    return true;
}

}  // namespace axon
