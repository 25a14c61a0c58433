// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <limits>
#include <string>

#include "common/clock.hpp"

namespace axon {

/// When a peer was last heard, and how close it came to being given up: the longest gap between two of its
/// signs of life in the last minute, measured against what its watchdog allowed at the time. A watchdog that
/// trips without a warning is switched off by its users; this is what they are warned with.
///
/// Threads: heard() is called by one at a time; the rest from any. No lock: a sign of life never waits.
class LifeSigns {
  public:
    struct Gap {
        Duration length{};
        Duration allowed{};  ///< zero: nothing was measured
        double part() const {
            return allowed > Duration{}
                       ? static_cast<double>(length.count()) / static_cast<double>(allowed.count())
                       : 0;
        }
    };
    /// From this part of the allowed silence on, somebody should be told.
    static constexpr double kWarnFrom = 0.6;
    static constexpr std::chrono::seconds kWarnAgain{60};

    void heard(TimePoint now) {
        const auto last = std::max(last_.exchange(count(now), std::memory_order_relaxed),
                                   since_.load(std::memory_order_relaxed));
        const auto allowed = allowed_.load(std::memory_order_relaxed);
        if (last == 0 || allowed == 0 || count(now) <= last) return;
        const auto slot = slotOf(now);
        auto& bucket = buckets_[static_cast<std::size_t>(slot) % buckets_.size()];
        if (bucket.slot.load(std::memory_order_relaxed) != slot) {
            bucket.worst.store(0, std::memory_order_release);
            bucket.slot.store(slot, std::memory_order_release);
        }
        const Gap gap{Duration{count(now) - last}, Duration{allowed}};
        if (gap.part() > unpack(bucket.worst.load(std::memory_order_relaxed)).part())
            bucket.worst.store(pack(gap), std::memory_order_release);
    }
    /// What the watchdog allows from now on. Another allowance begins another gap: the peer could not know.
    void allow(Duration timeout, TimePoint now) {
        if (allowed_.exchange(timeout.count(), std::memory_order_relaxed) != timeout.count())
            since_.store(count(now), std::memory_order_relaxed);
    }

    TimePoint last() const { return TimePoint{Duration{last_.load(std::memory_order_relaxed)}}; }

    /// Of the last 60 to 70 seconds; the silence that lasts counts.
    Gap longest(TimePoint now) const {
        Gap worst;
        const auto slot = slotOf(now);
        for (const auto& bucket : buckets_) {
            const auto its = bucket.slot.load(std::memory_order_acquire);
            if (its + static_cast<std::int64_t>(buckets_.size()) <= slot) continue;
            const auto gap = unpack(bucket.worst.load(std::memory_order_acquire));
            if (gap.part() > worst.part()) worst = gap;
        }
        const auto last =
            std::max(last_.load(std::memory_order_relaxed), since_.load(std::memory_order_relaxed));
        const Gap open{Duration{count(now) - last}, Duration{allowed_.load(std::memory_order_relaxed)}};
        if (last != 0 && open.part() > worst.part()) worst = open;
        return worst;
    }

  private:
    // Length in microseconds and allowance in milliseconds, in one word: nobody reads the one without the
    // other.
    struct Bucket {
        std::atomic<std::int64_t> slot{-1000};
        std::atomic<std::uint64_t> worst{0};
    };
    static Duration::rep count(TimePoint at) { return at.time_since_epoch().count(); }
    static std::int64_t slotOf(TimePoint now) {
        return std::chrono::duration_cast<std::chrono::seconds>(now.time_since_epoch()).count() / 10;
    }
    static std::uint64_t pack(const Gap& gap) {
        constexpr std::int64_t kMost = std::numeric_limits<std::uint32_t>::max();
        const auto length =
            std::min(std::chrono::duration_cast<std::chrono::microseconds>(gap.length).count(), kMost);
        const auto allowed =
            std::min(std::chrono::duration_cast<std::chrono::milliseconds>(gap.allowed).count(), kMost);
        return static_cast<std::uint64_t>(length) << 32U | static_cast<std::uint64_t>(allowed);
    }
    static Gap unpack(std::uint64_t word) {
        return {std::chrono::microseconds{word >> 32U},
                std::chrono::milliseconds{word & std::numeric_limits<std::uint32_t>::max()}};
    }

    std::atomic<Duration::rep> last_{0};
    std::atomic<Duration::rep> since_{0};
    std::atomic<Duration::rep> allowed_{0};
    std::array<Bucket, 7> buckets_;
};

/// "180 ms of 250 ms allowed was its longest silence in the last minute".
inline std::string describe(const LifeSigns::Gap& gap) {
    const auto milliseconds = [](Duration duration) {
        return std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(duration).count()) +
               " ms";
    };
    return milliseconds(gap.length) + " of " + milliseconds(gap.allowed) +
           " allowed was its longest silence in the last minute";
}

}  // namespace axon
