// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <mutex>
#include <string>
#include <unordered_set>

namespace axon::transport {

/// Which connection it is, of all those of this process that are open: "127.0.0.1:50122>127.0.0.1:10412", the
/// peer's end first. The peer's end alone does not say it: the connections of one peer to several ports of
/// this process may all come from one port of its own.
inline std::string bothEnds(const std::string& peer, const std::string& local) {
    return peer + ">" + local;
}

/// Connections, by their ends (bothEnds()), of which ConnectionLimits is to know something, such as that they
/// have a session. One that was added twice is there until it has been removed twice. Threads: any.
class KnownConnections {
  public:
    void add(const std::string& ends) {
        const std::lock_guard lock(mutex_);
        ends_.insert(ends);
    }
    void remove(const std::string& ends) {
        const std::lock_guard lock(mutex_);
        if (const auto found = ends_.find(ends); found != ends_.end()) ends_.erase(found);
    }
    bool has(const std::string& ends) const {
        const std::lock_guard lock(mutex_);
        return ends_.contains(ends);
    }

  private:
    mutable std::mutex mutex_;
    std::unordered_multiset<std::string> ends_;  // guarded by mutex_
};

}  // namespace axon::transport
