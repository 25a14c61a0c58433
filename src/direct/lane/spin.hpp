// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>

#include "common/clock.hpp"

namespace axon::direct::lane {

/// The longest spin that can be set: more than it takes until a peer that slept on another core has answered,
/// which is how two ends that spin come to find each other awake (ADR 0031).
inline constexpr std::chrono::microseconds kSpinMost{250};

/// How long a thread that waits for messages may spin, which is to look for the next one without sleeping.
///
/// Waking a thread on a sleeping core takes 30 µs and more, and a thread that spins has its message at once.
/// But it occupies a core, and if its peer needs the same one, the message comes only once the spin has
/// ended. A thread cannot tell which is the case, so it tries, within two bounds:
/// 1. It spins only if the wait before took at most kNear spins. So messages that come seldom cost nothing.
/// 2. Spins in vain are paid from an allowance. It begins with kTrials spins, which is also the most that it
///    holds. It grows by kShare of the time that passes, and by the time of each spin that brought something.
///    So in the long run the spins in vain take at most kShare of a core, and as long as those that helped.
/// Pure: the caller says what time it is. Threads: one, which is the one that waits.
class SpinBudget {
  public:
    static constexpr int kNear = 4;
    static constexpr int kTrials = 4;
    static constexpr int kShare = 200;  ///< one part in so many: 0.5 %

    /// `longest` 0: never.
    explicit SpinBudget(Duration longest) : longest_(longest), allowance_(kTrials * longest) {}

    /// A wait begins. How long the thread may spin before it sleeps: all of the longest time, or not at all.
    Duration begin(TimePoint now) {
        if (began_ != TimePoint{}) earn((now - began_) / kShare);
        began_ = now;
        const bool spins = longest_ > Duration{} && last_wait_ <= kNear * longest_ && allowance_ >= longest_;
        return spins ? longest_ : Duration{};
    }
    /// The spin has brought something, and the wait is over.
    void found(TimePoint now) {
        came(now);
        earn(last_wait_);
    }
    /// The spin has brought nothing, and the thread sleeps.
    void inVain() { allowance_ -= longest_; }
    /// Something came after sleep, and the wait is over.
    void came(TimePoint now) { last_wait_ = now - began_; }

  private:
    void earn(Duration time) { allowance_ = std::min(allowance_ + time, kTrials * longest_); }

    const Duration longest_;
    Duration allowance_;
    Duration last_wait_ = Duration::max();  // none yet
    TimePoint began_{};                     // the wait; none yet
};

/// Spins for one thread, as its SpinBudget permits, while no other thread of the process does. Never on a
/// machine with one core, because then its peer has to wait for that core.
///
///     for (;;) {
///         if (spinner.spin([&] { return look(); })) continue;  // look() has found and handled something
///         sleepUntilSomethingComes();
///         spinner.came();
///     }
///
/// Time is that of CLOCK_MONOTONIC, also where the rest of Axon counts that of a virtual laboratory; tests
/// have another clock. Threads: the one that made it.
class Spinner {
  public:
    explicit Spinner(Duration longest, const Clock& clock = steady(), long cores = coresOfMachine())
        : clock_(clock),
          longest_(cores < 2 ? Duration{} : std::clamp<Duration>(longest, Duration{}, kSpinMost)),
          budget_(longest_) {}

    /// It may spin at times. If not, the other functions need not be called.
    bool spins() const { return longest_ > Duration{}; }
    /// A wait begins. Calls `begin` and then `look` again and again, until `look` returns true or the time is
    /// over; then `end`. Returns whether `look` did, which ends the wait. Calls nothing if it may not spin.
    template <class Begin, class Look, class End>
    bool spin(Begin begin, Look look, End end) {
        auto now = clock_.now();
        const auto longest = budget_.begin(now);
        if (longest == Duration{} || occupied().test_and_set(std::memory_order_acquire)) return false;
        begin();
        bool found = false;
        // When it came is the time before the look, which may also have handled it.
        for (const auto until = now + longest; now < until && !(found = look());) now = clock_.now();
        end();
        occupied().clear(std::memory_order_release);
        if (found)
            budget_.found(now);
        else
            budget_.inVain();
        return found;
    }
    template <class Look>
    bool spin(Look look) {
        return spin([] {}, look, [] {});
    }
    /// The wait is over, after sleep.
    void came() { budget_.came(clock_.now()); }

    static long coresOfMachine() { return ::sysconf(_SC_NPROCESSORS_ONLN); }

  private:
    static std::atomic_flag& occupied() {
        static std::atomic_flag flag;
        return flag;
    }

    static const Clock& steady() {
        static const SteadyClock clock{};
        return clock;
    }

    const Clock& clock_;
    const Duration longest_;
    SpinBudget budget_;
};

}  // namespace axon::direct::lane
