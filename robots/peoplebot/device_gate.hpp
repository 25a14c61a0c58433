// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <mutex>
#include <utility>

namespace axon::peoplebot {

/// For the gripper and the camera's head what DriveGate is for the motors: no order can follow a stop that it
/// should not. A task takes the device, its orders pass while the gate is open, a stop closes the gate and
/// halts the device in one step, and the task that was stopped cannot open it again. Unlike the motors a
/// device is not halted when its task ends: what the gripper holds is to stay held.
///
/// States: free → taken, open (take()) → taken, closed (stop()) → free (giveBack(); also from open).
/// Threads: any; the stop thread calls stop(). The lock is held for one write that does not block.
class DeviceGate {
  public:
    explicit DeviceGate(std::function<void()> halt) : halt_(std::move(halt)) {}

    /// As DriveGate::take().
    bool take(const std::function<bool()>& stop_requested) {
        const std::lock_guard lock(mutex_);
        if (taken_ || stop_requested()) return false;
        taken_ = open_ = true;
        return true;
    }
    /// Gives the order while the gate is open; false when it is not, or the order was not taken.
    template <class Order>
    bool order(Order&& give) {
        const std::lock_guard lock(mutex_);
        return open_ && give();
    }
    void stop() {
        const std::lock_guard lock(mutex_);
        open_ = false;
        halt_();
    }
    void giveBack() {
        const std::lock_guard lock(mutex_);
        taken_ = open_ = false;
    }

  private:
    const std::function<void()> halt_;
    std::mutex mutex_;
    bool taken_ = false;  // guarded by mutex_
    bool open_ = false;   // guarded by mutex_
};

}  // namespace axon::peoplebot
