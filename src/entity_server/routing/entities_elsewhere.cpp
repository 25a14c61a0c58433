// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/routing/entities_elsewhere.hpp"

#include <string_view>
#include <unordered_set>
#include <utility>

#include "common/neighbours.hpp"

namespace axon::entity_server {

std::shared_ptr<const std::string> EntitiesElsewhere::serverOf(const std::string& entity, Lane lane) const {
    auto place = places_.find(entity, static_cast<std::size_t>(lane));
    if (!place) return nullptr;
    const auto* server = &place->server;
    return {std::move(place), server};
}

void EntitiesElsewhere::learn(const std::string& server, const std::vector<std::string>& entities) {
    const std::lock_guard lock(mutex_);
    if (entities.size() > entities_max_ ||
        (entities_of_.size() >= Neighbours::kMost && !entities_of_.contains(server)))
        return;
    auto& known = entities_of_[server];
    const std::unordered_set<std::string_view> present(entities.begin(), entities.end());
    for (const auto& entity : known) {
        const auto at = places_.find(entity);
        if (!present.contains(entity) && at && at->server == server) places_.erase(entity);
    }
    for (const auto& entity : entities) {
        if (const auto at = places_.find(entity); at && at->server == server) continue;
        const auto place = std::make_shared<const Place>(Place{entity, server});
        places_.put(place->entity, place);
    }
    known = entities;
    if (entities.empty()) entities_of_.erase(server);
}

}  // namespace axon::entity_server
