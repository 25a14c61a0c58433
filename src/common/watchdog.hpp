// SPDX-License-Identifier: MIT
#pragma once
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
        : busy_timeout_(busy), idle_timeout_(idle), last_(now) {}

    /// A sign of life.
    void feed(TimePoint now) { last_ = now; }

    /// Whether a task runs. Becoming busy counts as a sign of life: the peer could not have known before.
    void setBusy(bool busy, TimePoint now) {
        if (busy && !busy_) last_ = now;
        busy_ = busy;
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
    bool busy_ = false;
};

}  // namespace axon
