// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <string>

namespace axon::transport {

/// One lane's session with a server behind a Glacier2 router, as the one who asked for it has it. It lives
/// and dies with the connection to the router, which nothing else uses.
struct RoutedSession {
    std::shared_ptr<Ice::Connection> connection;
    std::shared_ptr<Ice::ObjectPrx> session;   ///< twoway, over that connection
    std::shared_ptr<Ice::ObjectPrx> way_back;  ///< the router's endpoint for the server's calls
    std::string category;                      ///< of the objects that may be called through it

    /// Puts a callback's servant into the adapter, which has no endpoints; the proxy is for the server.
    std::shared_ptr<Ice::ObjectPrx> callback(Ice::ObjectAdapter& adapter,
                                             const std::shared_ptr<Ice::Object>& servant) const;
};

struct RoutedLogin {
    std::string user, password;
    std::string display_name;  ///< of a client; empty for an Entity Manager
    std::string token;         ///< of the other lane's session; empty for the first
    int timeout_ms = 5000;     ///< of each call
};

/// Asks a router for a session of the user. If none is named and the router is reached over TLS, the session
/// is that of the user whom our certificate names. If no server answers the router, it is asked once more
/// over the same connection, because it may ask another server then. Exactly one of `opened` and `failed` is
/// called, on a thread of the communicator's client pool or on the caller's. A connection that was opened
/// before a failure is closed. translate() turns the exception into a refusal.
///
/// Afterwards the connection sends the signs of life that the router wants, without which it ends the
/// session.
void openRoutedSession(const std::shared_ptr<Ice::ObjectPrx>& router, const RoutedLogin& login,
                       std::function<void(RoutedSession)> opened,
                       std::function<void(std::exception_ptr)> failed);

/// "Axon.Clients/router:tcp -h 127.0.0.1 -p 10414" and not "127.0.0.1:10410".
bool isRouter(const std::string& server);

/// The same proxy with those of its endpoints that somebody should use who has a certificate to show, or has
/// none: TLS where it can, never plain beside it, because Ice takes any of those that are there. A proxy
/// without a choice stays as it is.
std::string wayToRouter(const std::string& router, bool has_certificate);

/// How long a new connection to one of several routers may take before the next one is tried, in
/// milliseconds: longer over TLS, because when a router is lost, all its peers shake hands with another one
/// at once. Nothing where the proxy has one endpoint, or is the address of a server.
std::optional<int> routerTriedFor(const std::string& router);

/// The proxy of one of several routers: that to which this connection leads. Both lanes of a peer go through
/// one router; with one of them through another, a router that stands still would leave half of a session,
/// and the half with the heartbeats would hide it.
std::shared_ptr<Ice::ObjectPrx> sameRouter(const std::shared_ptr<Ice::ObjectPrx>& router,
                                           const Ice::Connection& connection);

/// The proxy of several routers, the one at this endpoint last: the session through it was lost, and a router
/// that stands still would take the whole time of a new connection. The others are in random order, unless
/// the proxy's is fixed; that of what is returned is. Only for the next attempt: a router that answers and
/// refuses must not keep a peer from the others. As it is where nothing was lost (null) or there is one
/// router.
std::shared_ptr<Ice::ObjectPrx> lostLast(const std::shared_ptr<Ice::ObjectPrx>& router,
                                         const std::shared_ptr<Ice::Endpoint>& lost);

/// Whether such a router is reached over TLS.
bool isTlsRouter(const std::string& router);

/// The proxy of a router. Throws std::invalid_argument, saying how to fix it, for a text that is not a proxy.
std::shared_ptr<Ice::ObjectPrx> routerProxy(const Ice::Communicator& communicator, const std::string& text);

}  // namespace axon::transport
