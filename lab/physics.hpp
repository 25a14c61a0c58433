// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "lab/arcos_server.hpp"
#include "lab/description.hpp"

namespace axon::lab {

/// Where a robot really is, whatever its odometry says: for tests and pictures, never for robot applications.
struct Truth {
    double x_m = 0;
    double y_m = 0;
    double theta_deg = 0;
    double speed_m_s = 0;  ///< along the robot's own x axis
    double rotation_deg_s = 0;
    double lift_mm = 0;     ///< of the gripper, above its lower end
    double opening_mm = 0;  ///< between its paddles
    /// Everything that its body ever touched with more than a breath, each once: "wall", tables, boxes,
    /// obstacles, robots and devices by their names, objects that were not between the paddles.
    std::vector<std::string> touched;
};

struct ObjectTruth {
    std::string name;
    double x_m = 0, y_m = 0;
    double z_m = 0;        ///< of the lowest point of its axis: its underside while it stands
    double theta_deg = 0;  ///< about the vertical
    double tilt_deg = 0;   ///< of its axis from the vertical; above 45 it was knocked over
    double speed_m_s = 0;
    std::vector<std::string> on;  ///< what it touches: tables, boxes, "floor", robots, devices
};

/// What can be broken on a robot, and for how long: until it is mended.
struct Fault {
    enum class Kind {
        DeadSonar,      ///< `which` of 24 hears nothing any more
        StuckGripper,   ///< paddles and lift stay where they are
        SlippingWheel,  ///< `which`: 0 left, 1 right; its tyre has hardly any grip
        FlatBattery,    ///< at its lowest voltage
    };
    Kind kind = Kind::DeadSonar;
    int which = 0;
};

/// The world's bodies in MuJoCo: what robots sense, and what wheels, grippers, cameras and devices do. Time
/// passes only in step(); the same description, options and calls give the same numbers. Threads: none, not
/// thread-safe. The constructor throws BadDescription for a world that cannot be built. Names and numbers
/// that are not there: std::invalid_argument.
class Physics {
  public:
    static constexpr Duration kPeriod = std::chrono::milliseconds{4};

    struct Options {
        std::uint64_t seed = 1;  ///< of the sensors' noise
        double noise = 0;        ///< 1: as much as the real sensors have (peoplebot_geometry.hpp), 0: none
    };

    explicit Physics(const WorldDescription& world) : Physics(world, Options()) {}
    Physics(const WorldDescription& world, const Options& options);
    ~Physics();
    Physics(const Physics&) = delete;
    Physics& operator=(const Physics&) = delete;

    /// Senses with each robot's body. The reference is good until the next call.
    const BodyReadings& sense(std::size_t robot);
    void setWheels(std::size_t robot, const ArcosServer::WheelSpeeds& speeds);
    void setGripper(std::size_t robot, const GripperSpeeds& speeds);
    void setCamera(std::size_t robot, const CameraPose& pose);
    void setLaser(std::size_t robot, const LaserSettings& settings);
    /// Its controller and body, which step() steps and reset() resets. Good as long as this is.
    Device& device(std::size_t index);
    const Device& device(std::size_t index) const;
    /// Advances by kPeriod.
    void step();
    double time_s() const;
    /// Everything as it was in the beginning; faults are mended, obstacles gone, the noise begins anew.
    void reset();

    Truth truth(std::size_t robot) const;
    std::vector<ObjectTruth> truthOfObjects() const;
    void forgetTouches();

    // What an experimenter does with the hands.
    /// Puts an object down, upright and at rest; z is the height of its underside.
    void placeObject(const std::string& name, double x_m, double y_m, double z_m, double theta_deg);
    void placeRobot(std::size_t robot, double x_m, double y_m, double theta_deg);
    /// A box that stands where it is told and cannot be pushed; at most kObstacles at once. A name that
    /// exists is moved and resized.
    void addObstacle(const Box& box);
    void moveObstacle(const std::string& name, double x_m, double y_m, double theta_deg);
    void removeObstacle(const std::string& name);
    void setFault(std::size_t robot, const Fault& fault, bool broken);

  private:
    friend class PhysicsView;
    class Model;
    std::unique_ptr<Model> model_;
};

}  // namespace axon::lab
