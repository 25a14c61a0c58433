// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>

#include "client/base/server_link.hpp"
#include "client/core/core_context.hpp"
#include "common/clock.hpp"
#include "common/liveness.hpp"

namespace axon::client {

/// Signs of life between a session and its server, both ways: when this client beats, and whether the server
/// is silent. Part of SessionCore. A busy client sends heartbeats fast and is watched with a short timeout.
class ServerWatch {
  public:
    explicit ServerWatch(const CoreParts& parts);

    /// `watchdogs`: of the server, for this client; a sign of life goes to it in a fifth of each.
    void onConnected(const Watchdogs& watchdogs);
    void onDisconnected();
    /// The server lives: it has sent something.
    void heard() { server_.heard(parts_.context.clock.now()); }
    /// Call after each change of what may be busy: a task, a run, the state of an entity that is held.
    void pace();
    /// Beats if it is due.
    void onTimer();
    TimePoint nextBeat() const { return next_beat_; }
    /// A task or a run of this client is not final, or an entity that it holds is busy: heartbeats are fast.
    bool busy() const;
    bool silent() const { return parts_.context.connected && server_.expired(parts_.context.clock.now()); }
    TimePoint deadline() const { return parts_.context.connected ? server_.deadline() : TimePoint::max(); }
    const Watchdogs& watchdogs() const { return watchdogs_; }

  private:
    Duration beatPeriod(bool fast) const;

    const CoreParts& parts_;
    Liveness server_;
    Watchdogs watchdogs_;  // of the server, for this client
    std::int64_t beat_ = 0;
    TimePoint next_beat_ = TimePoint::max();
};

}  // namespace axon::client
