// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <utility>

#include "common/waiting.hpp"

namespace axon {

/// The level that a stop raises, seen by every running task.
///
/// `stopped` is the newest generation of the Entity Manager's stops that was heard of. Stops that this
/// library dispatches itself (fault, shutdown) raise the *epoch*. A task remembers generation and epoch of
/// its dispatch and is stopped once `stopped` or the epoch is higher. `settled` is false from the moment a
/// level rises until the application's stop callback has returned: no task starts in between. A callback that
/// was `inside` when the level rose may move the robot after the stop callback; then that one is called again
/// once it has returned, and the level settles only then.
///
/// Threads: the stop thread writes; any thread reads. The mutex is held for the change of a few words and
/// while a waiting task checks its condition, never during I/O or in user code.
class StopLevel {
  public:
    explicit StopLevel(const Clock& clock) : clock_(clock) {}

    const Clock& clock() const { return clock_; }
    std::uint32_t stopped() const { return stopped_.load(std::memory_order_acquire); }
    std::uint64_t epoch() const { return epoch_.load(std::memory_order_acquire); }
    int cause() const { return cause_.load(std::memory_order_acquire); }
    bool settled() const { return settled_.load(std::memory_order_acquire); }

    /// A new link begins at its Entity Manager's generation, whatever the former one's was.
    void adopt(std::uint32_t generation) {
        change([&] { stopped_ = generation; });
    }
    void raise(std::uint32_t generation, int cause) {
        change([&] {
            cause_ = cause;
            settled_ = false;
            acknowledged_ = false;
            stopped_ = generation;
        });
    }
    void raiseEpoch(int cause) {
        change([&] {
            cause_ = cause;
            settled_ = false;
            acknowledged_ = false;
            epoch_ = epoch_ + 1;
        });
    }
    /// The stop callback is about to be called, once more perhaps: what was said of a standstill before it
    /// counts no more. Until acknowledged(), a standstill waits.
    void carryOut() {
        const std::lock_guard lock(mutex_);
        acknowledged_ = rested_ = false;
    }
    /// The stop has been carried out: tasks may begin.
    void settle() {
        change([&] { settled_ = true; });
    }
    /// That it has been carried out was told, or there is nobody to tell. Whether the machine was said to
    /// stand still since the stop callback was called last.
    bool acknowledged() {
        const std::lock_guard lock(mutex_);
        acknowledged_ = true;
        return std::exchange(rested_, false);
    }
    /// The machine stands still. The generation of the stop for which that can be told; none while one is
    /// being carried out, for then acknowledged() says it.
    std::optional<std::uint32_t> rest() {
        const std::lock_guard lock(mutex_);
        rested_ = !acknowledged_;
        return acknowledged_ ? std::optional(stopped()) : std::nullopt;
    }
    /// A callback that may move the robot begins, unless the condition no longer holds. Either the condition
    /// sees a level that rises at the same moment, or whoever raised it sees the callback inside.
    template <class Condition>
    bool enter(Condition condition) {
        const std::lock_guard lock(mutex_);
        if (!condition()) return false;
        ++inside_;
        return true;
    }
    void leave() {
        change([&] { --inside_; });
    }
    bool inside() const { return inside_.load(std::memory_order_acquire) > 0; }
    /// Something that a waiting task looks at has changed.
    void notify() {
        change([] {});
    }

    /// Until the condition holds or the clock says `end`; returns the condition.
    template <class Condition>
    bool waitUntil(TimePoint end, Condition condition) {
        return waitUntil(clock_, end, condition);
    }
    /// The same by another clock.
    template <class Condition>
    bool waitUntil(const Clock& clock, TimePoint end, Condition condition) {
        std::unique_lock lock(mutex_);
        return axon::waitUntil(changed_, lock, clock, end, condition);
    }
    template <class Condition>
    void wait(Condition condition) {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, condition);
    }

  private:
    template <class Change>
    void change(Change apply) {
        {
            const std::lock_guard lock(mutex_);
            apply();
        }
        changed_.notify_all();
    }

    const Clock& clock_;
    std::mutex mutex_;
    std::condition_variable changed_;
    std::atomic<std::uint32_t> stopped_{0};
    std::atomic<std::uint64_t> epoch_{0};
    std::atomic<int> cause_{0};
    std::atomic<bool> settled_{true};
    bool acknowledged_ = true;  // guarded by mutex_
    bool rested_ = false;       // guarded by mutex_
    std::atomic<int> inside_{0};
};

}  // namespace axon
