// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "front_end_server/front_end_core.hpp"
#include "transport/ice/connection_limits.hpp"
#include "transport/process/service_manager.hpp"
#include "transport/sessions/door_settings.hpp"

namespace Ice {
class Communicator;
}

namespace axon::transport {
class LinkTrust;
class Logins;
}  // namespace axon::transport

namespace axon::front_end_server {

struct FrontEndServerSettings {
    FrontEndCoreSettings core;
    std::string data_endpoint = "tcp -h 127.0.0.1 -p 10410";
    std::string signal_endpoint = "tcp -h 127.0.0.1 -p 10411";
    /// Who may come in. Outlives the communicators. Null: anybody, as operator.
    transport::Logins* logins = nullptr;
    /// What clients are answered who ask for global services. Outlives the communicators. Null: there are
    /// none.
    GlobalServicesPort* global_services = nullptr;
    /// Where it is recorded what clients do. Outlives end(). Null: nowhere.
    audit::AuditTrail* audit = nullptr;
    /// Who may be here at this moment. Outlives end(). Null: there are no users.
    const users::PresentUsers* users = nullptr;
    /// Where Glacier2 routers ask for passwords and sessions (FrontEndServerRouter); empty: none may.
    std::string router_endpoint = {};
    /// Of this server, where there are several; letters, digits, '-', '_' and '.'.
    std::string name = {};
    /// Session managers of the other servers of this kind, by name, as stringified proxies.
    std::map<std::string, std::string> neighbours = {};
    /// The entity server in this process, called in the caller's thread. Outlives the communicators and
    /// end(). Null: this is one of several servers, and publishTo() says where the others are.
    EntityTopic* here = nullptr;
    // Of one of several: where the topic and, directly, signals of entity servers reach it, and the
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

/// The front-end server on Ice: two adapters, FrontEndServer and FrontEndServerSignal, each with a
/// communicator and threads of its own; the clients behind them; two timer threads, of which one tells held
/// statuses. Thesis: FrontEndServer.
///
/// One of several has two adapters more, FrontEndServerTopic and FrontEndServerTopicSignal, for what comes
/// from the entity servers.
///
/// Life: construct, activate(); where there is nobody `here`, publishTo() now and whenever that changes;
/// before it is destroyed, destroy the communicators, then end().
class FrontEndServer {
  public:
    /// Throws std::runtime_error where it cannot listen (misconfiguration).
    FrontEndServer(const FrontEndServerSettings& settings, const std::shared_ptr<Ice::Communicator>& data,
                   const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock, RandomSource& random,
                   FrontEndCore::Note note);
    ~FrontEndServer();

    /// Of one of several: what subscribes to the topic, a stringified proxy. Its identity is the same at each
    /// start.
    std::string subscriber() const;
    /// Where the topic is, as stringified proxies: its publisher, or the servers themselves. None: it is
    /// down.
    void publishTo(const std::vector<std::string>& entity_servers);
    void activate();
    /// One more door, for browsers: the adapters FrontEndServerBrowsers and FrontEndServerBrowsersSignal at
    /// endpoints of WebSocket. Before activate(). Throws std::runtime_error where it cannot listen. What is
    /// referred to outlives the communicators.
    transport::DoorPorts listenToBrowsers(const transport::DoorSettings& settings);
    /// The door is closed again: its communicators have been destroyed. Before activate().
    void closeToBrowsers();
    /// Joins its own threads. Nothing is published afterwards.
    void end();
    /// Of the adapter for routers; empty where there is none.
    std::string routerAddress() const;
    /// "127.0.0.1:10410", with the port that was taken where 0 was asked for.
    std::string address(Lane lane) const;
    FrontEndCore& core();

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace axon::front_end_server
