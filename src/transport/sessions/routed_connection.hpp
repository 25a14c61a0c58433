// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Glacier2/Session.h>
#include <Ice/Ice.h>

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>

#include "certificates/certificate.hpp"
#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "common/result.hpp"
#include "transport/ice/known_connections.hpp"
#include "transport/ice/login.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/outbox/outbox.hpp"

namespace axon::transport {

class RoutedConnection;

/// The connections that Glacier2 routers (and servers that pass a session on) have to this server. A router
/// that dies says nothing; so each connection tells all sessions that came over it when it closes, by the one
/// callback that Ice has for it.
///
/// Threads: any. Lifetime: outlives the communicators. Bound: as many as there are connections and sessions.
class RouterConnections {
  public:
    /// Null `logins`: every process of this machine may be a router. `own_kind`: of the certificates of the
    /// other servers of this kind, where there are several.
    explicit RouterConnections(Logins* logins, certificates::Kind own_kind = certificates::Kind::Server)
        : logins_(logins), own_kind_(own_kind) {}
    certificates::Kind ownKind() const { return own_kind_; }

    /// Whether the other end may speak for others: on this machine a process that Logins allows, from
    /// elsewhere one whose certificate says OU=router, OU=server or the
    /// kind of the other servers of this kind. PERMISSION_DENIED otherwise, with the
    /// reason. Finding out may take a look at all connections of this machine; each is asked about once, as
    /// thousands may come back together after a restart.
    Result<void> admit(const std::shared_ptr<Ice::Connection>& connection);
    /// Records who was refused what, and why.
    void turnedAway(const Ice::Connection& connection, const std::string& what, const Refusal& refusal) const;
    /// A call that nobody answers (GateCalls), by whoever has connected: to the log, at most ten in a second,
    /// and recorded.
    void noteCall(const std::string& peer, const std::string& why);
    /// An admitted connection has brought this session's first call.
    void add(const Ice::Connection* connection, const std::shared_ptr<RoutedConnection>& session);
    void remove(const Ice::Connection* connection, const RoutedConnection* session);
    /// Whether it is an admitted connection, by its ends (bothEnds()).
    bool has(const std::string& ends) const { return admitted_.has(ends); }

  private:
    std::optional<std::string> objection(const Ice::Connection& connection) const;
    void closed(const Ice::Connection* connection);

    Logins* const logins_;
    const certificates::Kind own_kind_;
    const SteadyClock clock_{};
    RateLimit lines_{10};
    std::mutex mutex_;
    // Guarded by mutex_; an entry for each admitted connection until it closes:
    std::map<const Ice::Connection*, std::map<const RoutedConnection*, std::weak_ptr<RoutedConnection>>>
        sessions_;
    std::map<const Ice::Connection*, std::string> ends_of_;  // guarded by mutex_
    KnownConnections admitted_;
};

/// The way to a peer behind a router, as one session on the server's side has it. Many of them share one
/// connection; the session answers over the one that its first call came by, which must be a router's.
///
/// It closes when the router says so (Session::destroy, for whatever reason: ended()), when the router's
/// connection closes, or when the router has answered disconnect().
class RoutedConnection final : public PeerConnection, public std::enable_shared_from_this<RoutedConnection> {
  public:
    /// `over`: what the session was asked for by.
    RoutedConnection(std::shared_ptr<Glacier2::SessionControlPrx> control, RouterConnections& routers,
                     const Ice::Connection& over)
        : control_(std::move(control)),
          routers_(routers),
          peer_("a peer behind the router at " + DirectConnection::peerOf(over)) {}

    void onClosed(std::function<void(const CloseReason&)> closed) override;
    void disconnect(CloseReason reason, bool orderly) override;
    void require(const Ice::Current& current) override;
    bool routed() const override { return true; }
    const void* key() const override { return this; }
    const void* connection() const override;
    std::string peer() const override { return peer_; }
    std::string ends() const override { return {}; }
    std::string localAddress() const override { return {}; }
    bool tls() const override { return false; }

    /// The session is over; `otherwise` is why, unless disconnect() has said it.
    void ended(const std::string& otherwise);

  private:
    const std::shared_ptr<Glacier2::SessionControlPrx> control_;
    RouterConnections& routers_;
    const std::string peer_;
    mutable std::mutex mutex_;
    // Guarded by mutex_; over_ is set once:
    std::shared_ptr<Ice::Connection> over_;
    std::function<void(const CloseReason&)> closed_;
    std::optional<CloseReason> told_;
    bool over_and_out_ = false;
};

/// When what is sent to this peer has left its outbox.
Until untilOf(const PeerConnection& peer);

}  // namespace axon::transport
