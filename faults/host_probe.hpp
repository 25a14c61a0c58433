// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <chrono>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

namespace axon::faults {

/// A time in which this host let an ordinary thread wait that wanted to run. CLOCK_MONOTONIC nanoseconds.
struct Stall {
    std::int64_t begin = 0, end = 0;
};

/// Sleeps for a millisecond, again and again, under the ordinary scheduler, and notes when it was woken more
/// than 50 ms late: what a figure of the same moment may owe to the host. Threads: one of its own; members
/// from any.
class HostProbe {
  public:
    static constexpr std::int64_t kStallNs = 50'000'000;
    HostProbe();
    ~HostProbe();
    HostProbe(const HostProbe&) = delete;
    HostProbe& operator=(const HostProbe&) = delete;

    std::vector<Stall> stalls() const;
    /// How much of the time from `begin` to `end` the host stood still, in nanoseconds.
    std::int64_t overlap(std::int64_t begin, std::int64_t end) const;
    std::int64_t longestNs() const { return longest_; }

  private:
    void run();
    std::atomic<bool> ending_{false};
    std::atomic<std::int64_t> longest_{0};
    mutable std::mutex mutex_;
    std::vector<Stall> stalls_;  // guarded by mutex_
    std::thread thread_;
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
