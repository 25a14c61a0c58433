// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "common/clock.hpp"

namespace axon::client {

/// When a thread that lets time pass for a core acts next, as seen by those who may have to wake it earlier.
/// Not thread-safe: it is guarded by the lock of that core.
class NextTurn {
  public:
    /// Something is due at this time. True: the thread sleeps longer than that, and is to be woken.
    bool mustWakeFor(TimePoint due) {
        if (due >= at_) return false;
        at_ = due;
        return true;
    }
    /// The thread is awake and will look for itself.
    void begin() { at_ = TimePoint::min(); }
    /// It sleeps until then.
    TimePoint end(TimePoint next) { return at_ = next; }

  private:
    TimePoint at_ = TimePoint::max();
};

}  // namespace axon::client
