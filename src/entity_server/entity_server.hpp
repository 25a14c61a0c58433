// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_server/entity_server_core.hpp"
#include "transport/ice/connection_limits.hpp"
#include "transport/process/service_manager.hpp"

namespace Ice {
class Communicator;
}

namespace axon::transport {
class LinkTrust;
class Logins;
}  // namespace axon::transport

namespace axon::entity_server {

struct EntityServerSettings {
    EntityServerCoreSettings core;
    std::string data_endpoint = "tcp -h 127.0.0.1 -p 10412";
    std::string signal_endpoint = "tcp -h 127.0.0.1 -p 10413";
    /// Who may come in. Outlives the communicators. Null: anybody.
    transport::Logins* logins = nullptr;
    /// Where it is recorded what happens to entities. Outlives end(). Null: nowhere.
    audit::AuditTrail* audit = nullptr;
    /// Who may be here at this moment. Outlives end(). Null: there are no users.
    const users::PresentUsers* users = nullptr;
    /// Where Glacier2 routers ask for passwords and sessions (EntityServerRouter); empty: none may.
    std::string router_endpoint = {};
    /// Of this server, where there are several; letters, digits, '-', '_' and '.'.
    std::string name = {};
    /// Session managers of the other servers of this kind, by name, as stringified proxies.
    std::map<std::string, std::string> neighbours = {};
    /// The front-end server in this process, called in the caller's thread. Outlives the communicators and
    /// end(). Null: this is one of several servers, and publishTo() says where the others are.
    FrontEndTopic* here = nullptr;
    // Of one of several: where the topic and, directly, signals of front-end servers reach it, and the
    // communicator of those signals.
    std::string topic_endpoint = "tcp -h 127.0.0.1 -p 0";
    std::string topic_signal_endpoint = "tcp -h 127.0.0.1 -p 0";
    std::shared_ptr<Ice::Communicator> topic_signals;
    /// Of one of several whose links to the others are under TLS. Outlives the communicators. Null: they are
    /// plain.
    transport::LinkTrust* links = nullptr;
    /// Its timer thread calls it on each turn, and again at the time that it returns; it outlives end().
    /// Of a ServiceWatchdog, for the timer thread. Empty: there is none.
    transport::ServiceWatchdog::Worker turned = {};
    /// Looks after the connections of peers from activate() on. Needed; outlives the server.
    transport::ConnectionLimits* limits = nullptr;
};

/// The entity server on Ice: two adapters, EntityServer and EntityServerSignal, each with a communicator and
/// threads of its own; the registry behind them; a timer thread and a publisher. Thesis: EntityServer.
///
/// One of several has two adapters more, EntityServerTopic and EntityServerTopicSignal, for what comes from
/// the front-end servers.
///
/// Life: construct, activate(); where there is nobody `here`, publishTo() now and whenever that changes;
/// before it is destroyed, destroy the communicators, then end().
class EntityServer {
  public:
    /// Throws std::runtime_error where it cannot listen (misconfiguration).
    EntityServer(const EntityServerSettings& settings, const std::shared_ptr<Ice::Communicator>& data,
                 const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock, RandomSource& random,
                 EntityServerCore::Note note);
    ~EntityServer();

    /// Of one of several: what subscribes to the topic, a stringified proxy. Its identity is the same at each
    /// start.
    std::string subscriber() const;
    /// Where the two topics are, as stringified proxies: publishers, or the servers themselves. None:
    /// they are down.
    void publishTo(const std::vector<std::string>& front_ends,
                   const std::vector<std::string>& entity_servers);
    void activate();
    /// Joins its own threads. Nothing is published afterwards.
    void end();
    /// "127.0.0.1:10412", with the port that was taken where 0 was asked for.
    std::string address(Lane lane) const;
    /// Of the adapter for routers; empty where there is none.
    std::string routerAddress() const;
    EntityServerCore& core();

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace axon::entity_server
