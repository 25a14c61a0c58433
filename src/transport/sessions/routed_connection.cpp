// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/sessions/routed_connection.hpp"

#include <spdlog/spdlog.h>

#include <utility>

#include "transport/ice/tls.hpp"

namespace axon::transport {
namespace {

constexpr int kHeartbeatsWithin = 1;  // seconds; Ice sends two in that time

bool isLoopback(const std::string& peer) {
    return peer.rfind("127.", 0) == 0;
}

}  // namespace

std::optional<std::string> RouterConnections::objection(const Ice::Connection& connection) const {
    const auto peer = DirectConnection::peerOf(connection);
    if (const auto certificate = certificateOf(connection)) {
        using certificates::Kind;
        for (const auto kind : {Kind::Router, Kind::Server, own_kind_})
            if (certificate->unit == toString(kind)) return std::nullopt;
        return "its certificate is that of the " + certificate->unit + " " + certificate->name;
    }
    if (!isLoopback(peer)) return "no certificate of a router";
    if (logins_ == nullptr || logins_->mayVouch(peer, DirectConnection::localOf(connection)))
        return std::nullopt;
    return "another user's process";
}

Result<void> RouterConnections::admit(const std::shared_ptr<Ice::Connection>& connection) {
    {
        const std::lock_guard lock(mutex_);
        if (sessions_.contains(connection.get())) return {};
    }
    if (const auto why = objection(*connection)) {
        return Refusal{
            RefusalCode::PermissionDenied,
            "only a router may ask for this: on this machine a glacier2router of the server's own user, "
            "from elsewhere one with a certificate of OU=router (" +
                *why + ")",
            {}};
    }
    {
        const std::lock_guard lock(mutex_);
        if (!sessions_.try_emplace(connection.get()).second) return {};
        const auto ends = DirectConnection::endsOf(*connection);
        ends_of_.emplace(connection.get(), ends);
        admitted_.add(ends);
    }
    connection->setCloseCallback([this](const std::shared_ptr<Ice::Connection>& it) { closed(it.get()); });
    // A router may close what is silent, and its sessions would be lost with it.
    connection->setACM(kHeartbeatsWithin, Ice::ACMClose::CloseOff, Ice::ACMHeartbeat::HeartbeatAlways);
    return {};
}

void RouterConnections::noteCall(const std::string& peer, const std::string& why) {
    if (lines_.admit(clock_.now())) spdlog::warn("audit: a call of {} was refused: {}", peer, why);
    if (logins_ != nullptr) logins_->turnedAway(peer, "a call", {RefusalCode::Malformed, why, {}});
}

void RouterConnections::turnedAway(const Ice::Connection& connection, const std::string& what,
                                   const Refusal& refusal) const {
    if (logins_ != nullptr) logins_->turnedAway(DirectConnection::peerOf(connection), what, refusal);
}

void RouterConnections::add(const Ice::Connection* connection,
                            const std::shared_ptr<RoutedConnection>& session) {
    {
        const std::lock_guard lock(mutex_);
        const auto found = sessions_.find(connection);
        if (found != sessions_.end()) {
            found->second.emplace(session.get(), session);
            return;
        }
    }
    session->ended("the router is gone");  // between its call and now
}

void RouterConnections::remove(const Ice::Connection* connection, const RoutedConnection* session) {
    const std::lock_guard lock(mutex_);
    const auto found = sessions_.find(connection);
    if (found != sessions_.end()) found->second.erase(session);
}

void RouterConnections::closed(const Ice::Connection* connection) {
    decltype(sessions_)::mapped_type its;
    {
        const std::lock_guard lock(mutex_);
        const auto found = sessions_.find(connection);
        if (found == sessions_.end()) return;
        its = std::move(found->second);
        sessions_.erase(found);
        const auto ends = ends_of_.find(connection);
        admitted_.remove(ends->second);
        ends_of_.erase(ends);
    }
    for (const auto& [key, session] : its) {
        if (const auto alive = session.lock()) alive->ended("the router is gone");
    }
}

void RoutedConnection::onClosed(std::function<void(const CloseReason&)> closed) {
    const std::lock_guard lock(mutex_);
    closed_ = std::move(closed);
}

void RoutedConnection::disconnect(CloseReason reason,
                                  bool /*orderly: the router has what it is to deliver*/) {
    {
        const std::lock_guard lock(mutex_);
        if (told_ || over_and_out_) return;
        told_ = std::move(reason);
    }
    try {
        control_->destroyAsync([self = shared_from_this()] { self->ended({}); },
                               // Also when it knows no such session any more, or does not answer.
                               [self = shared_from_this()](const std::exception_ptr&) { self->ended({}); });
    } catch (const Ice::Exception&) {  // this server is shutting down
    }
}

const void* RoutedConnection::connection() const {
    const std::lock_guard lock(mutex_);
    return over_.get();
}

void RoutedConnection::ended(const std::string& otherwise) {
    std::function<void(const CloseReason&)> closed;
    CloseReason reason{false, otherwise};
    std::shared_ptr<Ice::Connection> over;
    {
        const std::lock_guard lock(mutex_);
        if (std::exchange(over_and_out_, true)) return;
        closed = std::exchange(closed_, nullptr);
        if (told_) reason = *told_;
        over = over_;
    }
    if (over) routers_.remove(over.get(), this);
    if (closed) closed(reason);
}

void RoutedConnection::require(const Ice::Current& current) {
    const auto refuse = [&] {
        throw Ice::ObjectNotExistException(__FILE__, __LINE__, current.id, current.facet, current.operation);
    };
    {
        const std::lock_guard lock(mutex_);
        if (over_and_out_) refuse();
        if (over_) {
            if (over_ != current.con) refuse();
            return;
        }
    }
    if (!current.con) refuse();
    if (const auto may = routers_.admit(current.con); !may) {
        spdlog::warn("a call to a session behind a router came from {} and was refused: {}",
                     DirectConnection::peerOf(*current.con), may.refusal().message);
        refuse();
    }
    {
        const std::lock_guard lock(mutex_);
        if (over_and_out_ || (over_ && over_ != current.con)) refuse();
        if (over_) return;
        over_ = current.con;
    }
    routers_.add(current.con.get(), shared_from_this());
}

Until untilOf(const PeerConnection& peer) {
    return peer.routed() ? Until::Answered : Until::Written;
}

}  // namespace axon::transport
