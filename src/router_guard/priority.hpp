// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <functional>
#include <stop_token>
#include <string>
#include <thread>

namespace axon::router_guard {

/// How much of the processor a router may use with real-time priority: a store of 50 ms that fills with an
/// eighth of the time that passes. When it is empty there is no real time until it is full again. That is for
/// heartbeats and stops; a flood, or many who log in at the same time after a loss, does not get it for long.
/// Threads: one. Failure: none.
class CpuBudget {
  public:
    using Duration = std::chrono::nanoseconds;
    static constexpr Duration kBurst = std::chrono::milliseconds{50};
    static constexpr int kPart = 8;  // of the time that passes

    /// Whether it may have real-time priority from now on; since the last call `passed`, and the process used
    /// `used` of all processors.
    bool allows(Duration used, Duration passed);

  private:
    Duration left_ = kBurst;
    bool real_time_ = true;
};

/// The priority of a router, whose threads pass stops on between threads with real-time priority (ADR 0018):
/// real time while CpuBudget allows it, and nice -10, which goes before ordinary programs, otherwise and
/// where real time is not permitted. Holds for all threads of the process but those with SCHED_BATCH, such as
/// that of the audit trail, which may begin before. What is not permitted is told once. Threads: begin() and
/// end() one; a thread of its own, with a higher priority, looks a hundred times a second.
class Priority {
  public:
    /// `tell`: a sentence for the log, from begin().
    explicit Priority(std::function<void(const std::string&)> tell) : tell_(std::move(tell)) {}
    ~Priority() { end(); }
    Priority(const Priority&) = delete;
    Priority& operator=(const Priority&) = delete;
    /// Before the process starts other threads that are to have what this one has.
    void begin();
    void end();

  private:
    void goBeforeOrdinaryPrograms();
    static void watch(const std::stop_token& ended);

    const std::function<void(const std::string&)> tell_;
    std::jthread watch_;
};

}  // namespace axon::router_guard
