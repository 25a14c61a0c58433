// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/entitycomm.h>
#include <axon/frontendcomm.h>

#include <array>
#include <memory>
#include <string>
#include <string_view>

#include "front_end_server/front_end_core.hpp"
#include "front_end_server/ports/ports.hpp"
#include "transport/ice/link_trust.hpp"
#include "transport/sessions/lane_session.hpp"
#include "transport/sessions/peer_sender.hpp"
#include "transport/sessions/router_servants.hpp"
#include "transport/topics/topic_publisher.hpp"

// The rim of the front-end server: Ice's calls in, FrontEndCore's effects out. No decisions are made here but
// whether a call came over the right connection.
namespace axon::front_end_server {

/// ClientOutbox over a client's callback proxy.
class IceClientOutbox final : public ClientOutbox {
  public:
    IceClientOutbox(const std::shared_ptr<Axon::FrontEndComm::ClientCallbackPrx>& callback,
                    transport::OutboxLimits limits, std::shared_ptr<transport::PeerConnection> peer)
        : sender_(callback, limits, std::move(peer), "front-end server") {}
    void newBasicPrflMsg(Presence presence, const Registration& registration,
                         std::string_view profile) override;
    void newStatusMsg(const EntityStatus& status) override;
    bool newEntityMsg(Lane lane, const Header& head, std::string_view message, QueueShare share) override;
    void newEntityMsgDataSeq(const Header& head, std::string_view data) override;
    void newRefusalMsg(const Header& head, const Refusal& refusal) override;
    void newStopAccepted(const Header& head, std::int32_t entities) override;
    void newUpdateMsg(RefusalCode code, const std::string& text) override;
    void newHeartbeat(std::int64_t sequence) override;
    void disconnect(bool orderly, const std::string& why) override;
    const void* connection() const override { return sender_.connection(); }

  private:
    const transport::PeerSender<Axon::FrontEndComm::ClientCallbackPrx> sender_;
};

/// EntityTopic towards entity servers in other processes: by the topic; signals besides straight to each, and
/// what is for one entity straight to its server instead.
class IceEntityTopic final : public EntityTopic {
  public:
    /// `signal`: the communicator of signals between servers. `lost` is called for a client's control message
    /// that found nobody after it was taken, and `refused` when a connection to where an entity server takes
    /// signals was refused; any thread.
    IceEntityTopic(const std::shared_ptr<Ice::Communicator>& data,
                   const std::shared_ptr<Ice::Communicator>& signal,
                   std::function<void(const Header&, const Refusal&)> lost,
                   std::function<void(const std::string& server, const std::string& signals)> refused,
                   transport::LinkTrust* links);
    /// As stringified proxies; none: the topic is down.
    void publishTo(const std::vector<std::string>& entity_servers) { publisher_.publishTo(entity_servers); }
    /// Before anything is published: where this server takes signals and messages directly.
    void setDirect(const std::string& signals, const std::string& messages) {
        publisher_.setDirect(signals, messages);
    }
    /// Nothing is published or sent any more; what still waits is lost.
    void end();
    Result<void> clientMsg(const std::string& server, const Header& head, std::string_view message) override;
    void clientMsgDataSeq(const std::string& server, const Header& head, std::string_view data) override;
    void clientRequest(const Header& head) override;
    void clientUpdate(const Header& head, ClientChange change) override;
    void stopSignal(const Header& head, StopCause cause) override;
    void stopSignals(const Header& head, const std::vector<std::string>& entities, StopCause cause) override;
    void resetSignal(const Header& head) override;
    void clearSignal(const Header& head) override;
    void frontEndServerUpdate(Lane lane, const ServerAnnouncement& self, const std::string& users) override;
    void reach(const std::vector<ServerAnnouncement>& entity_servers) override;

  private:
    const transport::PublicationTicket::Lost lost_;
    transport::TopicPublisher<Axon::FrontEndComm::FrontEndToEntityCommPrx> publisher_;
};

class ClientSessionServant;

using ClientLane = transport::SessionLane<FrontEndCore, ClientSessionServant>;

/// One session of a client on one lane (thesis: Session_Impl). States: opened, ready (setCallback or
/// attachSignalLane), closed. Answers only on the connection that opened it.
class ClientSessionServant final : public Axon::FrontEndComm::ClientSession {
  public:
    ClientSessionServant(ClientLane& lane, std::shared_ptr<transport::PeerConnection> peer,
                         std::string display_name, transport::LoggedIn who)
        : lane_(lane),
          name_(std::move(display_name)),
          who_(std::move(who)),
          session_(std::move(peer), [&lane](const auto& client, const Farewell& farewell) {
              lane.core.leave(client, farewell.ending, farewell.why);
          }) {}

    bool ready() const { return session_.ready(); }
    void disconnect(const std::string& why) { session_.peer()->disconnect({false, why}, false); }
    void closed(const transport::CloseReason& reason) {
        session_.end({reason.improper ? Ending::Improper : Ending::Lost, reason.text});
    }

    Axon::FrontEndComm::SessionFacts setCallback(
        std::shared_ptr<Axon::FrontEndComm::ClientCallbackPrx> callback,
        const Ice::Current& current) override;
    void attachSignalLane(std::string token, std::shared_ptr<Axon::FrontEndComm::ClientCallbackPrx> callback,
                          const Ice::Current& current) override;
    void sendRequest(Axon::CommUtil::Header head, transport::ByteRange message,
                     const Ice::Current& current) override;
    void sendToEntity(Axon::CommUtil::Header head, transport::ByteRange message,
                      const Ice::Current& current) override;
    void sendToEntityDataSeq(Axon::CommUtil::Header head, transport::ByteRange data,
                             const Ice::Current& current) override;
    void sendStopSignal(Axon::CommUtil::Header head, Axon::CommUtil::StopCause cause,
                        const Ice::Current& current) override;
    void sendStopSignals(Axon::CommUtil::Header head, Axon::CommUtil::StopList entities,
                         Axon::CommUtil::StopCause cause, const Ice::Current& current) override;
    void sendResetSignal(Axon::CommUtil::Header head, const Ice::Current& current) override;
    void sendClearSignal(Axon::CommUtil::Header head, const Ice::Current& current) override;
    void keepAlive(double sequence, const Ice::Current& current) override;
    void leave(const Ice::Current& current) override;
    void destroy(const Ice::Current& current) override;

  private:
    struct Farewell {
        Ending ending = Ending::Lost;
        std::string why;
    };
    Header proper(Axon::CommUtil::Header head, const Ice::Current& current) const {
        return session_.peer()->properHead(std::move(head), current);
    }

    ClientLane& lane_;
    const std::string name_;
    const transport::LoggedIn who_;
    transport::LaneSession<FrontEndCore::ClientRef, Farewell> session_;
};

/// Where clients without a router come in (thesis: SessionManager).
class ClientGateServant final : public Axon::FrontEndComm::ClientGate {
  public:
    explicit ClientGateServant(ClientLane& lane) : lane_(lane) {}
    using Opened = std::function<void(const std::shared_ptr<Axon::FrontEndComm::ClientSessionPrx>&)>;
    using Refused = std::function<void(std::exception_ptr)>;
    void openAsync(std::string user, std::string password, std::string display_name, Opened opened,
                   Refused refused, const Ice::Current& current) override;

  private:
    ClientLane& lane_;
};

/// Listens to the entity servers on one lane (thesis figure 3.14).
class EntityToFrontEndServant final : public Axon::EntityComm::EntityToFrontEndComm {
  public:
    /// Who calls straight, and what. What comes by the topic only is for whoever carries it.
    static constexpr std::array kCallers{certificates::Kind::EntityServer};
    static certificates::Kind callerOf(std::string_view operation);

    /// `links`: of what comes straight over TLS, where each server speaks for itself only; else null.
    EntityToFrontEndServant(FrontEndCore& core, Lane lane, Via via, transport::LinkTrust* links)
        : core_(core), lane_(lane), via_(via), links_(links) {}
    void entityBasicPrflUpdate(Axon::CommUtil::Presence presence, Axon::CommUtil::Registration registration,
                               transport::ByteRange profile, const Ice::Current&) override;
    void entityUpdate(Axon::CommUtil::EntityStatus status, double number, const Ice::Current&) override;
    void entityMsg(Axon::CommUtil::Lane lane, Axon::CommUtil::Header head, transport::ByteRange message,
                   const Ice::Current&) override;
    void entityMsgDataSeq(Axon::CommUtil::Header head, transport::ByteRange data,
                          const Ice::Current&) override;
    void entityRefusal(Axon::CommUtil::Header head, int code, std::string reason,
                       const Ice::Current&) override;
    void entityServerEntities(std::string server, Axon::CommUtil::Entities entities,
                              const Ice::Current&) override;
    void entityServerUpdate(Axon::CommUtil::ServerAnnouncement server, const Ice::Current&) override;

  private:
    /// Whether the caller is the server of the entity that the head names.
    bool ofItsEntity(const Axon::CommUtil::Header& head, const char* what, const Ice::Current& current) const;

    FrontEndCore& core_;
    const Lane lane_;
    const Via via_;
    transport::LinkTrust* const links_;
};

/// What is the front-end server's own of its ServerRim.
struct ClientSessions {
    using Core = FrontEndCore;
    using Topic = IceEntityTopic;
    using Session = ClientSessionServant;
    using SessionPrx = Axon::FrontEndComm::ClientSessionPrx;
    using Gate = ClientGateServant;
    using Listener = EntityToFrontEndServant;
    static constexpr const char* kServer = "FrontEndServer";
    static constexpr auto kCertificate = certificates::Kind::FrontEnd;
    static constexpr const char* kPeer = "a client";
    static constexpr const char* kGate = "ClientGate";
    static constexpr const char* kTimer = "axon-fe-timer";
    static constexpr auto kVerify = &transport::Logins::client;
    static constexpr auto kVouched = &transport::Logins::vouchedClient;
    static std::shared_ptr<ClientSessionServant> make(ClientLane& lane,
                                                      const std::shared_ptr<transport::PeerConnection>& peer,
                                                      const transport::LoggedIn& who,
                                                      const std::string& display_name);
};

}  // namespace axon::front_end_server
