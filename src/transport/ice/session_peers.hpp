// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <mutex>
#include <string>
#include <unordered_set>

namespace axon::transport {

/// Peers ("127.0.0.1:50122") of which ConnectionLimits is to know something, such as that they have a
/// session. One that was added twice is there until it has been removed twice. Threads: any.
class SessionPeers {
  public:
    void add(const std::string& peer) {
        const std::lock_guard lock(mutex_);
        peers_.insert(peer);
    }
    void remove(const std::string& peer) {
        const std::lock_guard lock(mutex_);
        if (const auto found = peers_.find(peer); found != peers_.end()) peers_.erase(found);
    }
    bool has(const std::string& peer) const {
        const std::lock_guard lock(mutex_);
        return peers_.contains(peer);
    }

  private:
    mutable std::mutex mutex_;
    std::unordered_multiset<std::string> peers_;  // guarded by mutex_
};

}  // namespace axon::transport
