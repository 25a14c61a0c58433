// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "common/clock.hpp"

namespace axon {

/// The file in which a virtual laboratory (axon-lab --clock) publishes its time. All programs map it; numbers
/// are in the machine's byte order. The laboratory writes it after each of its steps (4 ms of its time), and
/// many times a second while its time stands still.
///
/// The time never goes back and is not zero at the start, as a ManualClock's. A laboratory that does not
/// write for kGoneAfter counts as gone. Its time then goes on at the pace of the machine, by the same rule
/// for every reader, because a watchdog that stands still for ever would stop nothing. A laboratory that
/// comes back goes on from there.
struct SharedClockPage {
    static constexpr std::string_view kMagic = "AXONCLK2";
    static constexpr Duration kGoneAfter = std::chrono::seconds{5};
    static constexpr Duration kStep = std::chrono::milliseconds{4};

    char magic[8];                      ///< written last: a reader that sees it sees the rest
    std::atomic<std::int64_t> time_ns;  ///< the laboratory's time; written after told_ns, read before it
    std::atomic<std::int64_t> told_ns;  ///< CLOCK_MONOTONIC when the laboratory last wrote
    std::atomic<double> rate;  ///< seconds of its time in a second, as it was asked for; 0 while it stands

    /// How far time has gone on without the laboratory.
    Duration alone(TimePoint real) const {
        return std::max(
            real.time_since_epoch() - Duration{told_ns.load(std::memory_order_acquire)} - kGoneAfter,
            Duration::zero());
    }
};
static_assert(std::atomic<std::int64_t>::is_always_lock_free && std::atomic<double>::is_always_lock_free);

/// The time of a virtual laboratory as the injected clock (ADR 0020): the same programs run as many times
/// faster as the laboratory does, and stand still, watchdogs included, while it stands. Maps the laboratory's
/// file; no system call after that. now() moves in steps of the laboratory's.
///
/// Threads: any. Failure: the constructor throws std::runtime_error for a file that is missing or
/// not such a page, and for the file of a laboratory that is gone; its text says how to fix that. The loss of
/// the laboratory later is reported once on standard error; see SharedClockPage.
class SharedClock final : public Clock {
  public:
    explicit SharedClock(const std::string& path);
    ~SharedClock() override;
    SharedClock(const SharedClock&) = delete;
    SharedClock& operator=(const SharedClock&) = delete;

    TimePoint now() const override;
    /// At most kLongestWait, so that a change of pace is noticed; at least half a millisecond, in which from
    /// a speed of 8 on more than one of the laboratory's steps passes.
    Duration realTimeUntil(TimePoint deadline) const override;

    static constexpr Duration kLongestWait = std::chrono::milliseconds{5};

  private:
    const std::string path_;
    const SharedClockPage* page_ = nullptr;
    mutable std::atomic<bool> gone_{false};
    mutable std::atomic<std::int64_t> latest_ns_{0};  ///< that was told while the laboratory was gone
};

/// What a program takes its time from: SteadyClock, or the laboratory's time where the environment variable
/// AXON_CLOCK names its file, which is said on standard error. Throws as SharedClock does.
std::shared_ptr<const Clock> clockFromEnvironment();

}  // namespace axon
