// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <span>

#include "robots/peoplebot/floor_plan.hpp"

namespace axon::peoplebot {

/// From the robot's turning axis to the nearest obstacle: it can turn on the spot there.
inline constexpr double kLeastRoom_mm = 310;

struct Route {
    std::vector<mapper3::Point> points;  ///< straight legs; the first is where the robot stands
    double room_mm = 0;                  ///< what it keeps from obstacles away from its ends
    double length_mm() const;
};

struct RouteAnswer {
    std::optional<Route> route;
    std::string reason;  ///< why there is none
};

/// The shortest way by MRPT's grid planner (PlannerSimple2D) that keeps plenty of room from walls, what is
/// forbidden and what was sighted; where there is none, one with less room, down to kLeastRoom_mm. A robot
/// that stands nearer to something than that (in front of a table) first gets away from it. Takes up to a
/// second in large buildings. Any thread.
RouteAnswer findRoute(const FloorPlan& plan, const mapper3::Point& from, const mapper3::Point& to,
                      std::span<const mapper3::Point> sighted = {});

}  // namespace axon::peoplebot
