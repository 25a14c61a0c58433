// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <chrono>
#include <cstdint>
#include <deque>
#include <mutex>
#include <thread>
#include <vector>

namespace axon::faults {

/// A time in which one of this host's processors, or several, let a thread wait that wanted to run.
/// CLOCK_MONOTONIC nanoseconds.
struct Stall {
    std::int64_t begin = 0, end = 0;
};

/// On each processor a thread sleeps for 5 ms, again and again, and notes when it was woken more than 50 ms
/// late: what a figure of the same moment may owe to the host. Above all of Axon's priorities: then nothing
/// that runs here can make it late, and what does is below this machine. Where that is not permitted one
/// ordinary thread does it, on any processor, which sees less of the host and more of this machine's own
/// load. Threads: its own; members from any.
class HostProbe {
  public:
    static constexpr std::int64_t kStallNs = 50'000'000;
    HostProbe();
    ~HostProbe();
    HostProbe(const HostProbe&) = delete;
    HostProbe& operator=(const HostProbe&) = delete;

    /// In the order of their begin; those of several processors at the same time are one. One that has not
    /// ended yet ends now.
    std::vector<Stall> stalls() const;
    /// How much of the time from `begin` to `end` at least one processor stood still, in nanoseconds.
    std::int64_t overlap(std::int64_t begin, std::int64_t end) const;

  private:
    static constexpr std::int64_t kSleepNs = 5'000'000;
    static constexpr int kAny = -1;
    struct Watcher {
        std::atomic<std::int64_t> due{0};  // when it is to wake up
        std::thread thread;
    };
    void watch(int processor);  ///< kAny: not bound to one
    void run(Watcher& watcher);
    std::atomic<bool> ending_{false};
    mutable std::mutex mutex_;
    std::vector<Stall> stalls_;  // of each processor, ended; guarded by mutex_
    std::deque<Watcher> watchers_;
};

/// Threads at ordinary priority, one for each core, that do nothing but compute: a host with no time to
/// spare.
class Burners {
  public:
    explicit Burners(unsigned count);
    ~Burners();
    Burners(const Burners&) = delete;
    Burners& operator=(const Burners&) = delete;

  private:
    std::atomic<bool> ending_{false};
    std::vector<std::thread> threads_;
};

}  // namespace axon::faults
