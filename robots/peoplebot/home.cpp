// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/home.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

namespace axon::peoplebot {
namespace {

// A robot is put down about so near to its home, and its odometry may be off by so much afterwards.
constexpr double kReach_mm = 300;
constexpr double kReach_deg = 15;
constexpr double kStep_mm = 100;
constexpr double kStep_deg = 3;
// Two poses whose fits differ by less, and which are further from each other than the reach, cannot be told
// apart.
constexpr double kAsGood = 0.1;
constexpr double kSamePlace_mm = 2 * kReach_mm;
constexpr double kSameHeading_deg = 2 * kReach_deg;

constexpr auto kFix = "fix: give Start (X,Y,HEADING in mm, mm, degrees), or start the program with --at";

struct Candidate {
    MapPose pose;
    double fit = 0;
};

Candidate bestAround(const FloorPlan& plan, const MapPose& about, const arcos::LaserScan& scan) {
    Candidate best{about, fitOf(plan, scan, about)};
    for (double dx = -kReach_mm; dx <= kReach_mm; dx += kStep_mm) {
        for (double dy = -kReach_mm; dy <= kReach_mm; dy += kStep_mm) {
            for (double turn = -kReach_deg; turn <= kReach_deg; turn += kStep_deg) {
                const MapPose pose{about.x_mm + dx, about.y_mm + dy, about.heading_deg + turn};
                if (const double fit = fitOf(plan, scan, pose); fit > best.fit) best = {pose, fit};
            }
        }
    }
    return best;
}

bool samePose(const MapPose& a, const MapPose& b) {
    return std::hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm) <= kSamePlace_mm &&
           std::abs(std::remainder(a.heading_deg - b.heading_deg, 360.0)) <= kSameHeading_deg;
}

}  // namespace

Localisation::Start startFromHome(const FloorPlan& plan, const MapPose& moved, const arcos::LaserScan& scan) {
    auto homes = plan.map().homes;
    homes.insert(homes.end(), plan.map().docks.begin(), plan.map().docks.end());
    if (homes.empty())
        throw std::invalid_argument(fmt::format(
            "nobody has said where the robot is, and the map has neither RobotHome nor Dock; {}", kFix));
    std::vector<Candidate> candidates;
    for (const auto& home : homes)
        candidates.push_back(bestAround(
            plan, MapPose{home.at.x_mm, home.at.y_mm, home.heading_deg.value_or(0)}.then(moved), scan));
    const auto& best = *std::max_element(candidates.begin(), candidates.end(),
                                         [](const auto& a, const auto& b) { return a.fit < b.fit; });
    if (best.fit < kHomeFits) {
        throw std::invalid_argument(
            fmt::format("nobody has said where the robot is, and it does not seem to come from the map's "
                        "home: it would be near ({:.0f}, {:.0f}) mm then, but only "
                        "{:.0f} % of what the laser sees is on the map there; {}",
                        best.pose.x_mm, best.pose.y_mm, best.fit * 100, kFix));
    }
    for (const auto& other : candidates) {
        if (other.fit > best.fit - kAsGood && !samePose(other.pose, best.pose)) {
            throw std::invalid_argument(
                fmt::format("nobody has said where the robot is, and the map's homes look alike: it may be "
                            "near ({:.0f}, {:.0f}) mm at {:.0f} degrees or near ({:.0f}, {:.0f}) mm at "
                            "{:.0f} degrees; {}",
                            best.pose.x_mm, best.pose.y_mm, best.pose.heading_deg, other.pose.x_mm,
                            other.pose.y_mm, other.pose.heading_deg, kFix));
        }
    }
    return {.pose = best.pose};
}

}  // namespace axon::peoplebot
