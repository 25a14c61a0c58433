// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "common/ids.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// What proves to a server that this process may register its UUID (transport/ice/bound_uuid.hpp). `secret`
/// is empty for a UUID of an earlier release, which is not bound.
struct Identity {
    std::string secret;
    std::string uuid;  ///< for a state folder that has none yet
};

/// Keeps the secret in the state folder, and makes it there for a robot that has no UUID yet. Throws
/// std::runtime_error, with the fix, where the secret is damaged or is not that of the UUID, or is missing
/// beside a bound one. A UUID that is none is left to the core, which says so.
Identity identityIn(Storage& storage, RandomSource& random);

}  // namespace axon::entity_manager
