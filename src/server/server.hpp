// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "audit/trail.hpp"
#include "entity_server/entity_server_core.hpp"
#include "front_end_server/front_end_core.hpp"
#include "transport/process/service_manager.hpp"

namespace axon::server {

/// Which servers a process of `axon-server` has.
enum class ServerRole : std::uint8_t {
    Both,      ///< the embedded default: they call each other
    FrontEnd,  ///< one of several front-end servers
    Entity     ///< one of several entity servers
};

/// The web console (docs/reference/console.md). Default: there is none.
struct ConsoleSettings {
    bool wanted = true;  ///< what Server.Console says; read by parseOptions() only
    // One endpoint each, HOST:PORT or ssl://HOST:PORT.
    std::string endpoint;          ///< of its pages; empty: no console
    std::string session_endpoint;  ///< of its sessions, over WebSocket
    std::string signal_endpoint;   ///< of their signal lane, over WebSocket
    /// Whether the server refuses to start without it: somebody has asked for it.
    bool required = true;
    std::string left_out;  ///< why there is none though nobody has said so, with the fix; for the log
    /// A connection to the sessions' ports must have one by then.
    Duration to_log_in = std::chrono::seconds{10};
    std::string folder;                ///< of the built console; empty: the one that belongs to this program
    std::vector<std::string> names;    ///< under which browsers call this machine, besides its own
    std::vector<std::string> proxies;  ///< origins, such as https://lab.example, of proxies before it
};

/// Settings of `axon-server`; docs/reference/ports.md and server_configuration.md.
struct ServerSettings {
    ServerRole role = ServerRole::Both;
    // Of one of several servers only:
    std::string name;  ///< isServerName()
    std::string
        topic_manager;  ///< IceStorm's, a stringified proxy. Empty: publishTo() says where the others are
    // Over TLS, all of them and the topic manager are (docs/reference/tls.md).
    std::string topic_endpoint = "127.0.0.1:0";         ///< where IceStorm reaches it
    std::string topic_signal_endpoint = "127.0.0.1:0";  ///< where signals of the others reach it directly
    // HOST:PORT, ssl://HOST:PORT, or Ice's form, of which there may be several with ':' between them.
    std::string client_endpoint = "127.0.0.1:10410";
    std::string client_signal_endpoint = "127.0.0.1:10411";
    std::string entity_endpoint = "127.0.0.1:10412";
    std::string entity_signal_endpoint = "127.0.0.1:10413";
    /// For Glacier2 routers; empty: none.
    std::string client_router_endpoint, entity_router_endpoint;
    std::map<std::string, std::string> neighbours;  ///< their session managers, for routers, by name
    int data_threads = 1;                           ///< of each adapter of the data lane
    int signal_threads = 1;                         ///< of each adapter of the signal lane
    front_end_server::FrontEndCoreSettings front_end;
    entity_server::EntityServerCoreSettings entity;
    std::string users_file;       ///< users.cfg; empty: none, and loopback only
    std::string global_services;  ///< the folder of global services; empty: there are none
    ConsoleSettings console;
    audit::TrailSettings audit;                         ///< no folder: nothing is recorded
    bool plain_tcp = false;                             ///< also where other machines can reach it
    std::map<std::string, std::string> ice_properties;  ///< win over the defaults
    bool lock_memory = true;                            ///< of the process of axon-server, where permitted
    /// Of the process of axon-server: how long its timer threads may stand still where no service manager
    /// watches them; zero: for ever.
    Duration stuck_for{};
    /// Is told that the timer threads of the servers go on. Outlives the server. Null: nobody watches this
    /// process.
    transport::ServiceWatchdog* watchdog = nullptr;
};

/// Throws std::runtime_error, saying how to fix it, for a text that is not an endpoint; for an endpoint
/// beyond loopback if the server has no users, because nobody may move a robot without a name; and for an
/// endpoint beyond loopback without TLS, unless `plain_tcp`. Returns whether other machines can reach one
/// without TLS.
bool checkEndpoints(const std::string& endpoints, bool has_users, bool plain_tcp);

/// Both servers in one process, the embedded default: each publishes to the other by plain calls, which run
/// in the caller's thread, one lane apart from the other. Or one of several servers, joined with the others
/// by the two topics of IceStorm. The only place that knows which.
///
/// The constructor returns when both listen. The destructor tells the clients, closes their sessions and
/// joins all threads. Throws std::runtime_error for misconfiguration.
class Server {
  public:
    explicit Server(ServerSettings settings);
    ~Server();
    Server(const Server&) = delete;
    Server& operator=(const Server&) = delete;

    /// Of one of several without a topic manager, for tests: what subscribes to the topic it listens to, and
    /// where it publishes to, as stringified proxies. A front-end server publishes to entity servers only.
    std::string subscriber() const;
    void publishTo(const std::vector<std::string>& front_ends,
                   const std::vector<std::string>& entity_servers);

    /// The addresses that were taken, as HOST:PORT; each of a server that is here.
    std::string clientAddress(Lane lane) const;
    std::string entityAddress(Lane lane) const;
    /// For routers; empty where none are let in.
    std::string clientRouterAddress() const;
    std::string entityRouterAddress() const;
    /// "http://127.0.0.1:10417/"; empty where there is no console.
    std::string consoleAddress() const;
    /// The ports of the console's sessions; 0 where there is none.
    std::uint16_t consoleSessionPort(Lane lane = Lane::Data) const;
    /// "ready client=… client-signal=… entity=… entity-signal=…", of the servers that are here, and
    /// client-router=… entity-router=… where routers are let in, and console=… where there is one.
    std::string readyLine() const;

    /// For people: how near each watchdog came to its end in the last minute, and how long stops take.
    std::vector<std::string> margins() const;

    entity_server::EntityServerCore& entityCore();
    front_end_server::FrontEndCore& frontEndCore();

  private:
    class Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace axon::server
