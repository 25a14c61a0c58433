// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>

#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "common/routed.hpp"

namespace axon::entity_server {

/// Whether the holder has lost the entity to somebody else, by force or by consent; not where a client goes
/// on with its lease in another session. An Entity Manager may first say who took it, as the reason of a
/// status without a holder, and then who holds it.
bool isTaken(const EntityStatus& before, const EntityStatus& now);

/// What the log says of who holds one entity: a line for each change of its holder, in at most 20 lines a
/// second. The next line tells how many changes were left out before it, and leftOut() how many no line has
/// told of. Not thread-safe. Failure: none.
class HolderLog {
  public:
    /// The line for this change; empty where there is none to write. `name` is the entity's.
    std::string line(const std::string& name, const EntityStatus& before, const EntityStatus& now,
                     TimePoint at);
    std::size_t leftOut() const { return left_out_; }

  private:
    static constexpr std::uint32_t kLinesPerSecond = 20;

    RateLimit lines_{kLinesPerSecond};
    std::size_t left_out_ = 0;
};

}  // namespace axon::entity_server
