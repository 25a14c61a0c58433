// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <chrono>

#include "common/backoff.hpp"
#include "common/clock.hpp"

namespace axon::client {

/// When a client that has lost its server logs in again: kFirst after the loss, then each time after twice as
/// long, up to kLast. Threads: ask() any; the rest on the one thread that logs in.
class Reconnection {
  public:
    static constexpr Duration kFirst = std::chrono::milliseconds{100};
    static constexpr Duration kLast = std::chrono::seconds{2};

    /// The session is lost.
    void ask() { asked_ = true; }
    bool isDue(TimePoint now) {
        if (asked_.exchange(false)) {
            wait_.reset();
            at_ = now + wait_.next();
        }
        return now >= at_;
    }
    void succeeded() { at_ = TimePoint::max(); }
    void failed(TimePoint now) { at_ = now + wait_.next(); }
    /// When it is due; TimePoint::max() while there is a session.
    TimePoint at() const { return at_; }

  private:
    std::atomic<bool> asked_{false};
    Backoff wait_{kFirst, kLast};
    TimePoint at_ = TimePoint::max();
};

}  // namespace axon::client
