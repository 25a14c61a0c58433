// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/queue_share.hpp"
#include "common/refusal.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::entity_server {

// What EntityServerCore needs from the world. The core calls these with none of its locks held; none may
// block, none throws, and none may call back into the core before it returns.

/// The way to one Entity Manager on one lane (thesis: EntityMonitorCallbackAdapter). Those that return false
/// send nothing then: the message is beyond its sender's share of the queue.
class EntityOutbox {
  public:
    virtual ~EntityOutbox() = default;
    virtual bool newClientMsg(const Header& head, std::string_view message, QueueShare share) = 0;
    virtual void newClientMsgDataSeq(const Header& head, std::string_view data) = 0;
    /// Never false for the causes that only servers give.
    virtual bool stopSignal(const Header& head, StopCause cause) = 0;
    virtual bool resetSignal(const Header& head) = 0;
    virtual bool clearSignal(const Header& head) = 0;
    virtual void newClientUpdate(const Header& head, ClientChange change) = 0;
    virtual void newRefusalMsg(const Header& head, const Refusal& refusal) = 0;
    virtual void newHeartbeat(std::int64_t sequence) = 0;
    /// Ends the connection: orderly, after replies that are under way, or at once.
    virtual void disconnect(bool orderly, const std::string& why) = 0;
};

/// The topic towards the front-end servers (thesis figure 3.14). `head.sender` is the recipient, its id empty
/// for all.
class FrontEndTopic {
  public:
    virtual ~FrontEndTopic() = default;
    /// Null profile where the entity left.
    virtual void entityBasicPrflUpdate(Presence presence, const Registration& registration,
                                       std::string_view profile) = 0;
    /// `number` grows with each; the only server has no need of it. To each that is reached straight, too.
    virtual void entityUpdate(const EntityStatus& status, std::int64_t number) = 0;
    /// What is for one client and does not reach its server is told by clientUnreached(), perhaps before this
    /// returns.
    virtual void entityMsg(Lane lane, const Header& head, std::string_view message) = 0;
    virtual void entityMsgDataSeq(const Header& head, std::string_view data) = 0;
    virtual void entityRefusal(Lane lane, const Header& head, const Refusal& refusal) = 0;

    // Of one of several servers; the only one needs none of them.
    /// Ends an answer to STATUS.
    virtual void entityServerEntities(const std::string& /*server*/,
                                      const std::vector<std::string>& /*entities*/) {}
    /// Data: to all, by the topic. Signal: straight to each that is reached.
    virtual void entityServerUpdate(Lane /*lane*/, const ServerAnnouncement& /*self*/) {}
    /// The front-end servers that signals are sent to directly besides the topic; replaces those named
    /// before.
    virtual void reach(const std::vector<ServerAnnouncement>& /*front_ends*/) {}

    // And towards the other entity servers.
    /// Data: which entities are here, to all by the topic of figure 3.15. Signal: that it lives, straight to
    /// each that is reached, without the entities.
    virtual void peersUpdate(Lane /*lane*/, const ServerAnnouncement& /*self*/,
                             const std::vector<std::string>& /*entities*/) {}
    /// The entity servers that are reached directly; replaces those named before.
    virtual void reachPeers(const std::vector<ServerAnnouncement>& /*entity_servers*/) {}
    /// To an entity of this other entity server, straight, by that lane. Refuses where it is known at once
    /// that it will not arrive; what is known of a message of the data lane later comes back as
    /// peerRefusal().
    virtual Result<void> peerMsg(Lane /*lane*/, const std::string& /*server*/, const Header& /*head*/,
                                 std::string_view /*message*/) {
        return {};
    }
    /// To the server of the entity that sent such a message.
    virtual void peerRefusal(Lane /*lane*/, const std::string& /*server*/, const Header& /*head*/,
                             const Refusal& /*refusal*/) {}
};

}  // namespace axon::entity_server
