// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <chrono>

#include "common/clock.hpp"

namespace axon::transport {

/// Which signs of life through a router want an answer (ADR 0018). A router does not tell that a server has
/// died, except to a call that wants an answer; an answer costs as much as the sign of life, so there is none
/// while the server's own heartbeats come. At most one is on its way.
///
/// Threads: any; there is no lock. One for each session.
class AnsweredBeats {
  public:
    explicit AnsweredBeats(const Clock& clock) : clock_(clock) { expect(std::chrono::milliseconds{50}); }

    /// The period of the server's heartbeats while a task runs; 50 ms until it is told. After two periods
    /// without one an answer is wanted. While the server beats more slowly, as without a task, it is mostly
    /// asked.
    void expect(Duration period) { silent_after_ = 2 * period.count(); }
    /// A heartbeat of the server has come.
    void heard() { heard_.store(clock_.now().time_since_epoch().count(), std::memory_order_relaxed); }
    /// Whether the sign of life that is sent now is to want an answer; if so, answered() follows it.
    bool ask() {
        const TimePoint heard{Duration{heard_.load(std::memory_order_relaxed)}};
        return (clock_.now() - heard).count() > silent_after_ && !asked_.exchange(true);
    }
    void answered() { asked_ = false; }

  private:
    const Clock& clock_;
    std::atomic<Duration::rep> heard_{0};  // long ago: nothing has been heard yet
    std::atomic<Duration::rep> silent_after_;
    std::atomic<bool> asked_{false};
};

}  // namespace axon::transport
