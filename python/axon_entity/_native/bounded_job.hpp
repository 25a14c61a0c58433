// SPDX-License-Identifier: MIT
#pragma once
#include <chrono>
#include <functional>
#include <memory>

namespace axon::python {

/// Runs jobs that may block in the system for an unknown time, such as writing to a device whose driver
/// waits.
///
/// A job runs on a thread of this object, one after the other, and the caller stops waiting at a time limit
/// or when it is interrupted. The job goes on then, and so does its thread, also when this object has ended:
/// what a job uses belongs to the job. Until it has returned, no other one begins.
///
/// Threads: run() and interrupt() may be called by any. In a process that was forked from its own there is no
/// thread for jobs, and each one is late.
class BoundedJob {
  public:
    using Clock = std::chrono::steady_clock;
    /// The argument says whether the caller waits no longer: the job should then do nothing more.
    using Job = std::function<void(const std::function<bool()>& abandoned)>;
    enum class Outcome { Done, Late, Interrupted };

    BoundedJob();
    ~BoundedJob();
    BoundedJob(const BoundedJob&) = delete;
    BoundedJob& operator=(const BoundedJob&) = delete;

    /// Waits for a former job, too. Throws what the job throws. `interrupted` is asked before the job begins
    /// and after each interrupt().
    Outcome run(Job job, Clock::time_point until, const std::function<bool()>& interrupted);
    void interrupt();

  private:
    struct Run;
    struct State;
    static void serve(State& state);
    const std::shared_ptr<State> state_;
};

}  // namespace axon::python
