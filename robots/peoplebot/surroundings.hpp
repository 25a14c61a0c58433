// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "robots/arcos/client_session.hpp"
#include "robots/peoplebot/map_pose.hpp"

namespace axon::peoplebot {

/// How much room there is between the robot's hull and what its range sensors see, in millimetres.
struct Clearance {
    static constexpr double kNothing_mm = 5000;
    double left = kNothing_mm;
    double front = kNothing_mm;  ///< within the lane that the robot would drive along
    double right = kNothing_mm;
    double rear = kNothing_mm;
    double swing =
        kNothing_mm;     ///< to what the rear may sweep in a turn on the spot; negative: it would touch
    bool heard = false;  ///< a front sonar spoke within the last second, or the laser measured something
};

/// What the range sensors saw last, in the odometry's frame. A sonar is heard every third of a second, and
/// the robot moves meanwhile; so readings are remembered where they were made and looked at from where the
/// robot is. A sonar tells how far something is and not where in its cone, so an echo stands for the cone's
/// whole arc. With Echoes::WhereTheLaserSees, what the laser sees in the cone as far away is taken to be what
/// the echo comes from; only other echoes stand for the arc, as what is above or below the laser's plane may
/// be anywhere on it. I/O-free, not thread-safe.
class Surroundings {
  public:
    static constexpr Duration kMemory = std::chrono::seconds{1};

    /// What an echo stands for. Wandering keeps a margin by the whole arc; navigation has to get through
    /// doors.
    enum class Echoes : std::uint8_t { WholeArc, WhereTheLaserSees };
    explicit Surroundings(Echoes echoes = Echoes::WholeArc) : echoes_stand_for_(echoes) {}

    /// With each news of the robot.
    void update(const arcos::RobotState& robot);
    Clearance clearance() const;
    /// The least room between the hull and what a turn on the spot by so much (positive: to the left) brings
    /// nearer to it, on the way or at its end; negative: it would touch.
    double roomToTurn(double by_deg) const;

    struct Sighting {
        double x_mm = 0, y_mm = 0;  ///< in the robot's frame
        bool laser = false;         ///< else the middle of a sonar's arc
        double distance_mm = 0;     ///< from the sensor
        double sensor_x_mm = 0, sensor_y_mm = 0;
    };
    /// What is nearer to its sensor than `most_mm`, seen from the robot's present place.
    std::vector<Sighting> sightings(double most_mm) const;

  private:
    struct Echo {
        MapPose from;  // of the robot, odometry
        double range_mm = 0;
        TimePoint heard{};
        std::optional<MapPose> at{};  // where the laser sees what it comes from; odometry, without heading
    };
    std::optional<MapPose> seenByLaser(std::size_t sonar, const Echo& echo) const;
    template <class Visit>
    void forEachEcho(const Visit& visit) const;
    template <class Visit>
    void forEachSpot(const Visit& visit) const;

    const Echoes echoes_stand_for_;
    MapPose here_;
    TimePoint now_{};
    std::array<Echo, 24> echoes_{};
    std::shared_ptr<const arcos::LaserScan> laser_;
};

}  // namespace axon::peoplebot
