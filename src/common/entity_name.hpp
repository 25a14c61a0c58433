// SPDX-License-Identifier: MIT
#pragma once
#include <string_view>

#include "common/ids.hpp"

namespace axon {

/// Whether an entity may be called so: not by what people write when they mean another one, which is "NAME#2"
/// (the second of those that are called NAME) or a UUID. So a name that is shown never means two robots.
inline bool isEntityName(std::string_view name) {
    if (Id128::parse(name)) return false;
    const auto hash = name.rfind('#');
    return hash == std::string_view::npos || hash + 1 == name.size() ||
           name.find_first_not_of("0123456789", hash + 1) != std::string_view::npos;
}

}  // namespace axon
