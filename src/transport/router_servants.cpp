// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/router_servants.hpp"

#include <spdlog/spdlog.h>

#include <future>
#include <stdexcept>
#include <utility>

#include "transport/adapter.hpp"
#include "transport/communicator.hpp"
#include "transport/convert.hpp"

namespace axon::transport {
namespace {

/// One waits for a password, a second for a neighbour that waits for us, and some are left.
constexpr int kThreads = 8;

[[noreturn]] void cannotCreate(const std::string& reason) {
    throw Glacier2::CannotCreateSessionException(reason);
}

}  // namespace

bool PermissionsVerifierServant::checkPermissions(std::string user, std::string password, std::string& reason,
                                                  const Ice::Current& current) const {
    if (const auto may = door_.routers.admit(*current.con); !may) {
        spdlog::warn("audit: a password was to be verified for {}, which was refused: {}",
                     DirectConnection::peerOf(*current.con), may.refusal().message);
        throw Glacier2::PermissionDeniedException(may.refusal().message);
    }
    auto answer = std::make_shared<std::promise<Result<LoggedIn>>>();
    auto answered = answer->get_future();
    door_.verify({std::move(user), std::move(password), DirectConnection::peerOf(*current.con),
                  DirectConnection::localOf(*current.con)},
                 [answer](Result<LoggedIn> who) { answer->set_value(std::move(who)); });
    const auto who = answered.get();
    if (!who) reason = who.refusal().message;
    return who.ok();
}

std::shared_ptr<Glacier2::SessionPrx> SessionManagerServant::create(
    std::string user, std::shared_ptr<Glacier2::SessionControlPrx> control, const Ice::Current& current) {
    if (const auto may = door_.routers.admit(*current.con); !may) {
        spdlog::warn("audit: a session was asked for by {}, which was refused: {}",
                     DirectConnection::peerOf(*current.con), may.refusal().message);
        cannotCreate(may.refusal().message);
    }
    if (!control)
        cannotCreate("the router has no way back: set Glacier2.Server.Endpoints in its configuration");
    const auto token = current.ctx.find(kContextToken);
    const bool signal = token != current.ctx.end();
    if (signal) {
        const auto slash = token->second.find('/');
        const auto server = slash == std::string::npos ? std::string() : token->second.substr(0, slash);
        if (!server.empty() && server != door_.server) {
            const auto neighbour = door_.neighbours.find(server);
            if (neighbour == door_.neighbours.end())
                cannotCreate("this server knows no server " + server.substr(0, 64) +
                             ", whose token came with the request; give it Server.Peer." +
                             server.substr(0, 64));
            try {
                return neighbour->second->create(user, control, current.ctx);
            } catch (const Glacier2::CannotCreateSessionException&) {
                throw;
            } catch (const Ice::Exception&) {
                cannotCreate("the server " + server + ", which has the other session, does not answer: " +
                             translate(std::current_exception()).message);
            }
        }
    }
    auto who = door_.vouched(user);
    if (!who) cannotCreate(who.refusal().message);
    const auto name = current.ctx.find(kContextName);
    const auto peer = std::make_shared<RoutedConnection>(control, door_.routers, *current.con);
    try {
        auto session = door_.open(signal ? Lane::Signal : Lane::Data, who.value(),
                                  name == current.ctx.end() ? std::string() : name->second, peer);
        // Of all objects behind the router the peer may call this one.
        control->identities()->add({session->ice_getIdentity()});
        return session;
    } catch (const std::exception&) {
        peer->disconnect({false, "its session could not be set up"}, false);
        cannotCreate(translate(std::current_exception()).message);
    }
}

std::shared_ptr<Ice::ObjectAdapter> listenForRouters(Ice::Communicator& communicator, const std::string& name,
                                                     const std::string& endpoint, RouterDoor& door) {
    auto adapter = listen(communicator, name, endpoint, kThreads);
    adapter->add(std::make_shared<PermissionsVerifierServant>(door),
                 Ice::stringToIdentity(kPermissionsVerifier));
    adapter->add(std::make_shared<SessionManagerServant>(door), Ice::stringToIdentity(kSessionManager));
    return adapter;
}

std::map<std::string, std::shared_ptr<Glacier2::SessionManagerPrx>> neighboursOf(
    const Ice::Communicator& communicator, const std::map<std::string, std::string>& proxies) {
    std::map<std::string, std::shared_ptr<Glacier2::SessionManagerPrx>> out;
    for (const auto& [name, proxy] : proxies) {
        try {
            out[name] = Ice::uncheckedCast<Glacier2::SessionManagerPrx>(communicator.stringToProxy(proxy));
        } catch (const Ice::Exception& error) {
            throw std::runtime_error("Server.Peer." + name + ": '" + proxy + "' (" + error.ice_id() +
                                     "): expected the proxy of a session manager, such as "
                                     "SessionManager:tcp -h 127.0.0.1 -p 10434");
        }
    }
    return out;
}

}  // namespace axon::transport
