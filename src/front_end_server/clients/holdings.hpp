// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <map>
#include <string>
#include <unordered_map>

namespace axon::front_end_server {

/// Which entities name which client as their holder, and on which of them a task runs that the client's
/// watchdog must be short for. Not thread-safe.
class Holdings {
  public:
    /// Entity → whether the client must be watched closely for it.
    using Held = std::map<std::string, bool>;

    /// The entity is held by this client alone. Returns whether that is new, or `busy` has changed.
    bool set(const std::string& client, const std::string& entity, bool busy) {
        const auto [held, is_new] = all_[client].try_emplace(entity, busy);
        const bool changed = is_new || held->second != busy;
        held->second = busy;
        return changed;
    }
    void erase(const std::string& client, const std::string& entity) {
        const auto found = all_.find(client);
        if (found == all_.end()) return;
        found->second.erase(entity);
        if (found->second.empty()) all_.erase(found);
    }
    bool has(const std::string& client, const std::string& entity) const {
        const auto found = all_.find(client);
        return found != all_.end() && found->second.contains(entity);
    }
    bool busy(const std::string& client) const {
        const auto found = all_.find(client);
        return found != all_.end() && std::any_of(found->second.begin(), found->second.end(),
                                                  [](const auto& entity) { return entity.second; });
    }
    Held of(const std::string& client) const {
        const auto found = all_.find(client);
        return found == all_.end() ? Held{} : found->second;
    }

  private:
    std::unordered_map<std::string, Held> all_;  // by client; none is empty
};

}  // namespace axon::front_end_server
