// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <cstdint>

#include "common/clock.hpp"

namespace axon {

/// Watches the liveness of one peer on the watching side's own clock. Two time-outs: a short one while a task
/// runs and a long one otherwise (safety.md, "Watchdogs"). I/O-free: the owner tells it of each sign of life
/// and asks it. States: alive, expired; feed() brings it back to alive. Threads: none of its own, not
/// thread-safe; the owner confines it.
class Watchdog {
  public:
    Watchdog(Duration busy, Duration idle, TimePoint now)
        : busy_timeout_(busy), idle_timeout_(idle), last_(now), idle_since_(now) {}

    /// A sign of life.
    void feed(TimePoint now) { last_ = now; }

    /// Whether a task runs. While none does, the peer is not expected to beat fast, and that time does not
    /// count as silence. After a pause of at least the short time-out, becoming busy counts as a sign of
    /// life. After a shorter one it does not: otherwise a chain of short tasks would hide a peer that is
    /// gone.
    void setBusy(bool busy, TimePoint now) {
        if (busy == busy_) return;
        busy_ = busy;
        if (!busy) {
            idle_since_ = now;
            return;
        }
        const auto silence = now - idle_since_ < busy_timeout_ ? idle_since_ - last_ : Duration{};
        last_ = now - std::max(silence, Duration{});  // negative: it was heard in the pause
    }

    bool busy() const { return busy_; }
    Duration timeout() const { return busy_ ? busy_timeout_ : idle_timeout_; }
    TimePoint deadline() const { return last_ + timeout(); }
    bool expired(TimePoint now) const { return now >= deadline(); }

    /// What is left, as a part of the whole: 1 just fed, 0 expired. Warn below a half, before the trip.
    double margin(TimePoint now) const {
        const auto left = std::chrono::duration<double>(deadline() - now).count();
        return left <= 0 ? 0 : left / std::chrono::duration<double>(timeout()).count();
    }

  private:
    Duration busy_timeout_;
    Duration idle_timeout_;
    TimePoint last_;
    TimePoint idle_since_;  ///< while not busy
    bool busy_ = false;
};

}  // namespace axon
