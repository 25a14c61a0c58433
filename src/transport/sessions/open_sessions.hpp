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
#include "transport/ice/connection_limits.hpp"
#include "transport/ice/known_connections.hpp"
#include "transport/ice/peer_connection.hpp"

namespace axon::transport {

/// The sessions that have been opened: one for each connection (PeerConnection), and each must be
/// taken into use (`ready()`) within ten seconds or is disconnected. Threads: any.
template <class Servant>
class OpenSessions {
  public:
    static constexpr std::chrono::seconds kSetUpTime{10};

    explicit OpenSessions(const Clock& clock) : clock_(clock) {}

    Result<void> add(const PeerConnection& connection, const std::shared_ptr<Servant>& servant) {
        const auto ends = connection.ends();
        const std::lock_guard lock(mutex_);
        if (!connections_.try_emplace(connection.key(), ends).second) {
            return Refusal{RefusalCode::Duplicate,
                           "this connection has a session already; open another connection for another one",
                           {}};
        }
        if (!ends.empty()) servants_[ends] = {connection.key(), servant};
        opening_.push_back({clock_.now() + kSetUpTime, servant});
        return {};
    }

    void remove(const void* connection) {
        const std::lock_guard lock(mutex_);
        const auto found = connections_.find(connection);
        if (found == connections_.end()) return;
        // The next connection may have the same ends before the end of this one is told.
        const auto its = servants_.find(found->second);
        if (its != servants_.end() && its->second.connection == connection) servants_.erase(its);
        connections_.erase(found);
    }

    /// Over this connection (PeerConnection::ends()) somebody has asked to log in; answered() comes once it
    /// has been.
    void asks(const std::string& ends) { asking_.add(ends); }
    void answered(const std::string& ends) { asking_.remove(ends); }

    /// For ConnectionLimits. A session that was opened and not taken into use makes nobody known.
    ConnectionLimits::Peer stateOf(const std::string& ends) {
        if (asking_.has(ends)) return ConnectionLimits::Peer::Exempt;
        const auto servant = servantOf(ends);
        return servant && servant->ready() ? ConnectionLimits::Peer::HasSession
                                           : ConnectionLimits::Peer::Stranger;
    }
    void endSilent(const std::string& ends) {
        if (const auto servant = servantOf(ends)) servant->disconnect("nothing was heard of it for a minute");
    }

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
    struct Served {
        const void* connection;
        std::weak_ptr<Servant> servant;
    };
    const Clock& clock_;
    std::shared_ptr<Servant> servantOf(const std::string& ends) {
        const std::lock_guard lock(mutex_);
        const auto found = servants_.find(ends);
        return found == servants_.end() ? nullptr : found->second.servant.lock();
    }

    std::mutex mutex_;
    // Guarded by mutex_: of each connection (PeerConnection::key()) its ends.
    std::unordered_map<const void*, std::string> connections_;
    std::unordered_map<std::string, Served> servants_;  // guarded by mutex_; by ends
    KnownConnections asking_;
    std::deque<Opening> opening_;  // guarded by mutex_, earliest first
};

}  // namespace axon::transport
