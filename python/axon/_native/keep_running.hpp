// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <thread>

namespace axon::python {

/// Knows whether the interpreter still runs: a thread takes the GIL again and again and notes when it had it.
///
/// What is asked on the heartbeat thread of the client library reads one atomic, so heartbeats do not wait
/// for Python. A loop in Python lets this thread in, as it lets every thread of Python in; native code that
/// keeps the GIL does not.
class KeepRunning {
  public:
    explicit KeepRunning(std::chrono::duration<double> longest);
    ~KeepRunning();
    KeepRunning(const KeepRunning&) = delete;
    KeepRunning& operator=(const KeepRunning&) = delete;

    /// False if nobody has had the GIL for longer than `longest`, other than the one who has it now. Threads:
    /// any.
    bool runs() const;
    /// Ends the thread. Without the GIL. Threads: any.
    void end();

  private:
    void run();

    const std::chrono::steady_clock::duration longest_;
    std::atomic<std::chrono::steady_clock::time_point> last_;
    std::mutex mutex_;
    std::condition_variable changed_;
    bool ended_ = false;  // guarded by mutex_
    std::mutex end_mutex_;
    std::thread thread_;  // joined under end_mutex_
};

}  // namespace axon::python
