// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/clients.hpp"

namespace axon::front_end_server {

void Clients::add(const ClientRef& client) {
    by_id_.emplace(client->me.id, client);
    tokens_.emplace(client->token, client);
    table_.put(client->me.id, client);
}

ClientRef Clients::takeToken(const std::string& token) {
    const auto found = tokens_.find(token);
    if (found == tokens_.end()) return nullptr;
    auto client = found->second.lock();
    tokens_.erase(found);
    return client;
}

bool Clients::remove(const ClientRef& client) {
    const auto found = by_id_.find(client->me.id);
    if (found == by_id_.end() || found->second != client) return false;
    by_id_.erase(found);
    tokens_.erase(client->token);
    table_.erase(client->me.id);
    return true;
}

ClientRef Clients::find(const std::string& id) const {
    const auto found = by_id_.find(id);
    return found == by_id_.end() ? nullptr : found->second;
}

}  // namespace axon::front_end_server
