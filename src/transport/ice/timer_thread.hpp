// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

#include "common/clock.hpp"
#include "common/routed.hpp"

namespace axon::transport {

/// A thread of a server that lets time pass for its core, or works off what others leave to it. Calls `tick`
/// at the time that its last call returned and when it is woken, but not more often than once in `pause`.
/// Of the signal lane, as heartbeats and watchdogs are, it runs under SCHED_RR where permitted. The
/// destructor ends it.
///
/// `turned` is called after each `tick`, and says after how much real time `tick` is called again at the
/// latest, also while the clock stands (ServiceWatchdog::Worker). Empty: there is no such bound.
class TimerThread {
  public:
    TimerThread(std::string name, Lane lane, Duration pause, const Clock& clock,
                std::function<TimePoint()> tick, std::function<Duration()> turned = {});
    ~TimerThread();
    TimerThread(const TimerThread&) = delete;
    TimerThread& operator=(const TimerThread&) = delete;

    /// Something is due earlier than was said. Any thread; does not wait.
    void wake();
    /// Joins the thread: `tick` is not called again. wake() may still be called, and does nothing then. Not
    /// from `tick`.
    void end();

  private:
    void run();

    const std::string name_;
    const Lane lane_;
    const Duration pause_;
    const Clock& clock_;
    const std::function<TimePoint()> tick_;
    const std::function<Duration()> turned_;
    std::mutex mutex_;
    std::condition_variable changed_;
    bool woken_ = false;     // guarded by mutex_
    bool stopping_ = false;  // guarded by mutex_
    std::thread thread_;
};

}  // namespace axon::transport
