// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "client/base/server_link.hpp"
#include "common/clock.hpp"
#include "common/routed.hpp"

namespace axon::client {

/// The data lane of one session with a server, as MessageSender sees it. Implementations: ServerConnection, a
/// fake in tests. Nothing waits but awaitRoom(); what is sent after the session has ended is dropped.
class DataLane {
  public:
    virtual ~DataLane() = default;
    virtual void send(Operation kind, const Header& head, std::string bytes) const = 0;
    /// Like send(), for a small message of a burst: it is on its way after write(), together with those added
    /// before, in one system call here and one turn of a thread at the server. add() and write() are called
    /// by one thread at a time, which calls write() before it calls send().
    virtual void add(Operation kind, const Header& head, std::string bytes) const = 0;
    virtual void write() const = 0;
    /// Messages that wait for the server to read, and their bytes.
    virtual std::size_t waiting() const = 0;
    virtual std::size_t waitingBytes() const = 0;
    /// Until little waits, or `wait` is over.
    virtual void awaitRoom(Duration wait) const = 0;
};

/// What a stop needs of one session with a server, as StopSender sees it. Implementations: ServerConnection,
/// a fake in tests. Any thread; nothing waits.
class StopLanes {
  public:
    virtual ~StopLanes() = default;
    virtual void sendStopSignal(Lane lane, const Header& head, StopCause cause) const = 0;
    /// One message, which the servers fan out; `head.entity` is empty.
    virtual void sendStopSignals(Lane lane, const Header& head, const std::vector<std::string>& entities,
                                 StopCause cause) const = 0;
};

}  // namespace axon::client
