// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/collaboration.pb.h>

#include <string>
#include <string_view>

namespace axon::collaboration {

/// What a sub-lease is good for, besides what stands in it.
struct Grant {
    std::string_view run_id;  ///< 16 bytes
    std::string_view master;  ///< UUID of the entity that may give the orders
    std::string_view entity;  ///< UUID of the entity that obeys them
};

/// Makes `lease` the right of one master over one entity in one run (ADR 0019): sets its
/// proof, a MAC over all of it under the key of the entity's own lease, which only its holder and its Entity
/// Manager know. So an entity obeys a master because the client that holds it said so, and not because a
/// server or the master says so. The seal does not wear out by being used: that an invitation is not accepted
/// a second time is for the entity to see to.
///
/// Where in the flow: the client seals, the Entity Manager of the slave verifies. `key` has 16 bytes; epoch,
/// number, root and generation are those of the entity's lease. Pure functions; any thread.
void seal(proto::SubLease& lease, const Grant& grant, std::string_view key);

/// Compares in constant time.
bool isSealed(const proto::SubLease& lease, const Grant& grant, std::string_view key);

}  // namespace axon::collaboration
