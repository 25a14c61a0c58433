// SPDX-License-Identifier: MIT
#pragma once
#include <optional>
#include <string_view>

#include "common/planted_bug.hpp"

#ifdef AXON_PLANTED_BUGS
namespace axon {

/// The bug of this name; none: there is no such bug. For programs that plant one. Pure; any thread.
inline std::optional<PlantedBug> plantedBugOf(std::string_view name) {
#define AXON_MATCH(bug, what) \
    if (name == #bug) return PlantedBug::bug;
    AXON_EACH_PLANTED_BUG(AXON_MATCH)
#undef AXON_MATCH
    return std::nullopt;
}

}  // namespace axon
#endif
