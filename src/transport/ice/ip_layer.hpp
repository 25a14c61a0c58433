// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <memory>
#include <string>

namespace axon::transport {

/// The layer of TCP in what Ice tells of a connection (below TLS and WebSocket); null where there is none.
inline std::shared_ptr<Ice::IPConnectionInfo> ipOf(const std::shared_ptr<Ice::ConnectionInfo>& info) {
    for (auto layer = info; layer; layer = layer->underlying)
        if (auto ip = std::dynamic_pointer_cast<Ice::IPConnectionInfo>(layer)) return ip;
    return nullptr;
}

/// The same; null also where the connection has closed.
inline std::shared_ptr<Ice::IPConnectionInfo> ipOf(const Ice::Connection& connection) {
    try {
        return ipOf(connection.getInfo());
    } catch (const Ice::LocalException&) {
        return nullptr;
    }
}

/// The ends of a connection as "127.0.0.1:50122".
inline std::string remoteEnd(const Ice::IPConnectionInfo& ip) {
    return ip.remoteAddress + ":" + std::to_string(ip.remotePort);
}
inline std::string localEnd(const Ice::IPConnectionInfo& ip) {
    return ip.localAddress + ":" + std::to_string(ip.localPort);
}

}  // namespace axon::transport
