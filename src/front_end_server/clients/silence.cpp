// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/silence.hpp"

#include <chrono>
#include <unordered_set>

namespace axon::front_end_server {
namespace {

std::string milliseconds(Duration duration) {
    return std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(duration).count()) + " ms";
}

/// One heartbeat of a busy client less than its time-out.
bool missesAHeartbeat(const Client& client, TimePoint now) {
    return now >= client.liveness.deadline() - client.liveness.timeout() / 5;
}

}  // namespace

std::vector<SilentClient> silentAt(const Clients::ById& clients, TimePoint now) {
    std::vector<SilentClient> silent;
    std::unordered_set<const void*> connections;  // each has had a busy client whose time-out is over
    for (const auto& [id, client] : clients) {
        if (!client->liveness.expired(now)) continue;
        silent.push_back({client, "nothing was heard of it for " + milliseconds(client->liveness.timeout())});
        if (client->liveness.busy()) connections.insert(client->connection);
    }
    if (connections.empty()) return silent;
    std::vector<ClientRef> near;
    for (const auto& [id, client] : clients) {
        if (!connections.contains(client->connection) || !client->liveness.busy()) continue;
        if (!missesAHeartbeat(*client, now)) {
            connections.erase(client->connection);  // it works, or so it seems
        } else if (!client->liveness.expired(now)) {
            near.push_back(client);
        }
    }
    for (const auto& client : near) {
        if (!connections.contains(client->connection)) continue;
        silent.push_back({client, "nothing was heard of it for " +
                                      milliseconds(now - client->liveness.silentSince()) +
                                      ", nor of the others behind its router"});
    }
    return silent;
}

}  // namespace axon::front_end_server
