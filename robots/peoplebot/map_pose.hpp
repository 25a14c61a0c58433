// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cmath>
#include <numbers>

namespace axon::peoplebot {

/// A place and a heading on the floor.
struct MapPose {
    double x_mm = 0;
    double y_mm = 0;
    double heading_deg = 0;

    /// This pose taken as the origin of the other one's frame: how odometry, which starts at zero with each
    /// connection, becomes a place on the map.
    MapPose then(const MapPose& other) const {
        const double a = heading_deg * std::numbers::pi / 180;
        return {x_mm + std::cos(a) * other.x_mm - std::sin(a) * other.y_mm,
                y_mm + std::sin(a) * other.x_mm + std::cos(a) * other.y_mm, heading_deg + other.heading_deg};
    }
};

}  // namespace axon::peoplebot
