// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/reach_demo.hpp"

#include <string>

#include "robots/cyton/pick_and_place.hpp"

namespace axon::cyton {

std::vector<Leg> reachDemo(const Posture& from, double speed) {
    std::vector<Leg> legs;
    const Kinematics kinematics;
    const auto upright = Posture{{}, from.opening_mm};
    const auto there = wayBetween(kinematics, from, upright);
    legs.push_back({"upright", Trajectory(there.value_or(std::vector{from, upright}), speed), 0.3});
    for (std::size_t i = 0; i < kJoints; ++i) {
        auto lowest = upright;
        auto highest = upright;
        lowest.joints[i] = kChain[i].minimum;
        highest.joints[i] = kChain[i].maximum;
        const std::string name = kChain[i].name;
        legs.push_back({name + " to its minimum", Trajectory({upright, lowest}, speed), 0.2});
        legs.push_back({name + " to its maximum", Trajectory({lowest, highest}, speed), 0.2});
        legs.push_back({name + " back", Trajectory({highest, upright}, speed), 0.2});
    }
    legs.push_back({"home", Trajectory({upright, {kHome, from.opening_mm}}, speed), 0.3});
    return legs;
}

}  // namespace axon::cyton
