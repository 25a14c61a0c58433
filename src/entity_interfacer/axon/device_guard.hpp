// SPDX-License-Identifier: MIT
#pragma once
#include <chrono>
#include <functional>
#include <memory>
#include <string>

#ifndef AXON_EI_API
#define AXON_EI_API __attribute__((visibility("default")))
#endif

namespace axon {

/// Stops a device when the process that drives it freezes or dies.
///
/// No stop callback is called in a process that was killed, and none in one that is frozen: what the device
/// was told last it goes on doing. A guard is a small process of its own beside the robot application. It is
/// given a duplicate of the descriptor of the device's connection, a TCP connection or a serial line, and the
/// bytes that bring the device to rest. It takes no part in the traffic. It writes those bytes when the
/// application has not called beat() for `silence`, or has ended without release().
///
/// Where in the flow: between the code that talks to the device and its connection. After each connect,
/// watch(); beat() from the thread that attends to the connection, at least five times within `silence`,
/// whatever the device says; before each order, ask stopped(); before the connection is closed, release().
/// guardedStreams() in robots/common of the source does that for streams.
///
/// States: idle → guarding (watch()) → idle (release()), or → stopped (the guard has stopped the device; then
/// watch() again on a new connection).
///
/// After a stop the guard repeats the bytes every 50 ms for 300 ms. Then it shuts a socket down, so that an
/// application that wakes up cannot drive on by it; on any other descriptor it repeats them until release()
/// or watch(). The guard watches the application, and the application the guard: beat() is false when the
/// guard has stopped the device, and also when the guard is gone or frozen. Then the application itself stops
/// the device, and closes the connection; release() or the next watch() logs it, and that one starts another
/// guard.
///
/// The guard's process is made by fork(), at construction and when it has to be replaced; construct early,
/// while the process is small. It leaves signals of the terminal alone, has a session of its own, and ends
/// with the application. Time is CLOCK_MONOTONIC. Time in which the guard itself got no processor counts as
/// a quarter of `silence` at most, so that a machine that stands still stops nothing.
///
/// Threads: any. beat() and stopped() never log and wait for nothing but the lock of watch() and release().
/// Not copyable; the destructor waits for the guard's end, at most 0.4 s. Failure: the constructor throws
/// std::invalid_argument for options that cannot be used; a guard that cannot be started makes watch() false.
/// Not noticed: an application whose one thread beats on while another one hangs.
class AXON_EI_API DeviceGuard {
  public:
    struct Options {
        std::string device;  ///< its name, for log lines
        /// What brings it to rest whatever was sent before, a part of an order included; harmless when it
        /// comes more than once. 1 to 1024 bytes.
        std::string stop;
        std::chrono::milliseconds silence{200};                 ///< 50 ms to 10 s
        std::function<void(const std::string& text)> logger{};  ///< any thread; none: standard error
    };

    explicit DeviceGuard(Options options);
    ~DeviceGuard();
    DeviceGuard(const DeviceGuard&) = delete;
    DeviceGuard& operator=(const DeviceGuard&) = delete;

    /// The device behind this open descriptor is guarded from now on, instead of the one before. The caller
    /// keeps the descriptor. False, and nothing is guarded, when it is negative, or when there is no guard
    /// and none can be started: do not drive then.
    bool watch(int descriptor);
    /// The application lives. False when nothing is guarded, or no longer: see above.
    bool beat();
    /// Whether the guard has stopped the device since watch(), so that no order may be sent.
    bool stopped() const;
    /// The device is no longer guarded; the guard has closed its duplicate and writes nothing. Returns at
    /// once as a rule; a guard that does not answer within `silence` is killed, since it would keep the
    /// device's connection open.
    void release();
    /// Of the guard's process; 0 where there is none.
    int pid() const;

  private:
    class Desk;
    std::unique_ptr<Desk> desk_;
};

}  // namespace axon
