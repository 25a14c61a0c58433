// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include "entity_server/entity_server_core.hpp"
#include "front_end_server/front_end_core.hpp"
#include "simulation/network.hpp"
#include "simulation/observer.hpp"
#include "transport/outbox/outbox_core.hpp"

namespace axon::simulation {

class ClientStation;
class EntityManagerStation;

/// axon-server: both servers in one process, their topics joined directly, as the embedded default has it. In
/// place of Ice: connections of the simulated network, and the servants' few decisions (who has two lanes,
/// what the close of a connection means).
class ServerStation {
  public:
    /// A client's or an Entity Manager's session as its peer holds it: a proxy that is good for one life of
    /// the server.
    struct ClientSession {
        ClientStation* who = nullptr;
        std::uint64_t attempt = 0;
        Connection* data = nullptr;
        Connection* signal = nullptr;
        front_end_server::FrontEndCore::ClientRef ref;
        bool ended = false;
    };
    struct EntitySession {
        EntityManagerStation* who = nullptr;
        std::uint64_t attempt = 0;
        Connection* data = nullptr;
        Connection* signal = nullptr;
        entity_server::EntityServerCore::SessionRef ref;
        bool ended = false;
    };

    ServerStation(Timeline& timeline, Dice& dice, Observer& observer, std::uint64_t seed);
    ~ServerStation();

    Process& process() { return process_; }
    void start();
    void kill();

    // What arrives from clients; runs as this process.
    void clientHello(ClientStation& who, std::uint64_t attempt, Connection& data, Role role);
    void clientAttach(ClientSession& session, Connection& signal, const std::string& token);
    void clientGone(ClientSession& session, front_end_server::Ending ending, const char* why);
    void sendToEntity(ClientSession& session, const Header& head, const std::string& bytes);
    void sendToEntityDataSeq(ClientSession& session, const Header& head, const std::string& bytes);
    void sendRequest(ClientSession& session, const Header& head);
    void sendStopSignal(ClientSession& session, const Header& head, StopCause cause);
    void sendStopSignals(ClientSession& session, const Header& head, const std::vector<std::string>& entities,
                         StopCause cause);
    void sendReset(ClientSession& session, const Header& head);
    void sendClear(ClientSession& session, const Header& head);
    void keepAlive(ClientSession& session);

    // … and from Entity Managers.
    void entityHello(EntityManagerStation& who, std::uint64_t attempt, Connection& data);
    void entityAttach(EntitySession& session, Connection& signal, const std::string& token);
    void entityGone(EntitySession& session, bool orderly, const char* why);
    void sendBasicPrfl(EntitySession& session, const Registration& registration, const std::string& profile);
    void sendStatus(EntitySession& session, const EntityStatus& status);
    void sendToClient(EntitySession& session, Lane lane, const Header& head, const std::string& bytes);
    void sendToPeer(EntitySession& session, Lane lane, const Header& head, const std::string& bytes);
    void sendToClientDataSeq(EntitySession& session, const Header& head, const std::string& bytes);
    void keepAlive(EntitySession& session);

    /// For who logs in without a process and a network of its own (Liars). Null while the process is dead.
    front_end_server::FrontEndCore* frontEnd();
    entity_server::EntityServerCore* entityServer();

    std::size_t clients() const;
    std::size_t entities() const;

    /// Of the outboxes to clients; before start().
    transport::OutboxLimits outbox_limits;

  private:
    template <class Core, class Session, class Outbox, class Gone>
    void attachLane(Core& core, Session& session, Connection& signal, const std::string& token,
                    std::shared_ptr<Outbox> outbox, Gone gone);
    std::shared_ptr<front_end_server::ClientOutbox> outboxTo(ClientSession& session, Connection& connection);

    struct Life;
    void wake();
    void onTimer();

    Timeline& timeline_;
    Dice& dice_;
    Observer& observer_;
    Process process_;
    SeededRandom random_;
    Alarm alarm_;
    std::unique_ptr<Life> life_;
    // Of all lives; they never shrink, for peers hold pointers, and may show one of an earlier life to a
    // later one.
    std::deque<ClientSession> client_sessions_;
    std::deque<EntitySession> entity_sessions_;
};

}  // namespace axon::simulation
