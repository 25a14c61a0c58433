// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <vector>

#include "robots/arcos/client_session.hpp"
#include "robots/peoplebot/floor_plan.hpp"
#include "robots/peoplebot/map_pose.hpp"

namespace axon::peoplebot {

/// Where the robot takes itself to be, and how sure it is.
struct Estimate {
    MapPose pose;
    double spread_mm = 0;  ///< standard deviation of the particles
    double spread_deg = 0;
    double fit = 0;          ///< share of the laser's readings that end at a wall of the map; 1 is perfect
    int scans = 0;           ///< that the estimate rests on
    TimePoint scan_taken{};  ///< of the last of them
};

/// The share of a scan's readings that end at a wall of the map when it was taken from there, 0 to 1.
double fitOf(const FloorPlan& plan, const arcos::LaserScan& scan, const MapPose& pose);

/// Monte-Carlo localisation on a map (F. Dellaert, D. Fox, W. Burgard, S. Thrun, "Monte Carlo localization
/// for mobile robots", ICRA 1999), by MRPT: particles move with the odometry and are weighed by how well the
/// laser's readings end at walls, so what stands about in the room matters little. Between scans the odometry
/// carries the estimate on.
///
/// A robot that stands adds no scans: they would tell the same again and make it too sure. Fails never; a
/// wrong start shows as a poor fit. Not thread-safe; an update takes some milliseconds. One at a time in a
/// process draws reproducible numbers for a seed, as MRPT's generator is global.
class Localisation {
  public:
    struct Start {
        MapPose pose;
        double spread_mm = 150;  ///< how far off it may be, standard deviation
        double spread_deg = 6;
    };
    static constexpr int kParticles = 500;

    Localisation(std::shared_ptr<const FloorPlan> plan, const Start& start, const arcos::RobotState& robot,
                 unsigned seed = 1);
    ~Localisation();

    /// With each news of the robot.
    void update(const arcos::RobotState& robot);

    Estimate estimate() const;
    /// At most so many of the particles, on the map.
    std::vector<MapPose> particles(std::size_t most) const;
    const std::shared_ptr<const FloorPlan>& plan() const { return plan_; }

  private:
    struct Filter;
    void weigh(const arcos::LaserScan& scan);

    const std::shared_ptr<const FloorPlan> plan_;
    std::unique_ptr<Filter> filter_;
    MapPose odometry_;         // now
    MapPose filter_odometry_;  // of the particles
    Estimate estimate_;        // at filter_odometry_
    std::uint64_t last_scan_ = 0;
};

}  // namespace axon::peoplebot
