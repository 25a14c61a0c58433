// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <mutex>

#include "client/sending/next_turn.hpp"
#include "common/clock.hpp"
#include "common/routed.hpp"
#include "transport/ice/timer_thread.hpp"

namespace axon::client {

/// A timer thread of a session that other threads may wake before it is started and while it is being ended,
/// which does nothing then.
class Alarm {
  public:
    void start(const char* name, Lane lane, const Clock& clock, std::function<TimePoint()> tick);
    void wake();
    /// Joins it.
    void end();

    NextTurn turn;  ///< guarded by the lock of the core that it serves

  private:
    std::mutex mutex_;
    std::unique_ptr<transport::TimerThread> thread_;  // guarded by mutex_
};

}  // namespace axon::client
