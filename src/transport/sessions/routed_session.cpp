// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/sessions/routed_session.hpp"

#include <Glacier2/Router.h>

#include <algorithm>
#include <atomic>
#include <mutex>
#include <random>
#include <stdexcept>
#include <utility>
#include <vector>

#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/sessions/router_servants.hpp"

namespace axon::transport {
namespace {

/// The steps after the session stands, asked for all at once.
class Opening : public std::enable_shared_from_this<Opening> {
  public:
    Opening(std::shared_ptr<Glacier2::RouterPrx> router, RoutedLogin login,
            std::function<void(RoutedSession)> opened, std::function<void(std::exception_ptr)> failed)
        : router_(std::move(router)),
          login_(std::move(login)),
          opened_(std::move(opened)),
          failed_(std::move(failed)) {}

    void begin() {
        auto context = contractContext();
        if (!login_.display_name.empty()) context[kContextName] = login_.display_name;
        if (!login_.token.empty()) context[kContextToken] = login_.token;
        attempt([&] {
            const auto opened =
                [self = shared_from_this()](const std::shared_ptr<Glacier2::SessionPrx>& session) {
                    self->attempt([&] { self->prepare(session); });
                };
            const auto failed = [self = shared_from_this()](const std::exception_ptr& error) {
                if (self->mayAskAgain(error)) return self->begin();
                self->fail(self->ofSession(error));
            };
            if (login_.user.empty() && isSecure(*router_)) {
                router_->createSessionFromSecureConnectionAsync(opened, failed, nullptr, context);
            } else {
                router_->createSessionAsync(login_.user, login_.password, opened, failed, nullptr, context);
            }
        });
    }

  private:
    static constexpr int kSteps = 4;

    static bool isSecure(const Ice::ObjectPrx& proxy) {
        const auto endpoints = proxy.ice_getEndpoints();
        return !endpoints.empty() && endpoints.front()->getInfo()->secure();
    }

    /// Once, over the same connection: where one of several servers has just been lost, the router asks
    /// another one the next time, and a new connection would cost both sides another handshake.
    bool mayAskAgain(const std::exception_ptr& error) {
        return isWithoutServer(error) && !asked_again_.exchange(true);
    }
    /// A router closes the connection of who calls something else than a router on it. Under TLS 1.3 it also
    /// does so after the handshake, without a reason, to whoever shows a certificate that it refuses.
    std::exception_ptr ofSession(const std::exception_ptr& error) const {
        try {
            std::rethrow_exception(error);
        } catch (const Ice::ConnectionLostException&) {
            return std::make_exception_ptr(Glacier2::CannotCreateSessionException(
                std::string("it closed the connection; is the router's name right (Ice.Default.Router here, "
                            "Glacier2.InstanceName there), is it going down") +
                (isSecure(*router_) ? ", or is the certificate shown of another CA, expired or revoked (axon "
                                      "certs show; the router's log has the reason)?"
                                    : "?")));
        } catch (...) {
            return error;
        }
    }

    void prepare(const std::shared_ptr<Glacier2::SessionPrx>& session) {
        result_.connection = router_->ice_getCachedConnection();
        if (!session)
            throw Glacier2::CannotCreateSessionException(
                "it has no session manager for this: set Glacier2.SessionManager, and for certificates "
                "Glacier2.SSLSessionManager, in its configuration");
        if (!result_.connection) throw Ice::ConnectionLostException(__FILE__, __LINE__);
        result_.session = result_.connection->createProxy(session->ice_getIdentity())
                              ->ice_invocationTimeout(login_.timeout_ms);
        const auto self = shared_from_this();
        router_->getCategoryForClientAsync(
            [self](std::string category) {
                self->result_.category = std::move(category);
                self->step();
            },
            failure());
        router_->getServerProxyAsync(
            [self](std::shared_ptr<Ice::ObjectPrx> proxy) {
                self->result_.way_back = std::move(proxy);
                self->step();
            },
            failure());
        router_->addProxiesAsync(
            {session}, [self](const Ice::ObjectProxySeq&) { self->step(); }, failure());
        router_->getACMTimeoutAsync(
            [self](int seconds) {
                if (seconds > 0)
                    self->result_.connection->setACM(seconds, Ice::nullopt,
                                                     Ice::ACMHeartbeat::HeartbeatAlways);
                self->step();
            },
            failure());
    }

    void step() {
        if (--left_ > 0) return;
        if (!result_.way_back) {
            return fail(std::make_exception_ptr(Glacier2::CannotCreateSessionException(
                "the router has no way back: set Glacier2.Server.Endpoints in its configuration")));
        }
        if (!over_.exchange(true)) opened_(std::move(result_));
    }

    void fail(const std::exception_ptr& error) {
        if (over_.exchange(true)) return;
        if (const auto connection = router_->ice_getCachedConnection())
            connection->close(Ice::ConnectionClose::Forcefully);
        failed_(error);
    }
    std::function<void(std::exception_ptr)> failure() {
        return [self = shared_from_this()](const std::exception_ptr& error) { self->fail(error); };
    }
    template <class What>
    void attempt(What&& what) {
        try {
            what();
        } catch (const std::exception&) {
            fail(std::current_exception());
        }
    }

    const std::shared_ptr<Glacier2::RouterPrx> router_;
    const RoutedLogin login_;
    const std::function<void(RoutedSession)> opened_;
    const std::function<void(std::exception_ptr)> failed_;
    RoutedSession result_;  // each step writes a member of its own; read when all are done
    std::atomic<int> left_{kSteps};
    std::atomic<bool> over_{false};
    std::atomic<bool> asked_again_{false};
};

}  // namespace

std::shared_ptr<Ice::ObjectPrx> RoutedSession::callback(Ice::ObjectAdapter& adapter,
                                                        const std::shared_ptr<Ice::Object>& servant) const {
    const Ice::Identity identity{Ice::generateUUID(), category};
    adapter.add(servant, identity);
    return way_back->ice_identity(identity);
}

void openRoutedSession(const std::shared_ptr<Ice::ObjectPrx>& router, const RoutedLogin& login,
                       std::function<void(RoutedSession)> opened,
                       std::function<void(std::exception_ptr)> failed) {
    // A connection identifier of its own: a router has one session for each connection.
    const auto its = Ice::uncheckedCast<Glacier2::RouterPrx>(
        router->ice_connectionId(Ice::generateUUID())->ice_invocationTimeout(login.timeout_ms));
    std::make_shared<Opening>(its, login, std::move(opened), std::move(failed))->begin();
}

bool isRouter(const std::string& server) {
    return server.find('/') != std::string::npos && server.rfind("ssl://", 0) != 0;
}

namespace {

/// "Axon.Clients/router", "tcp -h …", "ssl -h …": the identity with its options, then the endpoints. A ':' in
/// quotes is part of an address.
std::vector<std::string> partsOf(const std::string& proxy) {
    std::vector<std::string> parts(1);
    bool quoted = false;
    for (const char c : proxy) {
        if (c == '"') quoted = !quoted;
        if (c == ':' && !quoted) {
            parts.emplace_back();
        } else {
            parts.back() += c;
        }
    }
    return parts;
}

bool isSecureEndpoint(const std::string& endpoint) {
    const auto begin = std::min(endpoint.find_first_not_of(" \t"), endpoint.size());
    const auto kind = endpoint.substr(begin, endpoint.find_first_of(" \t", begin) - begin);
    return kind == "ssl" || kind == "wss";
}

}  // namespace

std::string wayToRouter(const std::string& router, bool has_certificate) {
    const auto parts = partsOf(router);
    std::string chosen = parts.front();
    for (std::size_t i = 1; i < parts.size(); ++i)
        if (isSecureEndpoint(parts[i]) == has_certificate) chosen += ":" + parts[i];
    return chosen == parts.front() ? router : chosen;
}

std::optional<int> routerTriedFor(const std::string& router) {
    constexpr int kOneOfSeveralMs = 300;
    constexpr int kWithHandshakeMs = 1500;
    if (!isRouter(router) || partsOf(router).size() <= 2) return std::nullopt;
    return isTlsRouter(router) ? kWithHandshakeMs : kOneOfSeveralMs;
}

std::shared_ptr<Ice::ObjectPrx> sameRouter(const std::shared_ptr<Ice::ObjectPrx>& router,
                                           const Ice::Connection& connection) {
    if (router->ice_getEndpoints().size() < 2) return router;
    // As text: an endpoint belongs to its communicator, and each lane has one.
    const auto one =
        router->ice_getCommunicator()->stringToProxy("router:" + connection.getEndpoint()->toString());
    return router->ice_endpoints(one->ice_getEndpoints());
}

std::shared_ptr<Ice::ObjectPrx> lostLast(const std::shared_ptr<Ice::ObjectPrx>& router,
                                         const std::shared_ptr<Ice::Endpoint>& lost) {
    auto endpoints = router->ice_getEndpoints();
    if (!lost || endpoints.size() < 2) return router;
    const auto placeOf = [](const Ice::Endpoint& endpoint) {
        auto info = endpoint.getInfo();
        while (info && info->underlying) info = info->underlying;
        const auto ip = std::dynamic_pointer_cast<Ice::IPEndpointInfo>(info);
        return ip ? std::pair(ip->host, ip->port) : std::pair(std::string(), 0);
    };
    if (router->ice_getEndpointSelection() == Ice::EndpointSelectionType::Random)
        std::shuffle(endpoints.begin(), endpoints.end(), std::random_device());
    std::stable_partition(endpoints.begin(), endpoints.end(),
                          [&](const auto& endpoint) { return placeOf(*endpoint) != placeOf(*lost); });
    return router->ice_endpoints(endpoints)->ice_endpointSelection(Ice::EndpointSelectionType::Ordered);
}

bool isTlsRouter(const std::string& router) {
    const auto parts = partsOf(router);
    return std::any_of(parts.begin() + 1, parts.end(), isSecureEndpoint);
}

std::shared_ptr<Ice::ObjectPrx> routerProxy(const Ice::Communicator& communicator, const std::string& text) {
    std::shared_ptr<Ice::ObjectPrx> proxy;
    std::string why;
    try {
        proxy = communicator.stringToProxy(text);
    } catch (const Ice::Exception& error) {
        why = error.ice_id();
    }
    if (!proxy || proxy->ice_getEndpoints().empty()) {
        throw std::invalid_argument("'" + text + "'" + (why.empty() ? why : " (" + why + ")") +
                                    ": expected the proxy of a router, such as "
                                    "Axon.Clients/router:tcp -h 127.0.0.1 -p 10414 (Ice.Default.Router)");
    }
    return proxy;
}

}  // namespace axon::transport
