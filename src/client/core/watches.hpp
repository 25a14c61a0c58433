// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <map>
#include <string>
#include <vector>

#include "client/core/core_context.hpp"
#include "common/result.hpp"

namespace axon::client {

/// Which streams of which entities this session watches, and how often each. Part of SessionCore. They
/// outlive the connection: what is watched is asked for again when the entity comes back.
class Watches {
  public:
    explicit Watches(const CoreParts& parts) : parts_(parts) {}

    /// No stream named = all. Each watch() needs one unwatch() of the same streams.
    Result<void> watch(const std::string& entity, const std::vector<std::string>& streams);
    void unwatch(const std::string& entity, const std::vector<std::string>& streams);
    bool contains(const std::string& entity) const { return watches_.contains(entity); }
    /// Asks for what is watched of this entity.
    void send(const std::string& entity);
    /// The same for all entities that are there.
    void sendAll();

  private:
    const CoreParts& parts_;
    std::map<std::string, std::map<std::string, int>> watches_;  // entity → stream → how many; "" = all
};

}  // namespace axon::client
