// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/clock.hpp"
#include "common/routed.hpp"

namespace axon::client {

/// How long a client may be silent before its server gives it up: while an entity that it holds is BUSY, and
/// otherwise. The server says so when the client joins (SessionFacts); the defaults are the server's.
struct Watchdogs {
    Duration busy = std::chrono::milliseconds{250};
    Duration idle = std::chrono::seconds{10};
};

// Routing keys of the signal lane.
inline constexpr const char* kMsgStop = "STOP";
inline constexpr const char* kMsgReset = "RESET";
inline constexpr const char* kMsgClear = "CLEAR";

/// Of a session with a server. Reset and Clear travel on the signal lane, all else on the data lane.
enum class Operation : std::uint8_t { ToEntity, ToEntityDataSeq, Request, Reset, Clear };

/// What the session logic sends to the server: the client's side of ClientSession (thesis, figure 3.13).
/// Implementations: the Ice rim (session.cpp), a fake in tests, a simulated network. Called from inside the
/// core: implementations must neither call back into it nor wait. Messages are dropped while there is no
/// connection.
class ServerLink {
  public:
    virtual ~ServerLink() = default;
    /// In order for each entity; `bytes` is an axon.proto.ToEntity.
    virtual void sendToEntity(const Header& head, std::string bytes) = 0;
    /// Bulk data: an axon.proto.ToEntity that the servers may drop, oldest first.
    virtual void sendToEntityDataSeq(const Header& head, std::string bytes) = 0;
    virtual void sendRequest(const Header& head, std::string bytes) = 0;
    virtual void sendReset(const Header& head) = 0;
    virtual void sendClear(const Header& head) = 0;
    /// On the signal lane. `busy` while a task runs: the time to ask whether the operator is alive.
    virtual void keepAlive(std::int64_t sequence, bool busy) = 0;
};

/// The way of a stop, apart from everything else (ADR 0003): Lane::Signal is the ordinary
/// one, Lane::Data the second chance of an escalation.
class StopLink {
  public:
    virtual ~StopLink() = default;
    virtual void sendStopSignal(Lane lane, const Header& head, StopCause cause) = 0;
    /// One message, which the servers fan out; `head.entity` is empty.
    virtual void sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                                 StopCause cause) = 0;
};

}  // namespace axon::client
