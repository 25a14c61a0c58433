// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "common/ids.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// Some of what every life writes at its start is in the Storage, and some is not: a disk or a person has
/// lost it. Ask before anything of this life is written. Waits for the disk.
bool partsAreLost(Storage& storage);

/// The UUID that the Storage has. Where it has none the entity is new: it gets `given`, or a random one where
/// that is empty. Throws std::runtime_error where the stored one is damaged. Waits for the disk.
std::string loadUuid(Storage& storage, RandomSource& random, const std::string& given);

}  // namespace axon::entity_manager
