// SPDX-License-Identifier: MIT
#pragma once
#include <memory>
#include <mutex>
#include <utility>

namespace axon {

/// An immutable table that readers take a reference to and writers replace whole. The lock is held for the
/// copy of one pointer. The signal lane has Snapshots of its own, so no data traffic ever holds what a stop
/// must take (invariant 3; a std::atomic<std::shared_ptr> would do, but ThreadSanitizer cannot see into GCC
/// 12's).
template <class T>
class Snapshot {
  public:
    explicit Snapshot(std::shared_ptr<const T> first = std::make_shared<const T>())
        : current_(std::move(first)) {}

    std::shared_ptr<const T> load() const {
        const std::lock_guard lock(mutex_);
        return current_;
    }
    void store(std::shared_ptr<const T> next) {
        {
            const std::lock_guard lock(mutex_);
            current_.swap(next);
        }
        // The old table, if this was the last reference, is destroyed here, outside the lock.
    }

  private:
    mutable std::mutex mutex_;
    std::shared_ptr<const T> current_;  // guarded by mutex_
};

}  // namespace axon
