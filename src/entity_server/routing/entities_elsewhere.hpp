// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "common/routed.hpp"
#include "common/snapshot_table.hpp"

namespace axon::entity_server {

/// Which entities are at other entity servers, and at which.
///
/// The server that said last that it has an entity has it, until that server says otherwise. A server says
/// which entities it has, all at once; one that is gone has none.
///
/// Threads: any. serverOf() reads immutable tables, of which each lane has its own references; learn() takes
/// a mutex of its own, which no message takes. Bound: Neighbours::kMost servers of `entities_max` entities
/// each; what is beyond is not learnt. Failure: none.
class EntitiesElsewhere {
  public:
    explicit EntitiesElsewhere(std::size_t entities_max) : entities_max_(entities_max) {}

    /// Null where no server has it.
    std::shared_ptr<const std::string> serverOf(const std::string& entity, Lane lane) const;
    /// Replaces what this server had.
    void learn(const std::string& server, const std::vector<std::string>& entities);

  private:
    struct Place {
        std::string entity;
        std::string server;
    };

    const std::size_t entities_max_;
    SnapshotTable<std::shared_ptr<const Place>, 2> places_;  // by entity, for each lane

    std::mutex mutex_;  // held by whoever changes places_
    // Guarded by it: server → those of places_ that it has, or had before another one said that it has them.
    std::unordered_map<std::string, std::vector<std::string>> entities_of_;
};

}  // namespace axon::entity_server
