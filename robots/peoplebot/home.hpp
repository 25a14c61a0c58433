// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "robots/peoplebot/localisation.hpp"

namespace axon::peoplebot {

/// Where a robot is on a map when nobody told it: at the map's RobotHome or Dock when it was connected, and
/// carried on from there by `moved`, its odometry since then. With several homes the laser decides. `scan` is
/// what it sees at that place.
///
/// Throws std::invalid_argument with the remedy when the map has no home, when less than kHomeFits of what
/// the laser sees is on the map around any of them, and when two poses fit about as well that are
/// far from each other or look in different directions. Takes some milliseconds for each home. Any thread.
Localisation::Start startFromHome(const FloorPlan& plan, const MapPose& moved, const arcos::LaserScan& scan);

/// The share of the laser's readings that must end at walls. More than Navigation asks for later: here nobody
/// vouches for the place.
inline constexpr double kHomeFits = 0.7;

}  // namespace axon::peoplebot
