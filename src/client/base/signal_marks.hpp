// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <string>
#include <unordered_map>

namespace axon::client {

/// What the two halves of the session logic share, which run under different locks: the newest stop
/// generation this client has seen of each entity (ADR 0007; receipts raise it on the signal
/// lane, commands carry it on the data lane), and the counter that numbers what is sent on the signal lane.
/// Threads: any; the lock is held for one look-up, and sending a stop to everything does not take it.
class SignalMarks {
  public:
    /// While it is there its generation only rises; an older one that arrives late changes nothing.
    void raise(const std::string& entity, std::int32_t generation) {
        const std::lock_guard lock(mutex_);
        auto& newest = newest_[entity];
        newest = std::max(newest, generation);
    }
    /// What the entity itself says of the present, once it has answered this client: an Entity Manager that
    /// was restarted counts from its own beginning.
    void take(const std::string& entity, std::int32_t generation) {
        const std::lock_guard lock(mutex_);
        newest_[entity] = generation;
    }
    /// The entity has left. If it comes back, it reports its generation again.
    void forget(const std::string& entity) {
        const std::lock_guard lock(mutex_);
        newest_.erase(entity);
    }
    std::int32_t of(const std::string& entity) const {
        const std::lock_guard lock(mutex_);
        const auto found = newest_.find(entity);
        return found == newest_.end() ? 0 : found->second;
    }
    std::int64_t nextSequence() { return ++sequence_; }

  private:
    std::atomic<std::int64_t> sequence_{0};
    mutable std::mutex mutex_;
    std::unordered_map<std::string, std::int32_t> newest_;  // guarded by mutex_
};

}  // namespace axon::client
