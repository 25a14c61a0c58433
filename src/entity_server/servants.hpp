// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/entitycomm.h>
#include <axon/frontendcomm.h>

#include <array>
#include <memory>
#include <string>
#include <string_view>

#include "entity_server/entity_server_core.hpp"
#include "entity_server/ports/ports.hpp"
#include "transport/sessions/lane_session.hpp"
#include "transport/sessions/peer_sender.hpp"
#include "transport/sessions/router_servants.hpp"
#include "transport/topics/topic_publisher.hpp"

// The rim of the entity server: Ice's calls in, EntityServerCore's effects out. No decisions are made here
// but whether a call came over the right connection.
namespace axon::entity_server {

/// EntityOutbox over an EM's callback proxy.
class IceEntityOutbox final : public EntityOutbox {
  public:
    IceEntityOutbox(const std::shared_ptr<Axon::EntityComm::EntityCallbackPrx>& callback,
                    transport::OutboxLimits limits, std::shared_ptr<transport::PeerConnection> peer)
        : sender_(callback, limits, std::move(peer), "entity server") {}
    bool newClientMsg(const Header& head, std::string_view message, QueueShare share) override;
    void newClientMsgDataSeq(const Header& head, std::string_view data) override;
    bool stopSignal(const Header& head, StopCause cause) override;
    bool resetSignal(const Header& head) override;
    bool clearSignal(const Header& head) override;
    void newClientUpdate(const Header& head, ClientChange change) override;
    void newRefusalMsg(const Header& head, const Refusal& refusal) override;
    void newHeartbeat(std::int64_t sequence) override;
    void disconnect(bool orderly, const std::string& why) override;

  private:
    const transport::PeerSender<Axon::EntityComm::EntityCallbackPrx> sender_;
};

/// FrontEndTopic towards front-end servers in other processes: by the topic; signals and statuses besides
/// straight to each, and what is for one client straight to its server instead.
class IceFrontEndTopic final : public FrontEndTopic {
  public:
    /// What is called for a message that was taken and found nobody then: one to an entity of another server,
    /// and one to a client. Any thread.
    struct Lost {
        std::function<void(const Header&, const Refusal&)> to_peer, to_client;
    };
    /// `refused` is called when a connection to where that server takes signals was refused; any thread.
    /// `signal`: the communicator of signals between servers. `links`: of links under TLS, else null.
    IceFrontEndTopic(
        const std::shared_ptr<Ice::Communicator>& data, const std::shared_ptr<Ice::Communicator>& signal,
        Lost lost, const std::function<void(const std::string& server, const std::string& signals)>& refused,
        transport::LinkTrust* links);
    /// As stringified proxies; none: the topic is down.
    void publishTo(const std::vector<std::string>& front_ends,
                   const std::vector<std::string>& entity_servers) {
        front_ends_.publishTo(front_ends);
        peers_.publishTo(entity_servers);
    }
    /// Before anything is published: where this server takes signals and messages directly.
    void setDirect(const std::string& signals, const std::string& messages) {
        front_ends_.setDirect(signals, messages);
        peers_.setDirect(signals, messages);
    }
    /// Nothing is published or sent any more; what still waits is lost.
    void end();
    void entityBasicPrflUpdate(Presence presence, const Registration& registration,
                               std::string_view profile) override;
    void entityUpdate(const EntityStatus& status, std::int64_t number) override;
    void entityMsg(Lane lane, const Header& head, std::string_view message) override;
    void entityMsgDataSeq(const Header& head, std::string_view data) override;
    void entityRefusal(Lane lane, const Header& head, const Refusal& refusal) override;
    void entityServerEntities(const std::string& server, const std::vector<std::string>& entities) override;
    void entityServerUpdate(Lane lane, const ServerAnnouncement& self) override;
    void reach(const std::vector<ServerAnnouncement>& front_ends) override;
    void peersUpdate(Lane lane, const ServerAnnouncement& self,
                     const std::vector<std::string>& entities) override;
    void reachPeers(const std::vector<ServerAnnouncement>& entity_servers) override;
    Result<void> peerMsg(Lane lane, const std::string& server, const Header& head,
                         std::string_view message) override;
    void peerRefusal(Lane lane, const std::string& server, const Header& head,
                     const Refusal& refusal) override;

  private:
    template <class Call>
    bool toOne(transport::Traffic traffic, const Header& head, std::string_view bytes, const Call& call,
               SenderKey from = kServersOwn);

    const transport::PublicationTicket::Lost peer_lost_;
    const transport::PublicationTicket::Lost client_lost_;
    const std::function<void(const Header&, const Refusal&)> to_client_refused_;
    transport::TopicPublisher<Axon::EntityComm::EntityToFrontEndCommPrx> front_ends_;
    transport::TopicPublisher<Axon::FrontEndComm::FrontEndToEntityCommPrx> peers_;
};

class EntitySessionServant;

using EntityLane = transport::SessionLane<EntityServerCore, EntitySessionServant>;

/// One session of an Entity Manager on one lane (thesis: Session_Impl). States: opened, ready (setCallback or
/// attachSignalLane), closed. Answers only on the connection that opened it.
class EntitySessionServant final : public Axon::EntityComm::EntitySession {
  public:
    /// `certified`: the only name that it may register, by its certificate; empty: any. `user`: who has
    /// logged in; empty where nobody has a name.
    EntitySessionServant(EntityLane& lane, std::shared_ptr<transport::PeerConnection> peer,
                         std::string certified = {}, std::string user = {})
        : lane_(lane),
          certified_(std::move(certified)),
          user_(std::move(user)),
          session_(std::move(peer), [&lane](const auto& session, const Farewell& farewell) {
              lane.core.leave(session, farewell.orderly, farewell.why);
          }) {}

    bool ready() const { return session_.ready(); }
    void disconnect(const std::string& why) { session_.peer()->disconnect({false, why}, false); }
    void closed(const transport::CloseReason& reason) { session_.end({false, reason.text}); }

    Axon::EntityComm::SessionFacts setCallback(std::shared_ptr<Axon::EntityComm::EntityCallbackPrx> callback,
                                               const Ice::Current& current) override;
    void attachSignalLane(std::string token, std::shared_ptr<Axon::EntityComm::EntityCallbackPrx> callback,
                          const Ice::Current& current) override;
    void sendBasicPrfl(Axon::CommUtil::Registration registration, transport::ByteRange profile,
                       transport::ByteRange secret, const Ice::Current& current) override;
    void sendStatus(Axon::CommUtil::EntityStatus status, const Ice::Current& current) override;
    void sendToClient(Axon::CommUtil::Header head, transport::ByteRange message,
                      const Ice::Current& current) override;
    void sendToClientDataSeq(Axon::CommUtil::Header head, transport::ByteRange data,
                             const Ice::Current& current) override;
    void sendToPeer(Axon::CommUtil::Header head, transport::ByteRange message,
                    const Ice::Current& current) override;
    void keepAlive(double sequence, const Ice::Current& current) override;
    void leave(const Ice::Current& current) override;
    void destroy(const Ice::Current& current) override;

  private:
    struct Farewell {
        bool orderly = false;
        std::string why;
    };
    Header proper(Axon::CommUtil::Header head, const Ice::Current& current) const {
        return session_.peer()->properHead(std::move(head), current);
    }

    EntityLane& lane_;
    const std::string certified_;
    const std::string user_;
    transport::LaneSession<EntityServerCore::SessionRef, Farewell> session_;
};

/// Where Entity Managers without a router come in (thesis: SessionManager).
class EntityGateServant final : public Axon::EntityComm::EntityGate {
  public:
    explicit EntityGateServant(EntityLane& lane) : lane_(lane) {}
    using Opened = std::function<void(const std::shared_ptr<Axon::EntityComm::EntitySessionPrx>&)>;
    using Refused = std::function<void(std::exception_ptr)>;
    void openAsync(std::string user, std::string password, Opened opened, Refused refused,
                   const Ice::Current& current) override;

  private:
    EntityLane& lane_;
};

/// Listens to the front-end servers on one lane (thesis figure 3.15).
class FrontEndToEntityServant final : public Axon::FrontEndComm::FrontEndToEntityComm {
  public:
    /// Who calls straight, and what. What comes by the topic only is for whoever carries it.
    static constexpr std::array kCallers{certificates::Kind::FrontEnd, certificates::Kind::EntityServer};
    static certificates::Kind callerOf(std::string_view operation);

    /// `links`: of what comes straight over TLS, where each server speaks for itself only; else null. A stop
    /// is obeyed whoever it is said to come from.
    FrontEndToEntityServant(EntityServerCore& core, Lane lane, Via via, transport::LinkTrust* links)
        : core_(core), lane_(lane), via_(via), links_(links) {}
    void clientMsg(Axon::CommUtil::Header head, transport::ByteRange message, const Ice::Current&) override;
    void clientMsgDataSeq(Axon::CommUtil::Header head, transport::ByteRange data,
                          const Ice::Current&) override;
    void clientRequest(Axon::CommUtil::Header head, const Ice::Current&) override;
    void clientUpdate(Axon::CommUtil::Header head, Axon::CommUtil::ClientChange change,
                      const Ice::Current&) override;
    void stopSignal(Axon::CommUtil::Header head, Axon::CommUtil::StopCause cause,
                    const Ice::Current&) override;
    void stopSignals(Axon::CommUtil::Header head, Axon::CommUtil::Entities entities,
                     Axon::CommUtil::StopCause cause, const Ice::Current&) override;
    void resetSignal(Axon::CommUtil::Header head, const Ice::Current&) override;
    void clearSignal(Axon::CommUtil::Header head, const Ice::Current&) override;
    void frontEndServerUpdate(Axon::CommUtil::ServerAnnouncement server, const Ice::Current&) override;
    void entityServerUpdate(Axon::CommUtil::ServerAnnouncement server, Axon::CommUtil::Entities entities,
                            const Ice::Current&) override;
    void peerMsg(Axon::CommUtil::Header head, transport::ByteRange message, const Ice::Current&) override;
    void peerRefusal(Axon::CommUtil::Header head, int code, std::string reason, const Ice::Current&) override;

  private:
    /// Whether the caller is the front-end server of the client that the head names.
    bool ofItsClient(const Axon::CommUtil::Header& head, const Ice::Current& current) const;
    /// Whether the caller is the server of this entity.
    bool ofItsEntity(const std::string& entity, const char* what, const Ice::Current& current) const;

    EntityServerCore& core_;
    const Lane lane_;
    const Via via_;
    transport::LinkTrust* const links_;
};

/// What is the entity server's own of its ServerRim.
struct EntitySessions {
    using Core = EntityServerCore;
    using Topic = IceFrontEndTopic;
    using Session = EntitySessionServant;
    using SessionPrx = Axon::EntityComm::EntitySessionPrx;
    using Gate = EntityGateServant;
    using Listener = FrontEndToEntityServant;
    static constexpr const char* kServer = "EntityServer";
    static constexpr auto kCertificate = certificates::Kind::EntityServer;
    static constexpr const char* kPeer = "an Entity Manager";
    static constexpr const char* kGate = "EntityGate";
    static constexpr const char* kTimer = "axon-ent-timer";
    static constexpr auto kVerify = &transport::Logins::entity;
    static constexpr auto kVouched = &transport::Logins::vouchedEntity;
    static std::shared_ptr<EntitySessionServant> make(EntityLane& lane,
                                                      const std::shared_ptr<transport::PeerConnection>& peer,
                                                      const transport::LoggedIn& who,
                                                      const std::string& display_name);
};

}  // namespace axon::entity_server
