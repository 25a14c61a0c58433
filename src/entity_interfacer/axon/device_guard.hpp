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
/// A process that was killed or is frozen calls no stop callback, and its device goes on doing what it was
/// told last. A guard is a small process beside the robot application that closes this gap. It has a
/// duplicate of the descriptor of the device's connection (a TCP connection or a serial line) and the bytes
/// that bring the device to rest. It takes no part in the traffic. It writes those bytes when the application
/// has not called beat() for `silence`, or has ended without release().
///
/// Where in the flow: between the code that talks to the device and its connection.
///   1. After each connect, call watch().
///   2. From the thread that serves the connection, call beat() at least five times within `silence`, whether
///      or not the device answers.
///   3. Before each order, ask stopped().
///   4. Before the connection is closed, call release().
/// guardedStreams() in robots/common of the source tree does this for streams.
///
/// States: idle → guarding (watch()) → idle (release()). Or guarding → stopped, when the guard has stopped
/// the device; call watch() again on a new connection.
///
/// After a stop, the guard repeats the bytes every 50 ms for 300 ms. Then it shuts a socket down, so that an
/// application that wakes up cannot drive on over it. On any other descriptor it goes on repeating the bytes
/// until release() or watch().
///
/// The guard and the application watch each other. beat() returns false when the guard has stopped the
/// device, and also when the guard is gone or frozen. The application must then stop the device itself and
/// close the connection. The next release() or watch() logs what happened, and watch() starts another guard.
///
/// The guard is made by fork(), at construction and whenever it has to be replaced. Construct it early, while
/// the process is small. It ignores signals of the terminal, has a session of its own, and ends with the
/// application. It measures time by CLOCK_MONOTONIC. Time in which the guard itself got no processor counts
/// as at most a quarter of `silence`, so that a machine that stands still stops nothing.
///
/// Threads: any. beat() and stopped() never log, and never wait for anything but the lock that watch() and
/// release() take. The destructor waits for the guard to end, at most 0.4 s.
///
/// Failure: the constructor throws std::invalid_argument for options that cannot be used. watch() returns
/// false if no guard can be started. An application in which one thread goes on beating while another one
/// hangs is not detected.
class AXON_EI_API DeviceGuard {
  public:
    struct Options {
        std::string device;  ///< its name, for log lines
        /// The bytes that bring the device to rest, whatever was sent before, even a part of an order. They
        /// must be harmless when they are sent more than once. 1 to 1024 bytes.
        std::string stop;
        std::chrono::milliseconds silence{200};  ///< 50 ms to 10 s
        std::function<void(const std::string& text)>
            logger{};  ///< called on any thread; none = standard error
    };

    explicit DeviceGuard(Options options);
    ~DeviceGuard();
    DeviceGuard(const DeviceGuard&) = delete;
    DeviceGuard& operator=(const DeviceGuard&) = delete;

    /// Guards the device behind this open descriptor from now on, instead of the one before. The caller keeps
    /// the descriptor. Returns false if the descriptor is negative, or if there is no guard and none can be
    /// started. Nothing is guarded then: do not drive.
    bool watch(int descriptor);
    /// Tells the guard that the application is alive. Returns false if nothing is guarded, or no longer (see
    /// above).
    bool beat();
    /// True if the guard has stopped the device since watch(). No order may be sent then.
    bool stopped() const;
    /// Ends the guarding. Afterwards the guard has closed its duplicate and writes nothing. Normally returns
    /// at once. A guard that does not answer within `silence` is killed, because it would keep the device's
    /// connection open.
    void release();
    /// Process id of the guard; 0 = there is none.
    int pid() const;

  private:
    class Desk;
    std::unique_ptr<Desk> desk_;
};

}  // namespace axon
