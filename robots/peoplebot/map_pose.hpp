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

    /// The other pose as seen from this one: then(between(other)) is the other.
    MapPose between(const MapPose& other) const {
        const double a = heading_deg * std::numbers::pi / 180;
        const double dx = other.x_mm - x_mm;
        const double dy = other.y_mm - y_mm;
        return {std::cos(a) * dx + std::sin(a) * dy, std::cos(a) * dy - std::sin(a) * dx,
                other.heading_deg - heading_deg};
    }
};

}  // namespace axon::peoplebot
