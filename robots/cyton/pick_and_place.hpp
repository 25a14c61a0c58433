// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "common/result.hpp"
#include "robots/cyton/kinematics.hpp"
#include "robots/cyton/trajectory.hpp"

namespace axon::cyton {

/// What Grab and Place is to do. Positions are those of the middle of the object's underside in the frame of
/// the arm's base (geometry.hpp), metres; yaws turn the sides of a box away from the frame's axes, radians.
struct PickAndPlaceRequest {
    Point pick{0.030, 0.365, 0.100};
    Point place{0.390, 0, 0};
    std::optional<double> pick_yaw;   ///< none: round, or a side faces the arm
    std::optional<double> place_yaw;  ///< none: as it turns out
    double width = 0.028;             ///< between the pads, and at most so deep; up to kWidest
    double height = 0.080;
    double speed = 0.25;  ///< part of the servos' highest rates

    static constexpr double kWidest = 0.030;
};

struct PickAndPlacePlan {
    std::vector<Leg> legs;     ///< from the posture where the arm is, to home
    std::size_t grasped = 0;   ///< from this leg on the object is in the claws,
    std::size_t released = 0;  ///< and from this one on no more
    double tilt = 0;           ///< of the tool, both times; 0 points straight down, 90 degrees outwards
    double carried_tilt = 0;   ///< of the object while it is carried, at the most; rad
    double grip_height = 0;    ///< above the underside, m
};

/// Why this cannot be, without searching; empty if it may be possible.
std::string objection(const PickAndPlaceRequest& request);

/// Plans the whole motion: open and go before the object, approach along the tool, close, lift, carry, lower,
/// release, back off, home. The object stays upright, so that the tool tilts alike at both places: straight
/// down is tried first, then further and further outwards. The whole way is checked: joints within limits,
/// arm, hand and object above the plane of the base, off the surface below the object (taken to be 0.12 m
/// wide) and off the object itself while it stands. What else stands around, nobody here knows. Of the ways
/// looked at one is taken that tilts the object by no more than 45 degrees, or else the one that tilts it
/// least.
///
/// Takes up to two seconds where it finds nothing, and some seconds where it finds none that is level;
/// `cancelled` is asked in between. Refuses with the reason.
Result<PickAndPlacePlan> planPickAndPlace(Kinematics& kinematics, const PickAndPlaceRequest& request,
                                          const Posture& start, const std::function<bool()>& cancelled = {});

/// From any posture to another in one leg, by way of others where the straight way would touch the plane of
/// the base; nothing when no way was found.
std::optional<std::vector<Posture>> wayBetween(const Kinematics& kinematics, const Posture& from,
                                               const Posture& to);

}  // namespace axon::cyton
