// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Glacier2/PermissionsVerifier.h>
#include <Glacier2/Session.h>
#include <Ice/Ice.h>

#include <functional>
#include <map>
#include <memory>
#include <string>

#include "common/routed.hpp"
#include "transport/ice/link_trust.hpp"
#include "transport/ice/login.hpp"
#include "transport/sessions/lane_session.hpp"
#include "transport/sessions/routed_connection.hpp"

// What a Glacier2 router asks a server: who may come in, and for a session (thesis: SessionManager). The
// front-end server and the entity server have the same servants, each on an adapter for routers alone,
// whose threads wait for passwords and for neighbours.
namespace axon::transport {

/// Request context of Glacier2::Router::createSession, which the router passes on. The router adds
/// the ends of its connection (_con.…), and drops what a client has written there (Glacier2 3.7.8).
inline constexpr const char* kContextName = "axon-name";  ///< what a client calls itself: client1@host
inline constexpr const char* kContextToken =
    "axon-token";  ///< this session is the signal lane of the one with it

/// The identities a router's configuration names.
inline constexpr const char* kSessionManager = "SessionManager";
inline constexpr const char* kPermissionsVerifier = "PermissionsVerifier";
inline constexpr const char* kSslSessionManager = "SSLSessionManager";
inline constexpr const char* kSslPermissionsVerifier = "SSLPermissionsVerifier";

/// What the two servants know of their server; outlives them.
struct RouterDoor {
    RouterConnections& routers;
    std::function<void(LoginRequest, Logins::Answer)> verify;
    std::function<Result<LoggedIn>(const std::string& user, const std::optional<PeerCertificate>&)> vouched;
    /// Makes the session; may throw RequestRefused.
    std::function<std::shared_ptr<Glacier2::SessionPrx>(
        Lane, const LoggedIn&, const std::string& display_name, const std::shared_ptr<RoutedConnection>&)>
        open;
    std::string server;  ///< its name; a token begins with that of the server that gave it
    /// The session managers of the other servers of this kind, by name.
    std::map<std::string, std::shared_ptr<Glacier2::SessionManagerPrx>> neighbours;
    /// A session of the data lane was made for a peer of this release.
    std::function<void(const std::string&)> note_release;
    /// Where the links between servers are under TLS: a neighbour must have shown a certificate of its kind
    /// and name. Null: one of a machine is enough over TLS.
    LinkTrust* links = nullptr;
};

class PermissionsVerifierServant final : public Glacier2::PermissionsVerifier {
  public:
    explicit PermissionsVerifierServant(RouterDoor& door) : door_(door) {}
    bool checkPermissions(std::string user, std::string password, std::string& reason,
                          const Ice::Current& current) const override;

  private:
    RouterDoor& door_;
};

/// The same for who shows the router a certificate and gives no user: the certificate says who it is.
class CertificateVerifierServant final : public Glacier2::SSLPermissionsVerifier {
  public:
    explicit CertificateVerifierServant(RouterDoor& door) : door_(door) {}
    bool authorize(Glacier2::SSLInfo info, std::string& reason, const Ice::Current& current) const override;

  private:
    RouterDoor& door_;
};

class SessionManagerServant final : public Glacier2::SessionManager {
  public:
    explicit SessionManagerServant(RouterDoor& door) : door_(door) {}
    /// Both sessions of a peer must be at one server: asked for one with another server's token, it passes
    /// the request on to that one.
    std::shared_ptr<Glacier2::SessionPrx> create(std::string user,
                                                 std::shared_ptr<Glacier2::SessionControlPrx> control,
                                                 const Ice::Current& current) override;

  private:
    RouterDoor& door_;
};

class CertificateSessionManagerServant final : public Glacier2::SSLSessionManager {
  public:
    explicit CertificateSessionManagerServant(RouterDoor& door) : door_(door) {}
    std::shared_ptr<Glacier2::SessionPrx> create(Glacier2::SSLInfo info,
                                                 std::shared_ptr<Glacier2::SessionControlPrx> control,
                                                 const Ice::Current& current) override;

  private:
    RouterDoor& door_;
};

/// The door of a server of this kind (ServerRim), whose sessions are put on the lanes' own adapters. All that
/// is named outlives what it returns.
template <class Kind>
RouterDoor makeDoor(SessionLane<typename Kind::Core, typename Kind::Session>& data,
                    const std::shared_ptr<Ice::ObjectAdapter>& data_adapter,
                    SessionLane<typename Kind::Core, typename Kind::Session>& signal,
                    const std::shared_ptr<Ice::ObjectAdapter>& signal_adapter, RouterConnections& routers) {
    auto* const logins = data.logins;
    RouterDoor door{routers, {}, {}, {}, data.server, {}, {}, nullptr};
    door.verify = [logins](LoginRequest request, Logins::Answer answer) {
        if (logins == nullptr) return answer(LoggedIn{});
        (logins->*Kind::kVerify)(std::move(request), std::move(answer));
    };
    door.vouched = [logins](const std::string& user,
                            const std::optional<PeerCertificate>& certificate) -> Result<LoggedIn> {
        if (logins == nullptr) return LoggedIn{};
        return (logins->*Kind::kVouched)(user, certificate);
    };
    door.open = [&data, &signal, data_adapter, signal_adapter](
                    Lane lane, const LoggedIn& who, const std::string& display_name,
                    const std::shared_ptr<RoutedConnection>& peer) -> std::shared_ptr<Glacier2::SessionPrx> {
        auto& its = lane == Lane::Signal ? signal : data;
        return addSession<typename Kind::SessionPrx>(its, peer, Kind::make(its, peer, who, display_name),
                                                     lane == Lane::Signal ? signal_adapter : data_adapter);
    };
    door.note_release = [&data](const std::string& release) { data.noteRelease(Kind::kPeer, release); };
    return door;
}

/// The adapter for routers, with these servants; not active yet. Throws std::runtime_error where it cannot
/// listen.
std::shared_ptr<Ice::ObjectAdapter> listenForRouters(Ice::Communicator& communicator, const std::string& name,
                                                     const std::string& endpoint, RouterDoor& door);

/// The proxies of a configuration, by name, each with a connection of its own. Throws std::runtime_error,
/// saying how to fix it, for a text that is not a proxy, and for two names at one address.
std::map<std::string, std::shared_ptr<Glacier2::SessionManagerPrx>> neighboursOf(
    const Ice::Communicator& communicator, const std::map<std::string, std::string>& proxies);

}  // namespace axon::transport
