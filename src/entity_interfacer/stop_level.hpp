// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>

namespace axon {

/// The level that a stop raises, seen by every running task.
///
/// A stop that comes through the Entity Manager raises the *generation*; one that this library dispatches
/// itself (fault, shutdown) raises the *epoch*. A task remembers both from its dispatch and is stopped once
/// either is higher. `settled` is false from the moment a level rises until the application's stop callback
/// has returned: no task starts in between.
///
/// Threads: the stop thread writes; any thread reads. The mutex is held for the change of a few words and
/// while a waiting task checks its condition, never during I/O or in user code.
class StopLevel {
  public:
    std::uint32_t generation() const { return generation_.load(std::memory_order_acquire); }
    std::uint64_t epoch() const { return epoch_.load(std::memory_order_acquire); }
    int cause() const { return cause_.load(std::memory_order_acquire); }
    bool settled() const { return settled_.load(std::memory_order_acquire); }

    /// A new link begins at its Entity Manager's generation, whatever the former one's was.
    void adopt(std::uint32_t generation) {
        change([&] { generation_ = generation; });
    }
    void raise(std::uint32_t generation, int cause) {
        change([&] { cause_ = cause, settled_ = false, generation_ = generation; });
    }
    void raiseEpoch(int cause) {
        change([&] { cause_ = cause, settled_ = false, epoch_ = epoch_ + 1; });
    }
    void settle() {
        change([&] { settled_ = true; });
    }
    /// Something that a waiting task looks at has changed.
    void notify() {
        change([] {});
    }

    /// Until the condition holds or the time is up; returns the condition.
    template <class Condition>
    bool waitUntil(std::chrono::steady_clock::time_point end, Condition condition) {
        std::unique_lock lock(mutex_);
        return changed_.wait_until(lock, end, condition);
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

    std::mutex mutex_;
    std::condition_variable changed_;
    std::atomic<std::uint32_t> generation_{0};
    std::atomic<std::uint64_t> epoch_{0};
    std::atomic<int> cause_{0};
    std::atomic<bool> settled_{true};
};

}  // namespace axon
