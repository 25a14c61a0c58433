// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <cstdint>
#include <memory>
#include <string>

#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

class ServerCommunicators;

/// Where the entity server is and how to log in.
struct ServerAddress {
    std::string host = "127.0.0.1";
    std::uint16_t port = 10412;
    std::string user;
    std::string password;
    /// "Axon.Entities/router:tcp -h 127.0.0.1 -p 10415" instead of the first two; empty: none.
    std::string router = {};
    bool tls = false;         ///< what of these is called is called by TLS
    std::string secret = {};  ///< that the UUID is bound to (identity.hpp); empty: it is not

    /// For people.
    std::string text() const {
        return router.empty() ? (tls ? "ssl://" : "") + host + ":" + std::to_string(port) : router;
    }
};

/// What the server pushes. Called on Ice threads (signals on those of the signal lane); serverUp and
/// serverDown on the strand.
class ServerEvents {
  public:
    virtual ~ServerEvents() = default;
    virtual void serverUp() = 0;
    virtual void serverDown(const std::string& reason) = 0;
    /// `lane`: Signal only from another entity.
    virtual void clientMsg(Lane lane, Header head, std::string bytes) = 0;
    virtual void clientMsgDataSeq(Header head, std::string bytes) = 0;
    virtual void stopSignal(Header head, StopCause cause) = 0;
    virtual void resetSignal(Header head) = 0;
    virtual void clearSignal(Header head) = 0;
    virtual void clientUpdate(Header head, ClientChange change) = 0;
    virtual void serverHeartbeat() = 0;
    virtual void undeliverable(Lane lane, Header head, const Refusal& refusal) = 0;
};

/// The link between one Entity Manager and the entity server (thesis: EntityCommunicator, with SessionPrx and
/// EntityMonitorCallBack_Impl inside).
///
/// Where in the flow: implements ServerPort towards EntityManagerCore; keeps two Ice sessions, data and
/// signals, on two communicators that many Entity Managers of a process share (docs/reference/sessions.md).
/// States: unwanted; connecting (retries for ever, 100 ms to 2 s apart); up.
/// Threads: ServerPort's functions on the strand given; events on Ice's threads. Never blocks.
/// Failure: either connection lost = serverDown with the reason, both are closed and tried again. Each lane
/// has an Outbox: of a server that does not read, 4 MiB of data wait and then the oldest is dropped, and when
/// more than 16 MiB of control messages wait the server counts as lost. With more than 16,384
/// unsent signals it counts as lost too. Through a Glacier2 router both lanes are sessions of the same
/// server; at most 256 KiB are unanswered there at a time, the rest waits here, and a server that has died is
/// noticed by a sign of life that is not answered.
class EntityCommunicator final : public RelayedWay {
  public:
    EntityCommunicator(asio::any_io_executor strand, std::shared_ptr<ServerCommunicators> ice,
                       ServerAddress address, const Clock& clock, std::weak_ptr<ServerEvents> events);
    ~EntityCommunicator() override;

    void wantConnection(bool wanted) override;
    void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) override;
    void sendStatus(const EntityStatus& status) override;
    void sendToClient(Lane lane, const Header& head, const proto::ToClient& message) override;
    void sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) override;
    void sendToClientDataSeq(const Header& head, const proto::ToClient& message) override;

    void sendToClientBytes(Lane lane, const Header& head, const std::string& message) override;
    /// An axon.proto.ToClient that has been written already; otherwise as sendToClientDataSeq.
    void sendToClientDataSeqBytes(const Header& head, const std::string& message);

    /// The address of this machine at which the way to the server begins; empty while there is no session. On
    /// the strand.
    std::string localAddress() const;

  private:
    class Connection;
    std::shared_ptr<Connection> connection_;
};

}  // namespace axon::entity_manager
