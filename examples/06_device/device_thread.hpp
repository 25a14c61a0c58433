// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <axon/device_guard.hpp>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

/// Serves the line to the motor on a thread of its own.
///
/// Only this thread reads and writes the line. Everybody else leaves a wish and wakes it, so that nobody
/// waits for the motor. The mutex is held for a few assignments, and never while the line is used.
class DeviceThread {
  public:
    /// `stands` is called on the device's thread when the motor has come to rest after a stop.
    DeviceThread(int line, std::function<void()> stands);
    ~DeviceThread();
    DeviceThread(const DeviceThread&) = delete;
    DeviceThread& operator=(const DeviceThread&) = delete;

    // [gate]
    /// The permission to move the motor, which ends with the next stop. A task takes one when it begins.
    using Pass = unsigned;
    Pass pass() const;
    /// Returns false, and does nothing, if there was a stop since the pass was taken.
    bool turn(Pass pass, double deg_s);
    /// Returns at once. The motor is told next, before everything else.
    void stop();
    // [end]
    double angle_deg() const { return angle_deg_; }
    /// The motor has not answered for half a second, or its line is closed.
    bool lost() const { return lost_; }

  private:
    void serve();
    void order();
    void wait();
    void read();

    const int line_;
    const int wake_;
    const std::function<void()> stands_;
    axon::DeviceGuard guard_;
    std::atomic<double> angle_deg_{0};
    std::atomic<bool> lost_{false};
    std::atomic<bool> end_{false};

    mutable std::mutex mutex_;
    Pass stops_ = 0;           // guarded by mutex_
    double wanted_deg_s_ = 0;  // guarded by mutex_
    bool stopping_ = false;    // guarded by mutex_: a stop whose standstill was not reported yet

    // Confined to the device's thread.
    std::string received_;
    double ordered_deg_s_ = 0, speed_deg_s_ = 0;
    int unanswered_ = 0;
    std::chrono::steady_clock::time_point heard_ = std::chrono::steady_clock::now();

    std::thread thread_;
};
