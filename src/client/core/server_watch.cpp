// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/server_watch.hpp"

#include <algorithm>

#include "client/core/entities.hpp"
#include "client/core/runs.hpp"
#include "client/core/tasks.hpp"

namespace axon::client {
namespace {

/// Signs of life in each of the server's watchdogs (safety.md, "Watchdogs"), and no more of them than this,
/// whatever it says.
constexpr int kBeatsInWatchdog = 5;
constexpr Duration kShortestBeat = std::chrono::milliseconds{10};

}  // namespace

ServerWatch::ServerWatch(const CoreParts& parts)
    : parts_(parts),
      server_(parts.context.settings.server_silence_busy, parts.context.settings.server_silence_idle,
              parts.context.clock.now()) {}

void ServerWatch::onConnected(const Watchdogs& watchdogs) {
    watchdogs_ = watchdogs;
    heard();
    next_beat_ = parts_.context.clock.now();
}

void ServerWatch::onDisconnected() {
    next_beat_ = TimePoint::max();
    server_.setBusy(false, parts_.context.clock.now());
}

bool ServerWatch::busy() const {
    return parts_.tasks.anyOpen() || parts_.runs.anyOpen() || parts_.entities.anyMoving();
}

void ServerWatch::pace() {
    if (!parts_.context.connected) return;
    const auto now = parts_.context.clock.now();
    // The server beats fast only while it sees an entity of ours BUSY; our own tasks begin a little earlier.
    server_.setBusy(parts_.entities.anyBusyForServer(), now);
    if (busy()) next_beat_ = std::min(next_beat_, now + beatPeriod(true));
}

Duration ServerWatch::beatPeriod(bool fast) const {
    return std::max((fast ? watchdogs_.busy : watchdogs_.idle) / kBeatsInWatchdog, kShortestBeat);
}

void ServerWatch::onTimer() {
    const auto now = parts_.context.clock.now();
    if (!parts_.context.connected || now < next_beat_) return;
    const bool fast = busy();
    next_beat_ = now + beatPeriod(fast);
    parts_.context.link.keepAlive(++beat_, fast);
}

}  // namespace axon::client
