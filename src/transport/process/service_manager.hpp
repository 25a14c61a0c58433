// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "common/clock.hpp"

namespace axon::transport {

/// Tells the service manager that this process is ready, if it was started by one that asks for that:
/// systemd, by a unit with Type=notify, which names its socket in the environment variable NOTIFY_SOCKET.
/// `systemctl start` returns then. Without the variable nothing happens.
///
/// For the mains of daemons. Does not block for longer than it takes the service manager to read. A socket
/// that cannot be reached is logged as a warning, and the program goes on.
void tellServiceManagerReady();

/// The watchdog of the service manager: tells it again and again that the program does its work. It kills
/// and restarts a program that has not told it so for the whole period (WatchdogSec= in a unit).
///
/// It has no thread of its own, which would go on while the others are stuck. The threads without which the
/// program does nothing call it, and the service manager is told at every third of the period if each of them
/// has called since. It counts real time, as the service manager does, also where the laboratory's time
/// stands (AXON_CLOCK).
///
/// Threads: any. Ownership: outlives the workers.
class ServiceWatchdog {
  public:
    /// To be called on each turn of one thread. Returns after how much real time to call again at the latest.
    /// Does not block.
    using Worker = std::function<Duration()>;

    /// `clock` counts real time; tests have another one.
    ServiceWatchdog(Duration period, std::function<void()> tell,
                    std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>());
    ServiceWatchdog(const ServiceWatchdog&) = delete;
    ServiceWatchdog& operator=(const ServiceWatchdog&) = delete;

    /// As the environment says: WATCHDOG_USEC, WATCHDOG_PID and NOTIFY_SOCKET. Null where nobody watches this
    /// process, and where the variables cannot be used, which is logged as a warning.
    static std::unique_ptr<ServiceWatchdog> fromEnvironment(
        std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>());

    /// For a service manager that starts a program again and watches it no further, as IceGrid's node does:
    /// the kernel ends this process with SIGABRT where the period is over and nobody has been told. Counted
    /// from the first time on. Throws std::system_error if there is no timer left.
    static std::unique_ptr<ServiceWatchdog> ofTheKernel(
        Duration period, std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>());

    /// One more thread without whose calls the service manager is not told.
    Worker worker();

  private:
    Duration turned(std::size_t worker);

    const Duration pause_;
    const std::function<void()> tell_;
    const std::shared_ptr<const Clock> clock_;
    std::mutex mutex_;
    TimePoint next_{};          // guarded by mutex_: when it is told next
    std::vector<bool> called_;  // guarded by mutex_: which workers have called since next_
};

}  // namespace axon::transport
