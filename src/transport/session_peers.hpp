// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <mutex>
#include <string>
#include <unordered_set>

namespace axon::transport {

/// The peers ("127.0.0.1:50122") that have a session over their connection, which ConnectionLimits asks for.
/// Threads: any.
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
    std::unordered_multiset<std::string> peers_;  // guarded by mutex_: behind a router many have its address
};

}  // namespace axon::transport
