// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <mutex>
#include <string>
#include <unordered_set>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/rate_limit.hpp"

namespace axon::front_end_server {

/// How many statuses of entities that it does not hold a client is told at once, in a second. Of more it is
/// told within kStatusesHeld, and then only what is so by that time.
inline constexpr std::uint32_t kStatusesAtOnce = 10;
inline constexpr Duration kStatusesHeld = std::chrono::milliseconds{100};

/// Of which entities one client is to be told the status a little later (ADR 0048).
///
/// It keeps no status: who tells it looks up the last one. Bound: one name for each entity. Threads: any; a
/// mutex of its own, under which nothing is called. Failure: none.
class HeldStatuses {
  public:
    /// `phase`: when in each kStatusesHeld it is told, so that not all clients are at the same moment.
    explicit HeldStatuses(Duration phase) : phase_(phase % kStatusesHeld) {}

    enum class Verdict : std::uint8_t {
        Now,   ///< the status is to be told
        Held,  ///< take() will give the entity
        First  ///< the same, and nothing was held before: due() is another now
    };
    Verdict offer(const std::string& entity, TimePoint now) {
        const std::lock_guard lock(mutex_);
        if (held_.contains(entity)) return Verdict::Held;
        // Not past what is held: a client is told of entities in the order in which they changed.
        if (held_.empty() && at_once_.admit(now)) return Verdict::Now;
        const bool first = held_.empty();
        if (first) {
            order_.clear();
            due_ =
                TimePoint{((now - phase_).time_since_epoch() / kStatusesHeld + 1) * kStatusesHeld} + phase_;
        }
        held_.insert(entity);
        order_.push_back(entity);
        return first ? Verdict::First : Verdict::Held;
    }
    /// It is told of this entity at once: it need not be told later.
    void drop(const std::string& entity) {
        const std::lock_guard lock(mutex_);
        if (held_.erase(entity) > 0) std::erase(order_, entity);
    }
    /// The entities that are held, in the order in which they came; none before they are due.
    std::vector<std::string> take(TimePoint now) {
        const std::lock_guard lock(mutex_);
        if (now < due_) return {};
        held_.clear();
        return std::exchange(order_, {});
    }
    /// When take() has something; the latest time there is where nothing is held.
    TimePoint due() const {
        const std::lock_guard lock(mutex_);
        return held_.empty() ? TimePoint::max() : due_;
    }

  private:
    const Duration phase_;
    mutable std::mutex mutex_;
    RateLimit at_once_{kStatusesAtOnce};
    std::unordered_set<std::string> held_;
    std::vector<std::string> order_;  // of the same
    TimePoint due_;                   // of what is held
};

}  // namespace axon::front_end_server
