// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <vector>

#include "robots/cyton/trajectory.hpp"

namespace axon::cyton {

/// The motion of the service Reach Demo: upright, then each joint to its minimum, its maximum and back while
/// the others stay upright, then home. `speed` as in Trajectory.
std::vector<Leg> reachDemo(const Posture& from, double speed);

}  // namespace axon::cyton
