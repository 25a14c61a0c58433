// SPDX-License-Identifier: MIT
#pragma once
#include <string>
#include <string_view>
#include <utility>

#include "common/refusal.hpp"

// What the servers refuse with. Pure; any thread.
namespace axon {

/// A refusal without more details than its text.
inline Refusal refuse(RefusalCode code, std::string message) {
    return {code, std::move(message), {}};
}

/// Nobody knows the entity of this id, which may be any text.
inline Refusal unknownEntity(std::string_view entity) {
    return refuse(RefusalCode::UnknownEntity, "no entity " + std::string(entity.substr(0, 64)) +
                                                  " is connected; 'axon ls' shows those that are there");
}

}  // namespace axon
