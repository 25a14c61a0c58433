// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <map>
#include <memory>
#include <string>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_server/entity_server_core.hpp"

namespace Ice {
class Communicator;
}
namespace Axon::EntityComm {
class EntityToFrontEndCommPrx;
}
namespace Axon::FrontEndComm {
class FrontEndToEntityCommPrx;
}

namespace axon::transport {
class Logins;
}

namespace axon::entity_server {

struct EntityServerSettings {
    CoreSettings core;
    std::string data_endpoint = "tcp -h 127.0.0.1 -p 10412";
    std::string signal_endpoint = "tcp -h 127.0.0.1 -p 10413";
    /// Who may come in. Outlives the communicators. Null: anybody.
    transport::Logins* logins = nullptr;
    /// Where Glacier2 routers ask for passwords and sessions (EntityServerRouter); empty: none may.
    std::string router_endpoint = {};
    /// Of this server, where there are several; letters, digits, '-', '_' and '.'.
    std::string name = {};
    /// Session managers of the other servers of this kind, by name, as stringified proxies.
    std::map<std::string, std::string> neighbours = {};
    /// The front-end server in this process, called in the caller's thread. Outlives the communicators and
    /// end(). Null: publishTo() says where.
    FrontEndTopic* here = nullptr;
};

/// The entity server on Ice: two adapters, EntityServer and EntityServerSignal, each with a communicator and
/// threads of its own; the registry behind them; a timer thread and a publisher. Thesis: EntityServer.
///
/// Life: construct, publishTo() where there is nobody `here`, activate(); before it is destroyed, destroy
/// both communicators, then end().
class EntityServer {
  public:
    /// Throws std::runtime_error where it cannot listen (misconfiguration).
    EntityServer(EntityServerSettings settings, const std::shared_ptr<Ice::Communicator>& data,
                 const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock, RandomSource& random,
                 EntityServerCore::Note note);
    ~EntityServer();

    /// Where front-end servers of other processes reach it: what subscribes to the topic.
    std::shared_ptr<Axon::FrontEndComm::FrontEndToEntityCommPrx> subscriber(Lane lane) const;
    /// Where it publishes to: IceStorm's publishers, or the other's subscribers themselves.
    void publishTo(std::shared_ptr<Axon::EntityComm::EntityToFrontEndCommPrx> data,
                   std::shared_ptr<Axon::EntityComm::EntityToFrontEndCommPrx> signal);
    void activate();
    /// Joins its own threads: nothing is published any more.
    void end();
    /// "127.0.0.1:10412", with the port that was taken where 0 was asked for.
    std::string address(Lane lane) const;
    /// Of the adapter for routers; empty where there is none.
    std::string routerAddress() const;
    EntityServerCore& core();

  private:
    class Rim;
    std::unique_ptr<Rim> rim_;
};

}  // namespace axon::entity_server
