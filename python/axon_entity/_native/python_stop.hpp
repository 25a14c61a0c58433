// SPDX-License-Identifier: MIT
#pragma once
#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

namespace axon::python {

/// Calls a stop function that needs the interpreter, and waits for it for a bounded time.
///
/// The function runs on a thread of this object, which may wait for the interpreter as long as it has to. The
/// caller, which is the stop thread, waits without the interpreter and gives up after the bound. The call
/// goes on then. When the same stop is called again, an overdue call counts if it returns within the bound,
/// and is not made a second time beside itself.
///
/// Threads: call() belongs to the stop thread, mover functions to any, end() to the one that made it.
class PythonStop {
  public:
    /// `function` takes the interpreter lock itself and returns what went wrong; empty = nothing.
    using Function = std::function<std::string(const StopSignal&)>;
    PythonStop(Function function, std::chrono::nanoseconds bound);
    ~PythonStop();
    PythonStop(const PythonStop&) = delete;
    PythonStop& operator=(const PythonStop&) = delete;

    /// Throws std::runtime_error if the function has failed or has not returned within the bound.
    void call(const StopSignal& signal);
    /// A callback that may move the robot has returned: a stop function that began before it does not count
    /// for the stop that is called again after it.
    void moverReturned();
    /// Waits for the call that runs. The caller does not hold the interpreter lock.
    void end();

  private:
    void serve();
    const Function function_;
    const std::chrono::nanoseconds bound_;
    std::mutex mutex_;  // never held while the function runs
    std::condition_variable changed_;
    std::uint64_t asked_ = 0, begun_ = 0, done_ = 0;  // guarded by mutex_, as all below
    std::uint64_t movers_ = 0, movers_when_begun_ = 0;
    StopSignal signal_{};
    std::string failed_;
    std::optional<StopSignal> overdue_;
    bool ending_ = false;
    std::thread thread_;
};

}  // namespace axon::python
