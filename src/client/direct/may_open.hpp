// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <string_view>

#include "client/direct/direct_path.hpp"

namespace axon::client {

/// What decides whether a client uses the direct path that a grant offers.
struct DirectSurroundings {
    bool wanted = true;       ///< Options::direct
    bool routed = false;      ///< the server is reached through a router
    bool server_tls = false;  ///< the server is reached over TLS
    bool has_trust = false;   ///< there is something to check an entity's certificate with
    bool known = true;        ///< the entity is in the list, so its name is known
    std::string server;       ///< the server's address, "host:port"; empty: not known
};

/// Whether a direct path to these endpoints ("host:port" or "ssl://host:port") may be opened
/// (docs/reference/direct.md). Not behind a router; nothing plain beside a server over TLS; over TLS only
/// where the entity's certificate and name can be checked; to this machine's own address only where the
/// server is on this machine, too: an Entity Manager beside the server names its own machine.
inline bool mayOpen(std::string_view data_endpoint, std::string_view signal_endpoint,
                    const DirectSurroundings& around) {
    if (data_endpoint.empty() || signal_endpoint.empty() || !around.wanted || around.routed) return false;
    const bool tls = DirectOffer::overTls(data_endpoint);
    if (tls != DirectOffer::overTls(signal_endpoint)) return false;
    if (tls ? !around.has_trust || !around.known : around.server_tls) return false;
    const auto local = [](std::string_view endpoint) {
        return DirectOffer::addressIn(endpoint).starts_with("127.");
    };
    return !local(data_endpoint) || around.server.empty() || local(around.server);
}

}  // namespace axon::client
