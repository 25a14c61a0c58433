// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <chrono>

#include "common/clock.hpp"

namespace axon::lab {

/// How far the world is to be stepped so that it keeps pace with a clock times a speed. After a moment in
/// which this program had no processor it catches up in slices, so that clients are heard in between:
/// commands that came meanwhile belong to their own moments, and an arm that hears of five of them at once
/// jumps. What is longer behind than the lag allowed is given up; the world never races after it.
class Pace {
  public:
    static constexpr Duration kSlice =
        std::chrono::milliseconds{20};  // of the world between two looks at clients
    static constexpr Duration kTick = std::chrono::milliseconds{8};  // of the clock between two looks at it

    /// `least_lag`: of the world, allowed at any speed; three ticks always are.
    explicit Pace(Duration least_lag) : least_lag_(least_lag) {}

    /// From now on the world is that old now.
    void rebase(TimePoint now, Duration age) {
        start_ = now;
        age_ = age;
    }

    struct Order {
        Duration until{};     ///< the age to step to before clients are served
        bool behind = false;  ///< it is not enough: ask again without waiting
        Duration given_up{};  ///< of the world
    };
    Order next(TimePoint now, Duration age, double speed) {
        auto due = age_ + std::chrono::duration_cast<Duration>((now - start_) * speed);
        Order order;
        const auto lag = std::max(least_lag_, std::chrono::duration_cast<Duration>(kTick * speed * 3));
        if (due - age > lag) {
            order.given_up = due - age - lag;
            due = age + lag;
            rebase(now, due);
        }
        order.until = std::min(due, age + kSlice);
        order.behind = order.until < due;
        return order;
    }

  private:
    const Duration least_lag_;
    TimePoint start_{};
    Duration age_{};
};

}  // namespace axon::lab
