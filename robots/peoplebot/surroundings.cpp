// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/surroundings.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "robots/peoplebot/body.hpp"

namespace axon::peoplebot {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// Half of the lane: the hull and as much again as the robot wanders off while it corrects.
constexpr double kLane_mm = body::kRadius_mm + 45;
constexpr double kBesideAxis_mm = 50;
constexpr double kSideFrom_deg = 25;
constexpr double kSideTo_deg = 120;
constexpr double kSonarSeesUpTo_mm = 4900;
// How much an echo and the laser's reading of the same thing may differ: noise, and the way between the two.
constexpr double kSameRange_mm = 70;
constexpr double kSameBearing_deg = 3;
constexpr double kTurnGrain_deg = 5;
constexpr double kNearer_mm = 5;  // what a turn does not bring nearer than it is does not stand in its way

struct Spot {
    double x, y;
};

double fromHull_mm(Spot spot) {
    return std::hypot(spot.x - std::clamp(spot.x, body::kRear_mm, 0.0), spot.y) - body::kRadius_mm;
}

/// A point of the frame of `from`, in the frame of `here`.
Spot seenFrom(const MapPose& here, const MapPose& from, double x, double y) {
    const auto there = from.then({x, y, 0});
    const double a = here.heading_deg * kDegree;
    const double dx = there.x_mm - here.x_mm;
    const double dy = there.y_mm - here.y_mm;
    return {std::cos(a) * dx + std::sin(a) * dy, std::cos(a) * dy - std::sin(a) * dx};
}

}  // namespace

void Surroundings::update(const arcos::RobotState& robot) {
    here_ = {robot.x_mm, robot.y_mm, robot.heading_deg};
    now_ = robot.taken;
    laser_ = robot.laser;
    for (std::size_t i = 0; i < echoes_.size(); ++i) {
        const auto& sonar = robot.sonars[i];
        if (sonar.heard == TimePoint{} || sonar.heard == echoes_[i].heard) continue;
        Echo echo{here_, static_cast<double>(sonar.range_mm), sonar.heard};
        if (echoes_stand_for_ == Echoes::WhereTheLaserSees && echo.range_mm <= kSonarSeesUpTo_mm)
            echo.at = seenByLaser(i, echo);
        echoes_[i] = echo;
    }
}

std::optional<MapPose> Surroundings::seenByLaser(std::size_t sonar, const Echo& echo) const {
    if (!laser_ || now_ - laser_->taken > kMemory) return std::nullopt;
    const auto& pose = body::kSonars[sonar];
    const auto eye = echo.from.then({pose.x_mm, pose.y_mm, pose.direction_deg});
    const MapPose from{laser_->x_mm, laser_->y_mm, laser_->heading_deg};
    std::optional<MapPose> at;
    double nearest = echo.range_mm + kSameRange_mm;
    for (std::size_t i = 0; i < laser_->ranges_mm.size(); ++i) {
        const double range = laser_->ranges_mm[i];
        const double a = (laser_->start_deg + static_cast<double>(i) * laser_->step_deg) * kDegree;
        const double x = body::kLaserX_mm + range * std::cos(a);
        const double y = range * std::sin(a);
        const auto spot = seenFrom(eye, from, x, y);
        const double away = std::hypot(spot.x, spot.y);
        if (away > nearest || away < echo.range_mm - kSameRange_mm) continue;
        if (std::abs(std::atan2(spot.y, spot.x) / kDegree) > body::kSonarHalfCone_deg + kSameBearing_deg)
            continue;
        nearest = away;
        at = from.then({x, y, 0});
    }
    return at;
}

template <class Visit>
void Surroundings::forEachEcho(const Visit& visit) const {
    for (std::size_t i = 0; i < echoes_.size(); ++i) {
        const auto& echo = echoes_[i];
        if (echo.heard != TimePoint{} && now_ - echo.heard <= kMemory) visit(i, echo);
    }
}

template <class Visit>
void Surroundings::forEachSpot(const Visit& visit) const {
    forEachEcho([&](std::size_t i, const Echo& echo) {
        if (echo.range_mm > kSonarSeesUpTo_mm) return;
        if (echo.at) return visit(seenFrom(here_, {}, echo.at->x_mm, echo.at->y_mm));
        const auto& pose = body::kSonars[i];
        for (const double part : {-1.0, -0.5, 0.0, 0.5, 1.0}) {
            const double a = (pose.direction_deg + part * body::kSonarHalfCone_deg) * kDegree;
            visit(seenFrom(here_, echo.from, pose.x_mm + echo.range_mm * std::cos(a),
                           pose.y_mm + echo.range_mm * std::sin(a)));
        }
    });
    if (!laser_ || now_ - laser_->taken > kMemory) return;
    const MapPose from{laser_->x_mm, laser_->y_mm, laser_->heading_deg};
    for (std::size_t i = 0; i < laser_->ranges_mm.size(); ++i) {
        const double range = laser_->ranges_mm[i];
        if (range > Clearance::kNothing_mm) continue;
        const double a = (laser_->start_deg + static_cast<double>(i) * laser_->step_deg) * kDegree;
        visit(seenFrom(here_, from, body::kLaserX_mm + range * std::cos(a), range * std::sin(a)));
    }
}

Clearance Surroundings::clearance() const {
    Clearance room;
    forEachSpot([&room](Spot spot) {
        const double away = fromHull_mm(spot);
        const double bearing = std::atan2(spot.y, spot.x) / kDegree;
        if (std::abs(spot.y) <= kLane_mm) {
            if (spot.x > 0)
                room.front = std::min(room.front, std::max(0.0, std::max(away, spot.x - body::kRadius_mm)));
            if (spot.x < body::kRear_mm) room.rear = std::min(room.rear, std::max(0.0, away));
        }
        if (std::abs(bearing) >= kSideFrom_deg && std::abs(bearing) <= kSideTo_deg) {
            auto& side = bearing > 0 ? room.left : room.right;
            side = std::min(side, std::max(0.0, away));
        }
        if (spot.x <= kBesideAxis_mm)
            room.swing = std::min(room.swing, std::hypot(spot.x, spot.y) - body::kSwing_mm);
    });
    forEachEcho([&](std::size_t i, const Echo& /*echo*/) {
        if (std::abs(body::kSonars[i].direction_deg) <= 50) room.heard = true;
    });
    if (laser_ && now_ - laser_->taken <= kMemory && laser_->sees()) room.heard = true;
    return room;
}

double Surroundings::roomToTurn(double by_deg) const {
    double room = Clearance::kNothing_mm;
    const int steps = static_cast<int>(std::ceil(std::abs(by_deg) / kTurnGrain_deg));
    forEachSpot([&](Spot spot) {
        if (std::hypot(spot.x, spot.y) - body::kSwing_mm >= room) return;
        const double now = fromHull_mm(spot);
        for (int i = 1; i <= steps; ++i) {
            const double a = by_deg * i / steps * kDegree;
            const double then = fromHull_mm(
                {std::cos(a) * spot.x + std::sin(a) * spot.y, std::cos(a) * spot.y - std::sin(a) * spot.x});
            if (then < now - kNearer_mm) room = std::min(room, then);
        }
    });
    return room;
}

std::vector<Surroundings::Sighting> Surroundings::sightings(double most_mm) const {
    std::vector<Sighting> seen;
    const auto add = [&](const MapPose& from, double sensor_x, double sensor_y, double range,
                         double direction_deg, bool laser) {
        const double a = direction_deg * kDegree;
        const auto at = seenFrom(here_, from, sensor_x + range * std::cos(a), sensor_y + range * std::sin(a));
        const auto sensor = seenFrom(here_, from, sensor_x, sensor_y);
        seen.push_back({at.x, at.y, laser, range, sensor.x, sensor.y});
    };
    forEachEcho([&](std::size_t i, const Echo& echo) {
        const auto& pose = body::kSonars[i];
        if (echo.range_mm <= most_mm)
            add(echo.from, pose.x_mm, pose.y_mm, echo.range_mm, pose.direction_deg, false);
    });
    if (laser_ && now_ - laser_->taken <= kMemory) {
        const MapPose from{laser_->x_mm, laser_->y_mm, laser_->heading_deg};
        for (std::size_t i = 0; i < laser_->ranges_mm.size(); ++i) {
            const double range = laser_->ranges_mm[i];
            if (range <= most_mm)
                add(from, body::kLaserX_mm, 0, range,
                    laser_->start_deg + static_cast<double>(i) * laser_->step_deg, true);
        }
    }
    return seen;
}

}  // namespace axon::peoplebot
