// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/queue_share.hpp"
#include "common/refusal.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::front_end_server {

// What FrontEndCore needs from the world. The core calls these with none of its locks held; none may block,
// none throws, and none may call back into the core before it returns.

/// The way to one client on one lane (thesis: ClientMonitorCallbackAdapter).
class ClientOutbox {
  public:
    virtual ~ClientOutbox() = default;
    virtual void newBasicPrflMsg(Presence presence, const Registration& registration,
                                 std::string_view profile) = 0;
    virtual void newStatusMsg(const EntityStatus& status) = 0;
    /// False, and nothing is sent, when the message is beyond its share of the queue. `lane`: a receipt on
    /// the signal lane never waits behind other messages.
    virtual bool newEntityMsg(Lane lane, const Header& head, std::string_view message, QueueShare share) = 0;
    virtual void newEntityMsgDataSeq(const Header& head, std::string_view data) = 0;
    virtual void newRefusalMsg(const Header& head, const Refusal& refusal) = 0;
    virtual void newStopAccepted(const Header& head, std::int32_t entities) = 0;
    virtual void newUpdateMsg(RefusalCode code, const std::string& text) = 0;
    virtual void newHeartbeat(std::int64_t sequence) = 0;
    /// Ends the connection: orderly, after replies that are under way, or at once.
    virtual void disconnect(bool orderly, const std::string& why) = 0;
    /// What tells its connection from others; those behind one router share one.
    virtual const void* connection() const { return this; }
};

/// The topic towards the entity servers (thesis figure 3.15). `head.sender` is the client, vouched for by
/// this server.
class EntityTopic {
  public:
    virtual ~EntityTopic() = default;
    /// `server` has the entity; empty where there is but one. Refuses where it is known at once that nobody
    /// will hear it; the client is told.
    virtual Result<void> clientMsg(const std::string& server, const Header& head,
                                   std::string_view message) = 0;
    virtual void clientMsgDataSeq(const std::string& server, const Header& head, std::string_view data) = 0;
    /// STATUS of the entity server that `head.entity` names, empty = all. For one of several front-end
    /// servers; the only one has heard of everything.
    virtual void clientRequest(const Header& head) = 0;
    virtual void clientUpdate(const Header& head, ClientChange change) = 0;
    virtual void stopSignal(const Header& head, StopCause cause) = 0;
    /// To each of these, fanned out by the entity servers; `head.entity` is empty.
    virtual void stopSignals(const Header& head, const std::vector<std::string>& entities,
                             StopCause cause) = 0;
    virtual void resetSignal(const Header& head) = 0;
    virtual void clearSignal(const Header& head) = 0;

    // Of one of several servers; the only one needs none of them.
    /// Data: to all, by the topic. Signal: straight to each that is reached.
    /// `users`: the fingerprint of who may log in here; empty where it is not told.
    virtual void frontEndServerUpdate(Lane /*lane*/, const ServerAnnouncement& /*self*/,
                                      const std::string& /*users*/) {}
    /// The entity servers that signals are sent to directly besides the topic; replaces those named before.
    virtual void reach(const std::vector<ServerAnnouncement>& /*entity_servers*/) {}
};

/// The global services that this server offers (thesis A.4). The core does not look into payloads, so whoever
/// reads the profiles reads the requests too.
class GlobalServicesPort {
  public:
    virtual ~GlobalServicesPort() = default;
    /// An axon.proto.ToEntity in, an axon.proto.ToClient out; refuses what is no such request. Any thread, no
    /// I/O.
    virtual Result<std::string> answer(std::string_view request) = 0;
};

}  // namespace axon::front_end_server
