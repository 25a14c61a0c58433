// SPDX-License-Identifier: GPL-2.0-or-later
// A Mapper3 map: any text is accepted or refused with its line, and of what is accepted every goal can be
// found by its name.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "robots/mapper3/map.hpp"

namespace {

void require(bool holds) {
    if (!holds) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    using namespace axon::mapper3;
    const std::string_view text(reinterpret_cast<const char*>(bytes), size);
    try {
        const auto map = parseMap(text, "f");
        for (const auto& goal : map.goals) {
            require(map.goal(goal.name) == &goal);
            require(std::isfinite(goal.at.x_mm) && std::isfinite(goal.at.y_mm));
            (void)map.forbidden(goal.at);
        }
        for (const auto& area : map.forbidden_areas) require(area.corners().size() == 4);
        if (!map.lines.empty() || !map.points.empty()) {
            const auto bounds = map.bounds();
            require(bounds.from.x_mm <= bounds.to.x_mm && bounds.from.y_mm <= bounds.to.y_mm);
        }
    } catch (const BadMap& error) {
        require(std::string_view(error.what()).starts_with("f"));
    }
    return 0;
}
