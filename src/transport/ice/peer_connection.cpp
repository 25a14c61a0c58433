// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/peer_connection.hpp"

#include <algorithm>
#include <cctype>
#include <string_view>

#include "transport/ice/communicator.hpp"
#include "transport/ice/ip_layer.hpp"
#include "transport/ice/known_connections.hpp"
#include "transport/ice/tls.hpp"

namespace axon::transport {
namespace {

CloseReason reasonOf(const Ice::Connection& connection) {
    try {
        connection.throwException();
    } catch (const Ice::CloseConnectionException&) {
        return {false, "it closed the connection"};
    } catch (const Ice::CloseTimeoutException&) {
        return {false, "it closed the connection"};
    } catch (const Ice::MemoryLimitException&) {
        return {true, "it sent a message larger than " + std::to_string(kMessageSizeMaxKib) +
                          " KiB (on a signal lane, or from a browser, " + std::to_string(kSignalSizeMaxKib) +
                          ')'};
    } catch (const Ice::ProtocolException& error) {
        return {true, std::string("it broke the protocol (") + error.ice_id() + ")"};
    } catch (const Ice::ConnectionTimeoutException&) {
        return {false, "nothing was heard of it"};
    } catch (const Ice::TimeoutException&) {
        return {false, "the connection made no progress"};
    } catch (const Ice::Exception&) {
        return {false, "the connection was lost"};
    }
    return {false, "the connection ended"};
}

}  // namespace

void DirectConnection::onClosed(std::function<void(const CloseReason&)> closed) {
    connection_->setCloseCallback(
        [closed = std::move(closed), told = told_](const std::shared_ptr<Ice::Connection>& connection) {
            CloseReason reason;
            {
                const std::lock_guard lock(told->mutex);
                reason = told->reason ? *told->reason : reasonOf(*connection);
            }
            closed(reason);
        });
}

void DirectConnection::disconnect(CloseReason reason, bool orderly) {
    {
        const std::lock_guard lock(told_->mutex);
        if (!told_->reason) told_->reason = std::make_unique<CloseReason>(std::move(reason));
    }
    connection_->close(orderly ? Ice::ConnectionClose::Gracefully : Ice::ConnectionClose::Forcefully);
}

void DirectConnection::require(const Ice::Current& current) {
    if (current.con != connection_) {
        throw Ice::ObjectNotExistException(__FILE__, __LINE__, current.id, current.facet, current.operation);
    }
}

Header PeerConnection::properHead(ice::Header&& head, const Ice::Current& current) {
    require(current);
    auto its = fromIce(std::move(head));
    if (!isProper(its)) {
        disconnect({true, std::string(kImproperHead)}, false);
        throw Ice::ObjectNotExistException(__FILE__, __LINE__, current.id, current.facet, current.operation);
    }
    return its;
}

std::string DirectConnection::peerOf(const Ice::Connection& connection) {
    const auto ip = ipOf(connection);
    return ip ? remoteEnd(*ip) : "an unknown address";
}

std::string DirectConnection::localOf(const Ice::Connection& connection) {
    const auto ip = ipOf(connection);
    return ip ? localEnd(*ip) : std::string();
}

std::string DirectConnection::endsOf(const Ice::Connection& connection) {
    const auto ip = ipOf(connection);
    return ip ? bothEnds(remoteEnd(*ip), localEnd(*ip)) : std::string();
}

std::string DirectConnection::remoteAddressOf(const Ice::Connection& connection) {
    const auto ip = ipOf(connection);
    return ip ? ip->remoteAddress : std::string();
}

std::optional<std::string> DirectConnection::originOf(const Ice::Connection& connection) {
    constexpr std::string_view kOrigin = "origin";
    const auto isOrigin = [&](const std::string& name) {
        return std::equal(name.begin(), name.end(), kOrigin.begin(), kOrigin.end(),
                          [](unsigned char a, char b) { return std::tolower(a) == b; });
    };
    try {
        for (auto layer = connection.getInfo(); layer; layer = layer->underlying) {
            const auto socket = std::dynamic_pointer_cast<Ice::WSConnectionInfo>(layer);
            if (!socket) continue;
            for (const auto& [name, value] : socket->headers)
                if (isOrigin(name)) return value;
        }
    } catch (const Ice::LocalException&) {  // closed meanwhile
    }
    return std::nullopt;
}

bool DirectConnection::tls() const {
    return isTls(*connection_);
}

std::string DirectConnection::localAddress() const {
    const auto ip = ipOf(*connection_);
    return ip ? ip->localAddress : std::string();
}

}  // namespace axon::transport
