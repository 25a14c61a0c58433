// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>

#include "common/clock.hpp"
#include "common/result.hpp"
#include "transport/peer_connection.hpp"
#include "transport/session_peers.hpp"

namespace axon::transport {

/// The sessions that have been opened: one for each connection (PeerConnection), and each must be
/// taken into use (`ready()`) within ten seconds or is disconnected. Threads: any.
template <class Servant>
class OpenSessions {
  public:
    static constexpr std::chrono::seconds kSetUpTime{10};

    explicit OpenSessions(const Clock& clock) : clock_(clock) {}

    Result<void> add(const PeerConnection& connection, const std::shared_ptr<Servant>& servant) {
        auto peer = connection.peer();
        const std::lock_guard lock(mutex_);
        const auto [at, is_new] = connections_.try_emplace(connection.key());
        if (!is_new) {
            return Refusal{RefusalCode::Duplicate,
                           "this connection has a session already; open another connection for another one",
                           {}};
        }
        peers_.add(peer);
        at->second = std::move(peer);
        opening_.push_back({clock_.now() + kSetUpTime, servant});
        return {};
    }

    void remove(const void* connection) {
        const std::lock_guard lock(mutex_);
        const auto found = connections_.find(connection);
        if (found == connections_.end()) return;
        peers_.remove(found->second);
        connections_.erase(found);
    }

    /// Whether the peer at "127.0.0.1:50122" has a session.
    bool has(const std::string& peer) const { return peers_.has(peer); }

    /// Disconnects those that are late; returns when the next one will be, at most a second ahead.
    TimePoint expire() {
        const auto now = clock_.now();
        auto next = now + std::chrono::seconds{1};
        while (true) {
            std::shared_ptr<Servant> late;
            {
                const std::lock_guard lock(mutex_);
                if (opening_.empty() || opening_.front().deadline > now) {
                    if (!opening_.empty()) next = std::min<TimePoint>(next, opening_.front().deadline);
                    return next;
                }
                late = opening_.front().servant.lock();
                opening_.pop_front();
            }
            if (late && !late->ready()) late->disconnect("it opened a session and did not use it");
        }
    }

  private:
    struct Opening {
        TimePoint deadline;
        std::weak_ptr<Servant> servant;
    };
    const Clock& clock_;
    std::mutex mutex_;
    std::unordered_map<const void*, std::string> connections_;  // guarded by mutex_: its peer, by PeerConnection::key()
    SessionPeers peers_;                                        // those of connections_
    std::deque<Opening> opening_;                   // guarded by mutex_, earliest first
};

}  // namespace axon::transport
