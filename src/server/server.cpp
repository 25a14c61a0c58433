// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/server.hpp"

#include <Ice/Ice.h>
#include <arpa/inet.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <optional>
#include <stdexcept>
#include <utility>

#include "certificates/folder.hpp"
#include "certificates/trust.hpp"
#include "common/ids.hpp"
#include "common/rate_limit.hpp"
#include "common/release.hpp"
#include "common/shared_clock.hpp"
#include "entity_server/entity_server.hpp"
#include "front_end_server/front_end_server.hpp"
#include "global_services/services_folder.hpp"
#include "host/port_range.hpp"
#include "host/socket_owner.hpp"
#include "server/console_station.hpp"
#include "server/login_desk.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/broken_protocol.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/connection_limits.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/link_trust.hpp"
#include "transport/ice/timer_thread.hpp"
#include "transport/ice/tls.hpp"
#include "transport/topics/storm_topics.hpp"
#include "users/users_watch.hpp"

namespace axon::server {

namespace {

std::vector<transport::Endpoint> parsed(const std::string& endpoints) {
    try {
        return transport::parseEndpoints(endpoints);
    } catch (const std::invalid_argument& error) {
        throw std::runtime_error(error.what());
    }
}

std::string iceForm(const std::string& endpoints) {
    return transport::textOf(parsed(endpoints));
}

/// Whoever comes to the data lane by a protocol is told a signal lane by the same one.
void checkLanes(const std::string& data, const std::string& signal) {
    for (const auto& wanted : parsed(data)) {
        const auto offered = parsed(signal);
        if (std::none_of(offered.begin(), offered.end(),
                         [&](const transport::Endpoint& one) { return one.tls == wanted.tls; }))
            throw std::runtime_error(
                "the data lane listens on '" + wanted.address() + "', but its signal lane ('" + signal +
                "') has no endpoint of " + (wanted.tls ? "ssl" : "tcp") +
                "; fix: give it one, because a client sends stops over the protocol of its data lane");
    }
}

}  // namespace

bool checkEndpoints(const std::string& endpoints, bool has_users, bool plain_tcp) {
    bool open = false;
    for (const auto& endpoint : parsed(endpoints)) {
        const auto& host = endpoint.host;
        in_addr address{};
        const bool numeric = inet_pton(AF_INET, host.c_str(), &address) == 1;
        const bool name = host.find_first_not_of("0123456789.") != std::string::npos;
        if (!numeric && !name) {
            throw std::runtime_error("'" + endpoints +
                                     "': expected an address of four numbers, such as 127.0.0.1:10410");
        }
        if (host == "localhost" || (numeric && (ntohl(address.s_addr) >> 24U) == 127)) continue;
        if (!has_users) {
            throw std::runtime_error(
                "'" + endpoints +
                "' is reachable from other machines, and the server has no users: anybody there could move "
                "the robots; fix: name who may log in (axon-server --users FILE --add-user NAME --user-role "
                "ROLE, then --users FILE), or listen on 127.0.0.1 and let other machines in through an SSH "
                "tunnel (ssh -L 10410:127.0.0.1:10410 -L 10411:127.0.0.1:10411 HOST)");
        }
        if (endpoint.tls) continue;
        if (!plain_tcp) {
            throw std::runtime_error(
                "'" + endpoints +
                "' is reachable from other machines without TLS: what they send, passwords included, could "
                "be read and changed on the way; fix: listen over TLS (ssl://HOST:PORT, with a certificate "
                "from axon certs issue --server HOST; docs/reference/tls.md), or declare this network "
                "trusted with --plain-tcp or Server.PlainTcp=1");
        }
        open = true;
    }
    return open;
}

namespace {

void note(const std::string& line) {
    spdlog::info("{}", line);
}

std::vector<std::string> endpointsOf(const ServerSettings& settings) {
    std::vector<std::string> endpoints;
    if (settings.role != ServerRole::Entity)
        endpoints = {settings.client_endpoint, settings.client_signal_endpoint};
    if (settings.role != ServerRole::FrontEnd) {
        endpoints.push_back(settings.entity_endpoint);
        endpoints.push_back(settings.entity_signal_endpoint);
    }
    for (const auto& other :
         {settings.client_router_endpoint, settings.entity_router_endpoint, settings.console.endpoint,
          settings.console.session_endpoint, settings.console.signal_endpoint})
        if (!other.empty()) endpoints.push_back(other);
    return endpoints;
}

certificates::Kind ownKind(const ServerSettings& settings) {
    return settings.role == ServerRole::Entity ? certificates::Kind::EntityServer
                                               : certificates::Kind::FrontEnd;
}

/// Whether the links of this server to the others and to IceStorm are under TLS.
bool linksAreTls(const ServerSettings& settings) {
    return settings.role != ServerRole::Both && parsed(settings.topic_endpoint).front().tls;
}

std::string issueOwn(const ServerSettings& settings) {
    return std::string("axon certs issue --") + toString(ownKind(settings)) + " " + settings.name + " HOST…";
}

/// Its own certificate, by which the others know it; one that only IceSSL finds is left to the others.
void checkOwnCertificate(const ServerSettings& settings) {
    const auto value = [&](const char* key) {
        const auto found = settings.ice_properties.find(key);
        return found == settings.ice_properties.end() ? std::string() : found->second;
    };
    const auto file = value("IceSSL.CertFile");
    if (file.empty()) return;
    std::vector<certificates::Certificate> its;
    try {
        its = certificates::readCertificateFile(std::filesystem::path(value("IceSSL.DefaultDir")) / file);
    } catch (const certificates::Unusable& unusable) {
        throw std::runtime_error(std::string(unusable.what()) + "; fix: " + unusable.fix());
    }
    const auto wrong = certificates::mismatch(its.front(), ownKind(settings), settings.name);
    if (!wrong.empty())
        throw std::runtime_error(
            "the links to the other servers are under TLS, and the certificate of this "
            "server (IceSSL.CertFile=" +
            file + ") " + wrong + "; fix: " + issueOwn(settings) + ", and use its configuration file");
}

/// Reads proxies as Ice does with these properties; calls nobody.
Ice::InitializationData readerOf(const std::map<std::string, std::string>& properties) {
    Ice::InitializationData init;
    init.properties = Ice::createProperties();
    for (const auto& [name, value] : properties)
        if (name.rfind("Ice.Default.", 0) == 0) init.properties->setProperty(name, value);
    init.properties->setProperty("Ice.Plugin.IceSSL", "IceSSL:createIceSSL");  // it reads ssl
    return init;
}

/// The endpoints of a proxy.
std::vector<transport::Endpoint> calledBy(const std::string& key, const std::string& text,
                                          Ice::Communicator& reader) {
    std::vector<transport::Endpoint> all;
    bool known = false;  // each has an address
    try {
        if (const auto proxy = reader.stringToProxy(text)) {
            all = transport::endpointsOf(*proxy);
            known = all.size() == proxy->ice_getEndpoints().size();
        }
    } catch (const Ice::Exception&) {
        all.clear();
    }
    if (all.empty() || !known)
        throw std::runtime_error(
            key + ": '" + text +
            "' is not a proxy with an address; expected endpoints of tcp or ssl, such as "
            "ssl -h HOST -p PORT");
    return all;
}

/// Whom this server calls by configuration. Over TLS it has to show who it is.
void checkCalled(const std::string& key, const std::string& text, Ice::Communicator& reader, bool tls) {
    const bool storm = key == "Server.TopicManager";
    for (const auto& one : calledBy(key, text, reader)) {
        // IceStorm calls the ports for the other servers, which are all under TLS, or none.
        if (one.tls != tls && (tls || storm))
            throw std::runtime_error(key + ": '" + text + "': expected " + (tls ? "ssl" : "tcp") +
                                     " as at the ports for the other servers (FrontEndServerTopic.Endpoints, "
                                     "EntityServerTopic.Endpoints …)" +
                                     (storm ? ", because IceStorm calls those" : "") +
                                     "; fix: use TLS for all of them, or for none");
        const bool here = one.host.empty() || one.host == "localhost" || isLoopback(one.host);
        if (!one.tls && !here)
            throw std::runtime_error(
                key + ": '" + text + "': " + (storm ? "IceStorm" : "this server") +
                " is believed whatever it says, and without TLS anybody in the network could speak in its "
                "place; fix: run it on this machine (-h 127.0.0.1), or use TLS for all links between servers "
                "(docs/reference/server_configuration.md#links-between-servers-over-tls)");
    }
}

void checkPeers(const ServerSettings& settings, bool tls) {
    if (settings.topic_manager.empty() && settings.neighbours.empty()) return;
    const Ice::CommunicatorHolder reader(readerOf(settings.ice_properties));
    if (!settings.topic_manager.empty())
        checkCalled("Server.TopicManager", settings.topic_manager, *reader.communicator(), tls);
    for (const auto& [name, proxy] : settings.neighbours)
        checkCalled("Server.Peer." + name, proxy, *reader.communicator(), tls);
}

/// Where the others are told to call: as where it listens, or they would call without TLS.
void checkPublished(const ServerSettings& settings, bool tls) {
    const std::string kind = settings.role == ServerRole::Entity ? "EntityServer" : "FrontEndServer";
    for (const auto* lane : {"Topic", "TopicSignal"}) {
        const auto key = kind + lane + ".PublishedEndpoints";
        const auto found = settings.ice_properties.find(key);
        if (found == settings.ice_properties.end() || found->second.empty()) continue;
        for (const auto& one : parsed(found->second))
            if (one.tls != tls)
                throw std::runtime_error(
                    key + ": '" + found->second + "': expected " + (tls ? "ssl" : "tcp") +
                    ", as where this server listens for the others (" + kind + lane +
                    ".Endpoints); fix: begin each endpoint with " + (tls ? "ssl" : "tcp"));
    }
}

/// Routers on this machine may come without TLS, if they run as the server's user.
void checkRouters(const ServerSettings& settings) {
    const auto& endpoints = settings.role == ServerRole::Entity ? settings.entity_router_endpoint
                                                                : settings.client_router_endpoint;
    if (endpoints.empty()) return;
    for (const auto& one : parsed(endpoints))
        if (!one.tls && one.host != "localhost" && !isLoopback(one.host))
            throw std::runtime_error(
                "'" + one.address() +
                "' is for routers, and the links between servers are under TLS: without TLS, expected an "
                "address that only this machine can reach; fix: use one such as 127.0.0.1:10424, or "
                "ssl://HOST:PORT");
}

/// What comes from another server is believed without a password. So who it is must be known: by TLS, or
/// because nobody else can reach these ports; Server.PlainTcp is about passwords, and opens none of them.
void checkBetweenServers(const ServerSettings& settings) {
    if (settings.role == ServerRole::Both) return;
    const bool tls = linksAreTls(settings);
    for (const auto& endpoints : {settings.topic_endpoint, settings.topic_signal_endpoint}) {
        for (const auto& one : parsed(endpoints)) {
            if (one.tls != tls)
                throw std::runtime_error(
                    "'" + settings.topic_endpoint + "' and '" + settings.topic_signal_endpoint +
                    "' are for the other servers: expected TLS for all of these endpoints, or for none; fix: "
                    "begin each with ssl, or none");
            if (one.tls) continue;
            try {
                checkEndpoints(one.address(), false, false);
            } catch (const std::runtime_error&) {
                throw std::runtime_error(
                    "'" + one.address() +
                    "' is for the other servers, which need no password: without TLS, expected an address "
                    "that only this machine can reach; fix: use one such as 127.0.0.1:0, or "
                    "ssl://HOST:PORT with a certificate of this server (" +
                    issueOwn(settings) +
                    "); Server.PlainTcp does not open this port, because anybody who reaches it could move "
                    "every robot");
            }
        }
    }
    checkPublished(settings, tls);
    if (!tls) return checkPeers(settings, tls);
    checkRouters(settings);
    if (!transport::speaksTls(settings.ice_properties))
        throw std::runtime_error(
            "'" + settings.topic_endpoint +
            "' is a TLS endpoint, but no certificate is configured (IceSSL.CertFile); fix: " +
            issueOwn(settings) + ", which writes a configuration file for --config");
    const auto verifies = settings.ice_properties.find("IceSSL.VerifyPeer");
    if (verifies != settings.ice_properties.end() && !verifies->second.empty() && verifies->second != "1" &&
        verifies->second != "2")
        throw std::runtime_error(
            "IceSSL.VerifyPeer=" + verifies->second +
            ": the links between servers are under TLS, and nobody may go unverified; expected 2, or 1 if "
            "clients may log in without a certificate");
    checkOwnCertificate(settings);
    checkPeers(settings, tls);
}

std::string hostOf(const transport::Endpoint& endpoint) {
    return endpoint.host == "localhost" ? "127.0.0.1" : endpoint.host;
}

/// A browser opens no WebSocket without TLS from a page that came by TLS, and the other way round the page
/// could be changed on its way. A page may connect to the host that it came from, and the server is told
/// there who it is.
void checkConsole(const ConsoleSettings& console, bool has_users) {
    if (console.endpoint.empty()) return;
    if (!console.proxies.empty() && !has_users)
        throw std::runtime_error(
            "Console.Proxies is set, and the server has no users: whoever reaches the proxy could move the "
            "robots; fix: name who may log in (axon-server --users FILE --add-user NAME --user-role ROLE, "
            "then --users FILE), or leave Console.Proxies out");
    const auto pages = parsed(console.endpoint);
    const std::pair<const char*, const std::string&> others[] = {
        {"ConsoleSession.Endpoints", console.session_endpoint},
        {"ConsoleSignal.Endpoints", console.signal_endpoint}};
    for (const auto& [key, text] : others) {
        const auto its = text.empty() ? std::vector<transport::Endpoint>{} : parsed(text);
        if (pages.size() != 1 || its.size() != 1)
            throw std::runtime_error("Console.Endpoints ('" + console.endpoint + "'), " + key + " ('" + text +
                                     "'): expected one endpoint each");
        if (pages[0].tls != its[0].tls)
            throw std::runtime_error(
                "'" + console.endpoint + "' and '" + text +
                "': expected TLS for both the console's pages and its sessions, or for neither; fix: begin "
                "Console.Endpoints, ConsoleSession.Endpoints and ConsoleSignal.Endpoints with ssl://");
        if (hostOf(pages[0]) != hostOf(its[0]))
            throw std::runtime_error(
                std::string("Console.Endpoints is at ") + pages[0].host + " and " + key + " at " +
                its[0].host +
                ": expected one host, because a page of the console may open sessions only at the address "
                "that it came from; fix: give both the same host, such as " +
                key + "=" + transport::Endpoint{pages[0].host, its[0].port, its[0].tls}.address());
    }
}

std::shared_ptr<const users::Users> usersOf(const ServerSettings& settings) {
    checkBetweenServers(settings);
    checkConsole(settings.console, !settings.users_file.empty());
    const bool has_users = !settings.users_file.empty();
    bool open = false;
    for (const auto& endpoint : endpointsOf(settings)) {
        open = checkEndpoints(endpoint, has_users, settings.plain_tcp) || open;
        for (const auto& one : parsed(endpoint))
            if (one.tls && !transport::speaksTls(settings.ice_properties))
                throw std::runtime_error(transport::certificateMissing(one.address(), "server"));
    }
    if (settings.role != ServerRole::Entity)
        checkLanes(settings.client_endpoint, settings.client_signal_endpoint);
    if (settings.role != ServerRole::FrontEnd)
        checkLanes(settings.entity_endpoint, settings.entity_signal_endpoint);
    if (open) {
        spdlog::warn(
            "other machines can reach this server without TLS (Server.PlainTcp); what they send, passwords "
            "included, can be read and changed on the way; fix: use it only in a network that you trust, or "
            "listen over TLS");
    }
    if (!has_users) return nullptr;
    auto its = std::make_shared<const users::Users>(users::Users::read(settings.users_file));
    note("users: " + users::summaryOf(*its, settings.users_file));
    return its;
}

transport::CommunicatorSettings communicatorSettings(const ServerSettings& settings, Lane lane) {
    transport::CommunicatorSettings its;
    its.lane = lane;
    its.name = lane == Lane::Signal ? "axon-signal" : "axon-data";
    // Of each adapter, which has a pool of its own (transport::listen): what comes from clients does not wait
    // for what comes from entities.
    its.server_threads = lane == Lane::Signal ? settings.signal_threads : settings.data_threads;
    for (const auto& [key, value] : settings.ice_properties) its.properties[key] = value;
    return its;
}

std::string routerEndpoint(const std::string& endpoint) {
    return endpoint.empty() ? endpoint : iceForm(endpoint);
}

std::string named(const char* name, const std::string& address) {
    return address.empty() ? address : name + address;
}

constexpr int kBrowserSizeMaxKib = 512;

/// Connections that browsers have without a session. They are counted apart from those of other clients, who
/// keep theirs whatever browsers do. Behind a proxy all have one address.
transport::ConnectionBounds browserBounds(const ConsoleSettings& console) {
    transport::ConnectionBounds its;
    its.to_log_in = console.to_log_in;
    its.strangers = 256;
    its.strangers_of_one_address = console.proxies.empty() ? 64 : its.strangers;
    return its;
}

/// Of the console's sessions. A browser that is asked for a certificate gives up.
transport::CommunicatorSettings browserSettings(const ServerSettings& settings, Lane lane) {
    auto its = communicatorSettings(settings, lane);
    its.name = lane == Lane::Signal ? "axon-br-signal" : "axon-browsers";
    its.properties["IceSSL.VerifyPeer"] = "0";
    // Of what a page sends, and of its request for a WebSocket. The largest are chunks of files, of 64 KiB,
    // and texts that are parameters of tasks.
    its.properties.emplace("Ice.MessageSizeMax", std::to_string(kBrowserSizeMaxKib));
    // What one browser sends, or somebody who never ends a request, does not keep the others waiting.
    its.server_threads =
        lane == Lane::Signal ? std::max(2, settings.signal_threads) : std::max(4, settings.data_threads);
    return its;
}

/// "HOST:PORT" as Ice listens there for WebSockets.
std::string socketForm(const std::string& endpoint) {
    const auto its = parsed(endpoint).at(0);
    return std::string(its.tls ? "wss" : "ws") + " -h " + its.host + " -p " + std::to_string(its.port);
}

/// What comes from the entities' signal lane are receipts and signs of life, which give way to stops.
transport::CommunicatorSettings receiptSettings(const ServerSettings& settings) {
    auto its = communicatorSettings(settings, Lane::Signal);
    its.name = "axon-receipts";
    its.priority = transport::kReceiptPriority;
    return its;
}

/// The entity server as the front-end server of this process sees it, and the reverse: plain calls.
class EntitiesHere final : public front_end_server::EntityTopic {
  public:
    void set(entity_server::EntityServerCore& core) { core_ = &core; }
    Result<void> clientMsg(const std::string&, const Header& head, std::string_view message) override {
        core_->clientMsg(head, message);
        return {};
    }
    void clientMsgDataSeq(const std::string&, const Header& head, std::string_view data) override {
        core_->clientMsgDataSeq(head, data);
    }
    void clientRequest(const Header& head) override { core_->clientRequest(head); }
    void clientUpdate(const Header& head, ClientChange change) override { core_->clientUpdate(head, change); }
    void stopSignal(const Header& head, StopCause cause) override { core_->stopSignal(head, cause); }
    void stopSignals(const Header& head, const std::vector<std::string>& entities, StopCause cause) override {
        core_->stopSignals(head, entities, cause);
    }
    void resetSignal(const Header& head) override { core_->resetSignal(head); }
    void clearSignal(const Header& head) override { core_->clearSignal(head); }

  private:
    entity_server::EntityServerCore* core_ = nullptr;
};

class ClientsHere final : public entity_server::FrontEndTopic {
  public:
    void set(front_end_server::FrontEndCore& core) { core_ = &core; }
    void entityBasicPrflUpdate(Presence presence, const Registration& registration,
                               std::string_view profile) override {
        core_->entityBasicPrflUpdate(presence, registration, profile);
    }
    void entityUpdate(const EntityStatus& status, std::int64_t) override { core_->entityUpdate(status); }
    void entityMsg(Lane lane, const Header& head, std::string_view message) override {
        core_->entityMsg(lane, head, message);
    }
    void entityMsgDataSeq(const Header& head, std::string_view data) override {
        core_->entityMsgDataSeq(head, data);
    }
    void entityRefusal(Lane lane, const Header& head, const Refusal& refusal) override {
        core_->entityRefusal(lane, head, refusal);
    }

  private:
    front_end_server::FrontEndCore* core_ = nullptr;
};

/// What both kinds of server are told alike: their name, and where the others and routers find them.
template <class Its>
void placeAmongServers(Its& its, const ServerSettings& settings, const std::string& router_endpoint,
                       transport::LinkTrust* links) {
    if (settings.role != ServerRole::Both) its.core.name = settings.name;
    its.topic_endpoint = iceForm(settings.topic_endpoint);
    its.topic_signal_endpoint = iceForm(settings.topic_signal_endpoint);
    its.router_endpoint = routerEndpoint(router_endpoint);
    its.name = settings.name;
    its.neighbours = settings.neighbours;
    its.links = links;
    if (settings.watchdog != nullptr) its.turned = settings.watchdog->worker();
}

front_end_server::FrontEndServerSettings frontEndSettings(const ServerSettings& settings,
                                                          transport::LinkTrust* links) {
    front_end_server::FrontEndServerSettings its;
    its.core = settings.front_end;
    its.data_endpoint = iceForm(settings.client_endpoint);
    its.signal_endpoint = iceForm(settings.client_signal_endpoint);
    placeAmongServers(its, settings, settings.client_router_endpoint, links);
    return its;
}

entity_server::EntityServerSettings entitySettings(const ServerSettings& settings,
                                                   transport::LinkTrust* links) {
    entity_server::EntityServerSettings its;
    its.core = settings.entity;
    its.data_endpoint = iceForm(settings.entity_endpoint);
    its.signal_endpoint = iceForm(settings.entity_signal_endpoint);
    placeAmongServers(its, settings, settings.entity_router_endpoint, links);
    return its;
}

}  // namespace

namespace {

std::unique_ptr<audit::Trail> trailOf(const ServerSettings& settings) {
    if (settings.audit.folder.empty()) return nullptr;
    const auto name = "axon-server" + (settings.name.empty() ? std::string() : "-" + settings.name);
    return std::make_unique<audit::Trail>(settings.audit, name, name + " " + kRelease,
                                          [](const std::string& line) { spdlog::warn("{}", line); });
}

std::unique_ptr<transport::LinkTrust> trustOf(const ServerSettings& settings, const Clock& clock,
                                              audit::AuditTrail* trail) {
    const bool tls = linksAreTls(settings);
    if (settings.role != ServerRole::Both)
        note(tls ? "the links to the other servers are under TLS"
                 : "the links to the other servers are without TLS, on this machine only");
    if (!tls) return nullptr;
    return std::make_unique<transport::LinkTrust>(
        clock, [](const std::string& line) { spdlog::warn("{}", line); }, trail);
}

}  // namespace

class Server::Parts {
  public:
    explicit Parts(const ServerSettings& settings)
        : trail(trailOf(settings)),
          first_users(usersOf(settings)),
          logins(
              first_users, clock, note,
              [](const std::string& peer, const std::string& local) { return socketOwner(peer, local); },
              trail.get()),
          links(trustOf(settings, steady, trail.get())),
          data(transport::makeCommunicator(communicatorSettings(settings, Lane::Data))),
          signal(transport::makeCommunicator(communicatorSettings(settings, Lane::Signal))),
          receipts(transport::makeCommunicator(receiptSettings(settings))) {
        const bool both = settings.role == ServerRole::Both;
        for (const auto* one : {&data, &signal, &receipts}) watchStrangers(one->communicator(), links.get());
        if (settings.role != ServerRole::FrontEnd) {
            auto its = entitySettings(settings, links.get());
            its.logins = &logins;
            its.audit = trail.get();
            its.users = first_users ? &logins : nullptr;
            its.limits = &limits;
            its.here = both ? &clients_here : nullptr;
            its.topic_signals = signal.communicator();  // stops
            entity.emplace(its, data.communicator(), receipts.communicator(), clock, random, note);
        }
        if (settings.role != ServerRole::Entity) {
            auto its = frontEndSettings(settings, links.get());
            its.logins = &logins;
            its.audit = trail.get();
            its.users = first_users ? &logins : nullptr;
            its.limits = &limits;
            if (!settings.global_services.empty()) {
                services_folder.emplace(settings.global_services, clock, note);
                its.global_services = &*services_folder;
            }
            its.here = both ? &entities_here : nullptr;
            its.topic_signals = receipts.communicator();
            front_end.emplace(its, data.communicator(), signal.communicator(), clock, random, note);
        }
        if (front_end && !settings.console.endpoint.empty()) openConsole(settings);
        if (!settings.console.left_out.empty()) leftOut(settings.console.left_out);
        if (both) {
            clients_here.set(front_end->core());
            entities_here.set(entity->core());
        }
        if (entity) entity->activate();
        if (front_end) front_end->activate();
        if (first_users)
            users_watch.emplace(
                settings.users_file, first_users, clock, note,
                [this](std::shared_ptr<const users::Users> users) { take(std::move(users)); });
        if (services_folder || users_watch)
            files_timer.emplace("axon-files", Lane::Data, global_services::ServicesFolder::kPeriod, clock,
                                [this] { return lookForFiles(); });
        if (!settings.topic_manager.empty()) joinTopics(settings.topic_manager);
    }

    ~Parts() {
        files_timer.reset();  // it calls what follows
        if (front_end) front_end->core().shutDown();
        topics.reset();
        logins.close();  // a communicator waits for calls that are not answered
        limits.close();  // and for peers that are silent
        if (browser_limits) browser_limits->close();
        // First the threads that call the cores, then the cores.
        data.communicator()->destroy();
        signal.communicator()->destroy();
        receipts.communicator()->destroy();
        closeBrowsers();
        if (entity) entity->end();
        if (front_end) front_end->end();
    }

    /// Whether the files of the administrator have changed.
    TimePoint lookForFiles() {
        auto next = clock.now() + std::chrono::hours{1};
        if (services_folder) next = std::min(next, services_folder->onTimer());
        if (users_watch) next = std::min(next, users_watch->onTimer());
        return next;
    }

    /// First who may come in, then who may stay: whoever comes in between is asked again by the cores.
    void take(std::shared_ptr<const users::Users> users) {
        const auto before = std::exchange(users_here, users);
        logins.setUsers(users);
        if (console) console->usersChanged(*before, *users);
        if (front_end) front_end->core().usersChanged();
        if (entity) entity->core().usersChanged();
    }

    /// A console that nobody has asked for is no reason not to start: the robots need the server.
    void openConsole(const ServerSettings& settings) {
        try {
            console.emplace(settings.console, settings.ice_properties, logins, !settings.users_file.empty(),
                            steady, random, note);
            browser_limits.emplace(
                steady, [this](const std::string& line) { noteClosed(line); },
                browserBounds(settings.console));
            browsers.emplace(transport::makeCommunicator(browserSettings(settings, Lane::Data)));
            browser_signals.emplace(transport::makeCommunicator(browserSettings(settings, Lane::Signal)));
            for (const auto* one : {&*browsers, &*browser_signals})
                watchStrangers(one->communicator(), nullptr);
            transport::DoorSettings door;
            door.data = {socketForm(settings.console.session_endpoint), browsers->communicator(),
                         &console->logins()};
            door.signal = {socketForm(settings.console.signal_endpoint), browser_signals->communicator(),
                           &console->signals()};
            door.signal_endpoint = [this](const std::string& local,
                                          const std::optional<std::string>& origin) {
                return console->signalEndpoint(local, origin);
            };
            door.limits = &*browser_limits;
            console_ports = front_end->listenToBrowsers(door);
            console->serve(console_ports);
        } catch (const std::runtime_error& error) {
            closeBrowsers();
            if (settings.console.required) throw;
            leftOut(error.what());
            front_end->closeToBrowsers();
            console_ports = {};
            console.reset();
            browser_limits.reset();
        }
    }

    static void leftOut(std::string why) {
        std::replace(why.begin(), why.end(), '\n', ' ');  // Ice's reasons have two lines
        spdlog::warn("the web console is left out: {}", why);
    }

    void closeBrowsers() {
        if (browsers) browsers->communicator()->destroy();
        if (browser_signals) browser_signals->communicator()->destroy();
    }

    /// Each kind listens to the other one's topic. An entity server has something to say on both: messages of
    /// its entities to those of other entity servers go the way of the clients'.
    void joinTopics(const std::string& manager) {
        transport::StormSettings its;
        its.manager = manager;
        its.links = links.get();
        if (entity) {
            its.subscribe_to = transport::kFrontEndToEntityTopic;
            its.publish_to = {transport::kEntityToFrontEndTopic, transport::kFrontEndToEntityTopic};
        } else {
            its.subscribe_to = transport::kEntityToFrontEndTopic;
            its.publish_to = {transport::kFrontEndToEntityTopic};
        }
        its.subscriber = entity ? entity->subscriber() : front_end->subscriber();
        topics.emplace(
            its, data.communicator(), clock,
            [this](const std::vector<std::string>& publishers) {
                if (publishers.empty()) return publishTo({}, {});
                if (entity) return publishTo({publishers[0]}, {publishers[1]});
                publishTo({}, {publishers[0]});
            },
            note);
    }

    void publishTo(const std::vector<std::string>& front_ends,
                   const std::vector<std::string>& entity_servers) {
        if (entity) entity->publishTo(front_ends, entity_servers);
        if (front_end) front_end->publishTo(entity_servers);
    }

    /// What the bounds of strangers' connections have closed: into the log, and into the trail.
    void noteClosed(const std::string& line) const {
        note(line);
        audit::orNone(trail.get())
            .note({.kind = audit::Kind::Refusal,
                   .what = line,
                   .outcome = refusalName(RefusalCode::Overloaded)});
    }
    /// Who does not speak the protocol of the port: into the log, and into the trail.
    void noteBroken(const std::string& peer, const std::string& adapter, const std::string& why) {
        const auto what = "a connection to " + adapter;
        if (broken_lines.admit(steady.now()))
            note("audit: " + what + " from " + peer + " was closed: " + why);
        logins.turnedAway(peer, what, {RefusalCode::Malformed, why, {}});
    }
    /// Those that are refused before they say anything, into the trail; the log has them. And those that then
    /// do not speak Ice.
    void watchStrangers(const std::shared_ptr<Ice::Communicator>& communicator,
                        transport::LinkTrust* its_links) {
        transport::onBrokenProtocol(communicator,
                                    [this](const std::string& peer, const std::string& adapter,
                                           const std::string& why) { noteBroken(peer, adapter, why); });
        const auto refused = [this](const std::string& peer, const std::string& why) {
            logins.turnedAway(peer, "a TLS handshake", {RefusalCode::PermissionDenied, why, {}});
        };
        if (its_links != nullptr) return its_links->guard(communicator, refused);
        transport::onRefused(communicator, [refused](const std::string& peer, const std::string&,
                                                     const std::string& why) { refused(peer, why); });
    }

    const std::unique_ptr<audit::Trail> trail;  // null: nothing is recorded. Outlives all that notes
    const std::shared_ptr<const Clock> time = clockFromEnvironment();
    const Clock& clock = *time;
    const SteadyClock steady{};  // of what peers cost, also where the laboratory's time stands
    RateLimit broken_lines{10};  // of the log, in a second
    transport::ConnectionLimits limits{steady, [this](const std::string& line) { noteClosed(line); }};
    std::optional<transport::ConnectionLimits> browser_limits;  // where there is a console
    SystemRandom random;
    const std::shared_ptr<const users::Users> first_users;        // null: there are none
    std::shared_ptr<const users::Users> users_here{first_users};  // confined to axon-files
    LoginDesk logins;
    const std::unique_ptr<transport::LinkTrust> links;  // null but where those to other servers are under TLS
    Ice::CommunicatorHolder data;
    Ice::CommunicatorHolder signal;
    Ice::CommunicatorHolder receipts;
    std::optional<ConsoleStation> console;
    std::optional<Ice::CommunicatorHolder> browsers, browser_signals;  // where there is a console
    transport::DoorPorts console_ports;
    ClientsHere clients_here;
    EntitiesHere entities_here;
    std::optional<global_services::ServicesFolder> services_folder;  // none in an entity server's process
    std::optional<entity_server::EntityServer> entity;               // none in a front-end server's process
    std::optional<front_end_server::FrontEndServer> front_end;       // none in an entity server's process
    std::optional<transport::StormTopics> topics;
    std::optional<users::UsersWatch> users_watch;
    std::optional<transport::TimerThread> files_timer;  // where there is a file to look for
};

Server::Server(ServerSettings settings) : parts_(std::make_unique<Parts>(settings)) {}

Server::~Server() = default;

std::string Server::subscriber() const {
    return parts_->entity ? parts_->entity->subscriber() : parts_->front_end->subscriber();
}
void Server::publishTo(const std::vector<std::string>& front_ends,
                       const std::vector<std::string>& entity_servers) {
    parts_->publishTo(front_ends, entity_servers);
}

std::string Server::clientAddress(Lane lane) const {
    return parts_->front_end.value().address(lane);
}
std::string Server::entityAddress(Lane lane) const {
    return parts_->entity.value().address(lane);
}

std::string Server::clientRouterAddress() const {
    return parts_->front_end ? parts_->front_end->routerAddress() : std::string();
}
std::string Server::entityRouterAddress() const {
    return parts_->entity ? parts_->entity->routerAddress() : std::string();
}

std::string Server::consoleAddress() const {
    return parts_->console ? parts_->console->address() : std::string();
}
std::uint16_t Server::consoleSessionPort(Lane lane) const {
    return lane == Lane::Signal ? parts_->console_ports.signal : parts_->console_ports.data;
}

std::string Server::readyLine() const {
    std::string line = "ready";
    if (parts_->front_end)
        line += " client=" + clientAddress(Lane::Data) + " client-signal=" + clientAddress(Lane::Signal);
    if (parts_->entity)
        line += " entity=" + entityAddress(Lane::Data) + " entity-signal=" + entityAddress(Lane::Signal);
    return line + named(" client-router=", clientRouterAddress()) +
           named(" entity-router=", entityRouterAddress()) + named(" console=", consoleAddress());
}

std::vector<std::string> Server::margins() const {
    std::vector<std::string> lines;
    if (parts_->front_end) lines = parts_->front_end->core().margins();
    if (parts_->entity) {
        for (auto& line : parts_->entity->core().margins()) lines.push_back(std::move(line));
    }
    if (parts_->links)
        lines.push_back("links between servers: " + std::to_string(parts_->links->refused()) +
                        " connections and calls were refused");
    return lines;
}

entity_server::EntityServerCore& Server::entityCore() {
    return parts_->entity.value().core();
}
front_end_server::FrontEndCore& Server::frontEndCore() {
    return parts_->front_end.value().core();
}

}  // namespace axon::server
