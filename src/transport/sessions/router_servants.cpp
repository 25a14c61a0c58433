// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/sessions/router_servants.hpp"

#include <spdlog/spdlog.h>

#include <future>
#include <optional>
#include <stdexcept>
#include <utility>

#include "certificates/certificate.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"
#include "transport/ice/gate_calls.hpp"
#include "transport/ice/tls.hpp"
#include "transport/sessions/router_address.hpp"

namespace axon::transport {
namespace {

/// One waits for a password, a second for a neighbour that waits for us, and some are left.
constexpr int kThreads = 8;

[[noreturn]] void cannotCreate(const std::string& reason) {
    throw Glacier2::CannotCreateSessionException(reason);
}

}  // namespace

namespace {

/// Who the router has seen; it has verified the certificate.
std::optional<PeerCertificate> certificateIn(const Glacier2::SSLInfo& info) {
    if (info.certs.empty()) return std::nullopt;
    try {
        auto its = certificates::readCertificates(info.certs.front(), "the peer's certificate").front();
        return PeerCertificate{std::move(its.name), std::move(its.unit)};
    } catch (const std::exception&) {  // verified by one library and not understood by the other
        return PeerCertificate{};
    }
}

bool mayComeIn(const RouterDoor& door, LoginRequest request, std::string& reason,
               const Ice::Current& current) {
    if (const auto may = door.routers.admit(current.con); !may) {
        spdlog::warn("audit: somebody was to be verified for {}, which was refused: {}",
                     DirectConnection::peerOf(*current.con), may.refusal().message);
        door.routers.turnedAway(*current.con, "the log-in of somebody behind a router", may.refusal());
        throw Glacier2::PermissionDeniedException(may.refusal().message);
    }
    auto answer = std::make_shared<std::promise<Result<LoggedIn>>>();
    auto answered = answer->get_future();
    request.peer = DirectConnection::peerOf(*current.con);
    request.local = DirectConnection::localOf(*current.con);
    if (request.behind_router.empty()) request.behind_router = routerAddress(current.ctx);
    door.verify(std::move(request), [answer](Result<LoggedIn> who) { answer->set_value(std::move(who)); });
    const auto who = answered.get();
    if (!who) reason = who.refusal().message;
    return who.ok();
}

/// The session manager of the other server `name`: over TLS by the connection over which it has shown that it
/// is this server. Throws what Ice throws, and CannotCreateSessionException where it is somebody else.
std::shared_ptr<Glacier2::SessionManagerPrx> verified(
    const std::shared_ptr<Glacier2::SessionManagerPrx>& neighbour, const std::string& name,
    const RouterDoor& door) {
    // One that is cached would be returned also when it is closed.
    const auto over = neighbour->ice_connectionCached(false)->ice_getConnection();
    if (!over || !isTls(*over)) return neighbour;
    const auto why = notServer(*over, door.routers.ownKind(), name);
    // That of a server without a kind of its own has the name of its machine.
    const bool of_machine = door.links == nullptr && !notServer(*over, certificates::Kind::Server, {});
    if (why && !of_machine) {
        over->close(Ice::ConnectionClose::Forcefully);
        const auto called = "the server at Server.Peer." + name;
        if (door.links != nullptr) door.links->noteWrongServer(called, *why);
        cannotCreate(called + " is not used: the certificate that it shows " + *why +
                     "; fix: compare the address with that of the server whose Server.Name is " + name);
    }
    return Ice::uncheckedCast<Glacier2::SessionManagerPrx>(over->createProxy(neighbour->ice_getIdentity()));
}

/// `pass_on(neighbour)` asks the server that has the other lane's session.
template <class PassOn>
std::shared_ptr<Glacier2::SessionPrx> createSession(
    const RouterDoor& door, const std::string& user, const std::optional<PeerCertificate>& certificate,
    const std::shared_ptr<Glacier2::SessionControlPrx>& control, const Ice::Current& current,
    PassOn pass_on) {
    if (const auto may = door.routers.admit(current.con); !may) {
        spdlog::warn("audit: a session was asked for by {}, which was refused: {}",
                     DirectConnection::peerOf(*current.con), may.refusal().message);
        door.routers.turnedAway(*current.con, "a session behind a router", may.refusal());
        cannotCreate(may.refusal().message);
    }
    if (const auto other = otherContract(current.ctx)) {
        door.routers.turnedAway(*current.con, "a session behind a router", *other);
        cannotCreate(other->message);
    }
    if (!control)
        cannotCreate("the router has no way back: set Glacier2.Server.Endpoints in its configuration");
    const auto token = current.ctx.find(kContextToken);
    const bool signal = token != current.ctx.end();
    if (signal) {
        const auto slash = token->second.find('/');
        const auto server = slash == std::string::npos ? std::string() : token->second.substr(0, slash);
        if (!server.empty() && server != door.server) {
            const auto neighbour = door.neighbours.find(server);
            if (neighbour == door.neighbours.end())
                cannotCreate("this server knows no server " + server.substr(0, 64) +
                             ", whose token came with the request; give it Server.Peer." +
                             server.substr(0, 64));
            try {
                return pass_on(verified(neighbour->second, server, door));
            } catch (const Glacier2::CannotCreateSessionException&) {
                throw;
            } catch (const Ice::Exception&) {
                cannotCreate("the server " + server + ", which has the other session, does not answer: " +
                             translate(std::current_exception()).message);
            }
        }
    }
    auto who = door.vouched(user, certificate);
    if (!who) cannotCreate(who.refusal().message);
    const auto name = current.ctx.find(kContextName);
    const auto peer = std::make_shared<RoutedConnection>(control, door.routers, *current.con);
    try {
        auto session = door.open(signal ? Lane::Signal : Lane::Data, who.value(),
                                 name == current.ctx.end() ? std::string() : name->second, peer);
        // Of all objects behind the router the peer may call this one.
        control->identities()->add({session->ice_getIdentity()});
        if (!signal) door.note_release(releaseIn(current.ctx));
        return session;
    } catch (const std::exception&) {
        peer->disconnect({false, "its session could not be set up"}, false);
        const auto refusal = translate(std::current_exception());
        door.routers.turnedAway(*current.con, "a session behind a router", refusal);
        cannotCreate(refusal.message);
    }
}

}  // namespace

bool PermissionsVerifierServant::checkPermissions(std::string user, std::string password, std::string& reason,
                                                  const Ice::Current& current) const {
    return mayComeIn(door_, {std::move(user), std::move(password), {}, {}, {}}, reason, current);
}

bool CertificateVerifierServant::authorize(Glacier2::SSLInfo info, std::string& reason,
                                           const Ice::Current& current) const {
    auto certificate = certificateIn(info);
    if (!certificate) {
        reason =
            "no certificate was shown to the router; name a user and a password, or show one: axon certs "
            "issue";
        return false;
    }
    LoginRequest request;
    request.certificate = std::move(certificate);
    request.behind_router = routerAddress(info.remoteHost, std::to_string(info.remotePort));
    return mayComeIn(door_, std::move(request), reason, current);
}

std::shared_ptr<Glacier2::SessionPrx> SessionManagerServant::create(
    std::string user, std::shared_ptr<Glacier2::SessionControlPrx> control, const Ice::Current& current) {
    return createSession(door_, user, std::nullopt, control, current, [&](const auto& neighbour) {
        return neighbour->create(user, control, current.ctx);
    });
}

std::shared_ptr<Glacier2::SessionPrx> CertificateSessionManagerServant::create(
    Glacier2::SSLInfo info, std::shared_ptr<Glacier2::SessionControlPrx> control,
    const Ice::Current& current) {
    const auto certificate = certificateIn(info);
    if (!certificate) cannotCreate("no certificate was shown to the router");
    return createSession(door_, {}, certificate, control, current, [&](const auto& neighbour) {
        return Ice::uncheckedCast<Glacier2::SSLSessionManagerPrx>(
                   neighbour->ice_identity(Ice::stringToIdentity(kSslSessionManager)))
            ->create(info, control, current.ctx);
    });
}

std::shared_ptr<Ice::ObjectAdapter> listenForRouters(Ice::Communicator& communicator, const std::string& name,
                                                     const std::string& endpoint, RouterDoor& door) {
    // Until a router has called something (RouterConnections::admit()).
    auto adapter = listen(communicator, name, endpoint, kThreads, Idle::ClosedAfterASecond);
    const GateCalls::Told told = [&routers = door.routers](const Ice::Connection& connection,
                                                           const std::string& why) {
        routers.noteCall(DirectConnection::peerOf(connection), why);
    };
    const auto add = [&](std::shared_ptr<Ice::Object> servant, const char* name) {
        adapter->add(std::make_shared<GateCalls>(std::move(servant), told), Ice::stringToIdentity(name));
    };
    add(std::make_shared<PermissionsVerifierServant>(door), kPermissionsVerifier);
    add(std::make_shared<SessionManagerServant>(door), kSessionManager);
    add(std::make_shared<CertificateVerifierServant>(door), kSslPermissionsVerifier);
    add(std::make_shared<CertificateSessionManagerServant>(door), kSslSessionManager);
    adapter->addDefaultServant(std::make_shared<GateCalls>(nullptr, told), "");
    return adapter;
}

std::map<std::string, std::shared_ptr<Glacier2::SessionManagerPrx>> neighboursOf(
    const Ice::Communicator& communicator, const std::map<std::string, std::string>& proxies) {
    std::map<std::string, std::shared_ptr<Glacier2::SessionManagerPrx>> out;
    std::map<std::string, std::string> at;  // the name, by the address
    const auto unusable = [&](const std::string& name, const std::string& why) {
        return std::runtime_error("Server.Peer." + name + ": '" + proxies.at(name) + "' (" + why +
                                  "): expected the proxy of a session manager, such as "
                                  "SessionManager:tcp -h 127.0.0.1 -p 10434");
    };
    for (const auto& [name, proxy] : proxies) {
        try {
            const auto its = communicator.stringToProxy(proxy);
            if (!its) throw unusable(name, "it is empty");
            for (auto& one : endpointsOf(*its)) {
                if (one.host == "localhost") one.host = "127.0.0.1";
                const auto where = one.host + ":" + std::to_string(one.port);
                const auto [known, is_new] = at.emplace(where, name);
                if (!is_new && known->second != name)
                    throw std::runtime_error(
                        "Server.Peer." + known->second + " and Server.Peer." + name + " have one address, " +
                        where +
                        ": two servers cannot be there, and sessions of one would be "
                        "asked of the other; fix: give each the address of its own "
                        "FrontEndServerRouter.Endpoints or EntityServerRouter.Endpoints");
            }
            // Two names may still lead to one server, by two names of its machine: none is to end the
            // other's connection.
            out[name] =
                Ice::uncheckedCast<Glacier2::SessionManagerPrx>(its->ice_connectionId("peer " + name));
        } catch (const Ice::Exception& error) {
            throw unusable(name, error.ice_id());
        }
    }
    return out;
}

}  // namespace axon::transport
