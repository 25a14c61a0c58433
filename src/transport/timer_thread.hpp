// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

#include "common/clock.hpp"

namespace axon::transport {

/// The one thread of a server that lets time pass for its core. Calls `tick` at the time that its last call
/// returned, and whenever it is woken. Under SCHED_RR where permitted, as heartbeats and watchdogs belong to
/// the signal lane. The destructor joins it.
class TimerThread {
  public:
    TimerThread(std::string name, const Clock& clock, std::function<TimePoint()> tick);
    ~TimerThread();
    TimerThread(const TimerThread&) = delete;
    TimerThread& operator=(const TimerThread&) = delete;

    /// Something is due earlier than was said. Any thread; does not wait.
    void wake();

  private:
    void run();

    const std::string name_;
    const Clock& clock_;
    const std::function<TimePoint()> tick_;
    std::mutex mutex_;
    std::condition_variable changed_;
    bool woken_ = false;     // guarded by mutex_
    bool stopping_ = false;  // guarded by mutex_
    std::thread thread_;
};

}  // namespace axon::transport
