// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/identity.hpp"

#include <stdexcept>

#include "transport/ice/bound_uuid.hpp"

namespace axon::entity_manager {
namespace {

constexpr const char* kSecretKey = "secret";

[[noreturn]] void unusable(const std::string& how) {
    throw std::runtime_error(
        "The stored value \"secret\" " + how +
        ", and no server lets this robot register without it. Put the folder's backup in its place. Without "
        "one remove the folder: the robot then is a new entity, without saved values and resources.");
}

}  // namespace

Identity identityIn(Storage& storage, RandomSource& random) {
    const auto uuid = storage.load(kUuidKey);
    const auto stored = storage.load(kSecretKey);
    if (uuid && !Id128::parse(*uuid)) return {};  // the core says so
    if (uuid && !stored) {
        if (!transport::isBoundUuid(*uuid)) return {};
        unusable("is missing");
    }
    if (stored) {
        if (stored->size() != transport::kSecretBytes)
            unusable("is damaged: expected " + std::to_string(transport::kSecretBytes) + " bytes, found " +
                     std::to_string(stored->size()));
        if (uuid && *uuid != transport::boundUuid(*stored)) unusable("is not that of the stored \"uuid\"");
        return {*stored, transport::boundUuid(*stored)};
    }
    std::string secret(transport::kSecretBytes, '\0');
    random.fill(secret.data(), secret.size());
    storage.save(kSecretKey, secret);
    return {secret, transport::boundUuid(secret)};
}

}  // namespace axon::entity_manager
