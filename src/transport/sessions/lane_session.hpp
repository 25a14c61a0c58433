// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "common/release.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/connection_limits.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/gate_calls.hpp"
#include "transport/ice/lane_socket.hpp"
#include "transport/ice/login.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/ice/tls.hpp"
#include "transport/ice/unreadable_calls.hpp"
#include "transport/outbox/outbox.hpp"
#include "transport/sessions/open_sessions.hpp"
#include "transport/sessions/routed_connection.hpp"

// A session of two lanes, on the server's side: what a client's and an Entity Manager's have in common.
namespace axon::transport {

/// What the servants of one lane share. Outlives them.
template <class Core, class Servant>
struct SessionLane {
    Core& core;
    Lane lane;
    OutboxLimits limits;
    /// Of the signal lane's adapter; without a host where it listens on all addresses.
    std::vector<Endpoint> signal_endpoints;
    OpenSessions<Servant> sessions;
    /// Of the data lane. Null on the signal lane: there the token of a session is the proof, and no stop
    /// waits for a password. At a door for browsers it is one that refuses foreign pages at once.
    Logins* logins = nullptr;
    std::string server = {};  ///< its name, where there are several
    /// Of the data lane. Null on the signal lane: its peer has told its release on the other one.
    ReleaseNotes* releases = nullptr;
    /// Is told of who is turned away, on either lane; null: nobody is.
    Logins* door = nullptr;
    /// In place of `signal_endpoints`, where it depends on how the peer came.
    std::function<std::string(const PeerConnection& peer)> tell_signal_endpoint = {};
    SteadyClock steady = {};
    RateLimit lines{10};

    void turnedAway(const std::string& peer, const std::string& what, const Refusal& refusal) const {
        if (door != nullptr) door->turnedAway(peer, what, refusal);
    }
    /// The same, and the log has it, with at most ten lines in a second.
    void tellTurnedAway(const std::string& peer, const std::string& what, const Refusal& refusal) {
        if (lines.admit(steady.now()))
            spdlog::warn("audit: {} of {} was refused: {}", what, peer, refusal.message);
        turnedAway(peer, what, refusal);
    }
    /// For addGate(); `routers`: of their peers, who may be late, nothing is told; null: there are none.
    GateCalls::Told ofStrangers(const RouterConnections* routers) {
        return [this, routers](const Ice::Connection& connection, const std::string& why) {
            if (routers == nullptr || !routers->has(DirectConnection::endsOf(connection)))
                noteCall(DirectConnection::peerOf(connection), why);
        };
    }
    /// A call of a stranger that is none of the contracts', or is for the session of somebody else.
    void noteCall(const std::string& peer, const std::string& why) {
        tellTurnedAway(peer, "a call", {RefusalCode::Malformed, why, {}});
    }
    /// The value; or it is told, and thrown, why there is none.
    template <class T>
    T orTurnAway(Result<T> result, const PeerConnection& peer, const std::string& what) {
        if (!result.ok()) tellTurnedAway(peer.peer(), what, result.refusal());
        return valueOrThrow(std::move(result));
    }
    /// A session was opened for `peer` ("a client"), which has told this release.
    void noteRelease(const std::string& peer, const std::string& release) const {
        if (releases == nullptr) return;
        if (const auto note = releases->onPeer(peer, release)) spdlog::info("{}", *note);
    }
    /// Where this peer finds the signal lane, by the protocol that it came by; empty behind a
    /// router, which knows.
    std::string signalEndpoint(const PeerConnection& peer) const {
        if (peer.routed()) return {};
        if (tell_signal_endpoint) return tell_signal_endpoint(peer);
        for (auto endpoint : signal_endpoints) {
            if (endpoint.tls != peer.tls()) continue;
            if (endpoint.host.empty()) endpoint.host = peer.localAddress();
            return endpoint.host.empty() ? endpoint.host : endpoint.text();
        }
        return {};
    }
    /// The core's token as the peer gets it: behind a router it leads to this server (router_servants.hpp).
    std::string toPeer(const std::string& token) const {
        return server.empty() ? token : server + "/" + token;
    }
    static std::string fromPeer(const std::string& token) { return token.substr(token.rfind('/') + 1); }
};

/// What a servant keeps of its session on one lane. `Ref` is the core's reference to it, `End` says how it
/// ended, and for people `why`. States: opened ─ adopt() ► ready ─ end() ► ended; end() may come first, also
/// while the core is being told of the session. Threads: any. The servant answers only on the connection that
/// opened the session.
template <class Ref, class End>
class LaneSession {
  public:
    /// `leave` tells the core; it is called once, without a lock.
    LaneSession(std::shared_ptr<PeerConnection> peer, std::function<void(const Ref&, const End&)> leave)
        : peer_(std::move(peer)), leave_(std::move(leave)) {}

    bool ready() const { return ready_; }
    const std::shared_ptr<PeerConnection>& peer() const { return peer_; }

    /// The first end counts.
    void end(End how) {
        Ref ref;
        {
            const std::lock_guard lock(mutex_);
            if (end_) return;
            end_ = how;
            ref = ref_;
        }
        if (ref) leave_(ref, how);
    }
    void adopt(Ref ref) {
        std::optional<End> ended;
        {
            const std::lock_guard lock(mutex_);
            ref_ = ref;
            ended = end_;
        }
        ready_ = true;
        if (ended) leave_(ref, *ended);  // the connection ended while the session was being set up
    }
    /// The peer ends its session itself.
    void leave(End how, const Ice::Current& current) {
        peer_->require(current);
        const auto why = how.why;
        end(std::move(how));
        peer_->disconnect({false, why}, true);
    }
    /// Glacier2's destroy(), which a router calls for any end of its side: `whom` ("the client") is lost
    /// then. From anybody else it is leave().
    void destroy(End how, const std::string& whom, const Ice::Current& current) {
        const auto routed = std::dynamic_pointer_cast<RoutedConnection>(peer_);
        if (!routed) return leave(std::move(how), current);
        routed->require(current);
        routed->ended("the router ended its session: " + whom + " is gone, or silent");
    }
    /// Throws Ice::ObjectNotExistException when it is not ready, or the call came over another connection.
    const Ref& of(const Ice::Current& current) const {
        peer_->require(current);
        if (!ready_)
            throw Ice::ObjectNotExistException(__FILE__, __LINE__, current.id, current.facet,
                                               current.operation);
        return ref_;
    }
    /// The callback of a new session, to send on; `fits`: this is the lane that the operation is for.
    template <class Prx>
    std::shared_ptr<Prx> newCallback(const std::shared_ptr<Prx>& given, bool fits,
                                     const Ice::Current& current) const {
        peer_->require(current);
        auto proxy = callbackProxy(given, current);
        if (!proxy)
            throw toIce(
                Refusal{RefusalCode::Malformed, "the callback is null; give the proxy of a callback", {}});
        if (!peer_->routed() && !callsBack(*given, current))
            throw toIce(
                Refusal{RefusalCode::PermissionDenied,
                        "the callback's proxy names another address than that of its connection; give one "
                        "without endpoints (of an adapter that is bound to the connection)",
                        {}});
        if (!fits || ready_)
            throw toIce(Refusal{RefusalCode::WrongState,
                                current.operation +
                                    " is for a new session, once: setCallback on the data port, "
                                    "attachSignalLane on the signal port",
                                {}});
        return proxy;
    }

  private:
    const std::shared_ptr<PeerConnection> peer_;
    const std::function<void(const Ref&, const End&)> leave_;
    std::mutex mutex_;
    std::optional<End> end_;  // guarded by mutex_
    Ref ref_;                 // written once, before ready_ is
    std::atomic<bool> ready_{false};
};

/// While the returned object lives, a peer without a session of this lane cannot keep connections to its
/// adapter. `routers`: the routers whose sessions also come through it; null = none.
template <class Core, class Servant>
[[nodiscard]] std::shared_ptr<void> watch(ConnectionLimits& limits, const Ice::ObjectAdapter& adapter,
                                          SessionLane<Core, Servant>& lane,
                                          const RouterConnections* routers) {
    auto& sessions = lane.sessions;
    return limits.watch(listenedEndpoints(adapter),
                        {[&sessions, routers](const std::string& ends) {
                             return routers != nullptr && routers->has(ends) ? ConnectionLimits::Peer::Exempt
                                                                             : sessions.stateOf(ends);
                         },
                         [&sessions](const std::string& ends) { sessions.endSilent(ends); }});
}

/// Puts a session's servant behind a proxy that tells of unreadable calls; it ends with its peer
/// (`closed(reason)`).
template <class SessionPrx, class Core, class Servant>
std::shared_ptr<SessionPrx> addSession(SessionLane<Core, Servant>& lane,
                                       const std::shared_ptr<PeerConnection>& peer,
                                       const std::shared_ptr<Servant>& servant,
                                       const std::shared_ptr<Ice::ObjectAdapter>& adapter) {
    valueOrThrow(lane.sessions.add(*peer, servant));
    UnreadableCalls::Foreign foreign;
    if (!peer->routed())
        foreign = [&lane](const std::string& caller) {
            lane.noteCall(caller, "the session belongs to another connection");
        };
    auto proxy = Ice::uncheckedCast<SessionPrx>(adapter->addWithUUID(
        std::make_shared<UnreadableCalls>(servant, peer->peer(), peer->key(), std::move(foreign))));
    peer->onClosed([&lane, servant, key = peer->key(), adapter,
                    id = proxy->ice_getIdentity()](const CloseReason& reason) {
        lane.sessions.remove(key);
        servant->closed(reason);
        try {
            adapter->remove(id);
        } catch (const Ice::LocalException&) {  // the adapter is being destroyed, with its servants
        }
    });
    return proxy;
}

/// How a gate answers open(): when the log-in is decided, the servant that Kind::make returns (ServerRim) is
/// put behind a session proxy, and ends with its connection.
template <class Kind>
void openSession(SessionLane<typename Kind::Core, typename Kind::Session>& lane, LoginRequest request,
                 std::string display_name,
                 std::function<void(const std::shared_ptr<typename Kind::SessionPrx>&)> opened,
                 std::function<void(std::exception_ptr)> refused, const Ice::Current& current) {
    const std::string session = std::string("a session of ") + Kind::kPeer;
    if (const auto other = otherContract(current.ctx)) {
        lane.tellTurnedAway(DirectConnection::peerOf(*current.con), session, *other);
        return refused(std::make_exception_ptr(toIce(*other)));
    }
    const auto peer = std::make_shared<DirectConnection>(current.con);
    request.peer = DirectConnection::peerOf(*peer->get());
    request.local = DirectConnection::localOf(*peer->get());
    request.certificate = certificateOf(*peer->get());
    request.origin = DirectConnection::originOf(*peer->get());
    Logins::Answer answer = [&lane, peer, session, adapter = current.adapter,
                             release = releaseIn(current.ctx), opened = std::move(opened),
                             refused = std::move(refused),
                             display_name = std::move(display_name)](Result<LoggedIn> who) {
        if (!who.ok()) return refused(std::make_exception_ptr(toIce(who.refusal())));  // Logins records it
        try {
            auto proxy = addSession<typename Kind::SessionPrx>(
                lane, peer, Kind::make(lane, peer, valueOrThrow(std::move(who)), display_name), adapter);
            if (lane.lane == Lane::Signal) prepareSignalLane(*peer->get());
            lane.noteRelease(Kind::kPeer, release);
            opened(proxy);
        } catch (...) {
            lane.tellTurnedAway(peer->peer(), session, translate(std::current_exception()));
            refused(std::current_exception());
        }
    };
    if (lane.logins == nullptr) return answer(LoggedIn{});
    const auto ends = peer->ends();
    lane.sessions.asks(ends);
    (lane.logins->*Kind::kVerify)(std::move(request),
                                  [&lane, ends, answer = std::move(answer)](Result<LoggedIn> who) {
                                      answer(std::move(who));
                                      lane.sessions.answered(ends);
                                  });
}

}  // namespace axon::transport
