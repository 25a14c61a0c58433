// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <mutex>

namespace axon::peoplebot {

/// Stands between motions and the robot's motors, so that no velocity can follow a stop that it should not: a
/// task takes the drive, its velocities pass while the gate is open, a stop closes the gate and halts the
/// robot in one step, and the task that was stopped cannot open it again.
///
/// States: free → taken, open (take()) → taken, closed (stop()) → free (giveBack(); also from open).
/// Threads: any; the stop thread calls stop(). The lock is held for one write that does not block, never
/// while waiting.
class DriveGate {
  public:
    /// Both must not block. Give false when the robot cannot be reached.
    struct Robot {
        std::function<bool(double forward_mm_s, double left_deg_s)> drive;
        std::function<bool()> stop;
    };

    explicit DriveGate(Robot robot) : robot_(std::move(robot)) {}

    /// False, and nothing taken, when another motion has the drive or the task was told to stop already. The
    /// predicate is asked under the lock: it becomes true before stop() is called, so either it is seen here,
    /// or stop() closes.
    bool take(const std::function<bool()>& stop_requested) {
        const std::lock_guard lock(mutex_);
        if (taken_ || stop_requested()) return false;
        taken_ = open_ = true;
        return true;
    }

    /// False when the gate is closed or the robot cannot be reached.
    bool drive(double forward_mm_s, double left_deg_s) {
        const std::lock_guard lock(mutex_);
        return open_ && robot_.drive(forward_mm_s, left_deg_s);
    }

    /// Halts the robot at once, and the motion goes on: for what appears suddenly. False as drive().
    bool halt() {
        const std::lock_guard lock(mutex_);
        return open_ && robot_.stop();
    }

    /// Closes and halts the robot; true when the robot was told.
    bool stop() {
        const std::lock_guard lock(mutex_);
        open_ = false;
        return robot_.stop();
    }

    /// The robot is lost: the motion under way gives no orders over the next connection.
    void lost() {
        const std::lock_guard lock(mutex_);
        open_ = false;
    }

    /// Ends the motion: halts the robot, and the drive is free for the next task.
    void giveBack() {
        const std::lock_guard lock(mutex_);
        taken_ = open_ = false;
        robot_.stop();
    }

  private:
    const Robot robot_;
    std::mutex mutex_;
    bool taken_ = false;  // guarded by mutex_
    bool open_ = false;   // guarded by mutex_
};

}  // namespace axon::peoplebot
