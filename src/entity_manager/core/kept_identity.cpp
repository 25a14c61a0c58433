// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/kept_identity.hpp"

#include <algorithm>
#include <array>
#include <iterator>
#include <stdexcept>

#include "common/planted_bug.hpp"
#include "entity_manager/core/stops/latch.hpp"
#include "entity_manager/core/stops/stop_ledger.hpp"
#include "entity_manager/core/turn/lease_book.hpp"

namespace axon::entity_manager {

bool partsAreLost(Storage& storage) {
    if (AXON_PLANTED(EpochNotSaved) || AXON_PLANTED(GenerationsNotReserved)) return false;
    const std::array there{storage.load(kUuidKey).has_value(), LeaseBook::isStored(storage),
                           storage.load(kGenerationKey).has_value()};
    return std::count(there.begin(), there.end(), there.front()) != std::ssize(there);
}

std::string loadUuid(Storage& storage, RandomSource& random, const std::string& given) {
    if (const auto stored = storage.load(kUuidKey)) {
        if (const auto id = Id128::parse(*stored)) return id->toString();
        throw std::runtime_error("The stored value \"uuid\" is damaged: expected a UUID, found \"" +
                                 stored->substr(0, 64) +
                                 "\". Put the folder's backup in its place. Without one remove the folder: "
                                 "the robot then is a new "
                                 "entity, without saved values and resources.");
    }
    const auto made = given.empty() ? Id128::uuid(random).toString() : given;
    // Before the uuid: a first life that is broken off in between leaves no latch that nobody set.
    if (!storage.load(kGenerationKey)) Latch::beginFirstLife(storage);
    storage.save(kUuidKey, made);
    return made;
}

}  // namespace axon::entity_manager
