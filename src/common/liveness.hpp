// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>

#include "common/clock.hpp"

namespace axon {

/// Whether a peer is alive, and how close it came to being given up. One for each end of each hop (safety.md,
/// "Watchdogs"): whoever receives from the peer calls heard(), and the owner judges. I/O-free.
///
/// It has a deadline and it measures gaps. The deadline is the last sign of life plus one of two time-outs: a
/// short one while a task runs, and a long one otherwise. A gap is the time between two signs of life; the
/// longest of the last minute is kept with what was allowed at the time. A watchdog that trips without a
/// warning is switched off by its users; the gap is what they are warned with.
///
/// | call          | deadline      | gap                                     |
/// |---------------|---------------|-----------------------------------------|
/// | heard()       | starts again  | ends, and the next begins               |
/// | renew()       | starts again  | goes on                                 |
/// | setBusy()     | as said there | another begins if the allowance changes |
/// | setTimeouts() | starts again  | another begins if the allowance changes |
/// | suspendGaps() | goes on       | none until resumeGaps()                 |
/// | restart()     | starts again  | another begins, and none ends           |
///
/// States: alive, expired; a sign of life brings it back to alive.
///
/// Threads: any; there is no lock, so that a sign of life never waits. Changes other than heard() and
/// renew() are best made by one thread: from two at once, either may come last. When two threads hear at the
/// same moment, longest() may miss one gap; last() and deadline() never miss a sign of life.
class Liveness {
  public:
    /// What becoming busy after a pause that was shorter than the short time-out means.
    enum class ShortPause : std::uint8_t {
        NoSign,  ///< the pause is left out; otherwise a chain of short tasks would hide a lost peer
        Sign     ///< a sign of life: each task lasts long enough to notice that the peer is gone
    };
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

    /// The peer is alive at first, and no task runs.
    Liveness(Duration busy, Duration idle, TimePoint now, ShortPause short_pause = ShortPause::NoSign)
        : short_pause_(short_pause),
          busy_timeout_(busy.count()),
          idle_timeout_(idle.count()),
          heard_(count(now)),
          renewed_(count(now)),
          since_(count(now)),
          idle_since_(count(now)) {}
    /// Of a peer that is not watched yet: call setTimeouts() first. No gap is measured until then.
    Liveness() : Liveness({}, {}, {}) {}

    /// A sign of life. One that is older than the last changes nothing.
    void heard(TimePoint now) {
        const auto at = count(now);
        auto last = heard_.load(std::memory_order_relaxed);
        do {
            if (at <= last) return;
        } while (!heard_.compare_exchange_weak(last, at, std::memory_order_relaxed));
        const auto allowed = timeoutWhile(busy_.load(std::memory_order_acquire));  // before since_
        const auto from = std::max(last, since_.load(std::memory_order_relaxed));
        if (allowed != 0 && at > from) note(at, at - from, allowed);
    }
    /// For the deadline a sign of life, for the gaps none: something else than a heartbeat came, or the peer
    /// could not be heard for reasons of this side.
    void renew(TimePoint now) { raise(renewed_, count(now)); }

    /// Whether a task runs. While none does, the peer is not expected to beat fast, and that time does not
    /// count as silence. Becoming busy counts as a sign of life after a pause of at least the short time-out;
    /// ShortPause says what happens after a shorter one. A new allowance begins another gap, because the peer
    /// could not know.
    void setBusy(bool busy, TimePoint now) {
        if (busy == this->busy()) return;
        const auto at = count(now);
        const auto short_timeout = timeoutWhile(true);
        if (busy) {
            const auto idle_since = idle_since_.load(std::memory_order_relaxed);
            const bool counts = short_pause_ == ShortPause::Sign || at - idle_since >= short_timeout;
            const auto silence = counts ? 0 : idle_since - count(silentSince());
            raise(renewed_, at - std::max<Duration::rep>(silence, 0));  // negative: it was heard in the pause
        } else {
            idle_since_.store(at, std::memory_order_relaxed);
        }
        if (short_timeout != timeoutWhile(false)) beginGap(at);
        busy_.store(busy, std::memory_order_release);  // whoever sees it sees the above, too
    }
    /// Other time-outs from now on.
    void setTimeouts(Duration busy, Duration idle, TimePoint now) {
        renew(now);
        const bool is_busy = this->busy();
        if ((is_busy ? busy : idle).count() != timeoutWhile(is_busy)) beginGap(count(now));
        busy_timeout_.store(busy.count(), std::memory_order_release);
        idle_timeout_.store(idle.count(), std::memory_order_release);
    }
    /// Nobody listens, or there is no connection: no gap is measured until resumeGaps().
    void suspendGaps() { since_.store(kSuspended, std::memory_order_relaxed); }
    /// The first gap begins now. No effect unless they are suspended.
    void resumeGaps(TimePoint now) {
        if (since_.load(std::memory_order_relaxed) == kSuspended)
            since_.store(count(now), std::memory_order_relaxed);
    }
    /// The first sign of life of another connection: no gap reaches from one into the next.
    void restart(TimePoint now) {
        since_.store(count(now), std::memory_order_relaxed);
        heard(now);
    }

    bool busy() const { return busy_.load(std::memory_order_relaxed); }
    Duration timeout() const { return Duration{timeoutWhile(busy_.load(std::memory_order_acquire))}; }
    /// The last sign of life; before the first one, the beginning.
    TimePoint last() const { return at(heard_.load(std::memory_order_relaxed)); }
    /// What the deadline counts from: the last sign of life, or what counts as one.
    TimePoint silentSince() const {
        return at(std::max(heard_.load(std::memory_order_relaxed), renewed_.load(std::memory_order_relaxed)));
    }
    TimePoint deadline() const {
        const auto allowed = timeout();  // first
        return silentSince() + allowed;
    }
    bool expired(TimePoint now) const { return now >= deadline(); }

    /// What is left of the time-out, as a part of the whole: 1 just heard, 0 expired.
    double margin(TimePoint now) const {
        const auto allowed = timeout();
        const auto left = std::chrono::duration<double>(silentSince() + allowed - now).count();
        return left <= 0 ? 0 : left / std::chrono::duration<double>(allowed).count();
    }
    /// From when on the present silence is worth a warning, which is before the deadline.
    TimePoint lateFrom() const {
        const auto allowed = timeout();
        return silentSince() + allowed - std::chrono::duration_cast<Duration>(allowed * (1 - kWarnFrom));
    }

    /// Of the last 60 to 70 seconds, the gap that was the largest part of what was allowed; the silence that
    /// lasts counts.
    Gap longest(TimePoint now) const {
        Gap worst;
        const auto slot = slotOf(count(now));
        for (const auto& bucket : buckets_) {
            const auto its = bucket.slot.load(std::memory_order_acquire);
            if (its + static_cast<std::int64_t>(buckets_.size()) <= slot) continue;
            const auto gap = unpack(bucket.worst.load(std::memory_order_acquire));
            if (gap.part() > worst.part()) worst = gap;
        }
        const auto allowed = timeout();  // before since_
        const auto from =
            std::max(heard_.load(std::memory_order_relaxed), since_.load(std::memory_order_relaxed));
        if (const Gap open{Duration{count(now) - from}, allowed}; open.part() > worst.part()) worst = open;
        return worst;
    }

  private:
    // Length in microseconds and allowance in milliseconds, in one word: nobody reads the one without the
    // other.
    struct Bucket {
        std::atomic<std::int64_t> slot{-1000};
        std::atomic<std::uint64_t> worst{0};
    };
    static constexpr auto kSuspended = std::numeric_limits<Duration::rep>::max();
    static constexpr unsigned kLengthAt = 32;
    static constexpr std::uint64_t kMost = std::numeric_limits<std::uint32_t>::max();

    static Duration::rep count(TimePoint at) { return at.time_since_epoch().count(); }
    static TimePoint at(Duration::rep count) { return TimePoint{Duration{count}}; }
    static std::int64_t slotOf(Duration::rep at) { return at / Duration{std::chrono::seconds{10}}.count(); }
    static std::uint64_t pack(Duration::rep length, Duration::rep allowed) {
        const auto us = static_cast<std::uint64_t>(length / Duration{std::chrono::microseconds{1}}.count());
        const auto ms = static_cast<std::uint64_t>(allowed / Duration{std::chrono::milliseconds{1}}.count());
        return std::min(us, kMost) << kLengthAt | std::min(ms, kMost);
    }
    static Gap unpack(std::uint64_t word) {
        return {std::chrono::microseconds{word >> kLengthAt}, std::chrono::milliseconds{word & kMost}};
    }
    /// Which is the larger part of what was allowed, without a division: this is done at each sign of life.
    static bool worse(std::uint64_t one, std::uint64_t other) {
        if (other == 0) return true;
        return (one >> kLengthAt) * (other & kMost) > (other >> kLengthAt) * (one & kMost);
    }
    static void raise(std::atomic<Duration::rep>& value, Duration::rep to) {
        auto present = value.load(std::memory_order_relaxed);
        while (present < to && !value.compare_exchange_weak(present, to, std::memory_order_relaxed)) {
        }
    }

    Duration::rep timeoutWhile(bool busy) const {
        return (busy ? busy_timeout_ : idle_timeout_).load(std::memory_order_acquire);
    }
    void beginGap(Duration::rep at) {
        auto since = since_.load(std::memory_order_relaxed);
        while (since != kSuspended && !since_.compare_exchange_weak(since, at, std::memory_order_relaxed)) {
        }
    }
    void note(Duration::rep at, Duration::rep length, Duration::rep allowed) {
        const auto slot = slotOf(at);
        auto& bucket = buckets_[static_cast<std::size_t>(slot) % buckets_.size()];
        if (bucket.slot.load(std::memory_order_relaxed) != slot) {
            bucket.worst.store(0, std::memory_order_release);
            bucket.slot.store(slot, std::memory_order_release);
        }
        const auto gap = pack(length, allowed);
        if (worse(gap, bucket.worst.load(std::memory_order_relaxed)))
            bucket.worst.store(gap, std::memory_order_release);
    }

    const ShortPause short_pause_;
    std::atomic<Duration::rep> busy_timeout_;
    std::atomic<Duration::rep> idle_timeout_;
    std::atomic<bool> busy_{false};
    std::atomic<Duration::rep> heard_;       ///< the last sign of life; never goes back
    std::atomic<Duration::rep> renewed_;     ///< what else the deadline counts from; never goes back
    std::atomic<Duration::rep> since_;       ///< no gap begins before this; kSuspended: none is measured
    std::atomic<Duration::rep> idle_since_;  ///< while not busy
    std::array<Bucket, 7> buckets_;
};

/// "180 ms of 250 ms allowed was its longest silence in the last minute".
inline std::string describe(const Liveness::Gap& gap) {
    const auto milliseconds = [](Duration duration) {
        return std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(duration).count()) +
               " ms";
    };
    return milliseconds(gap.length) + " of " + milliseconds(gap.allowed) +
           " allowed was its longest silence in the last minute";
}

}  // namespace axon
