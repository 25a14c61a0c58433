// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>

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
};

/// The world's bodies in MuJoCo: what robots sense, and what the wheels do. Time passes only in step(); the
/// same description and the same calls give the same numbers. Threads: none, not thread-safe. The constructor
/// throws BadDescription for a world that cannot be built.
class Physics {
  public:
    static constexpr Duration kPeriod = std::chrono::milliseconds{4};

    explicit Physics(const WorldDescription& world);
    ~Physics();
    Physics(const Physics&) = delete;
    Physics& operator=(const Physics&) = delete;

    /// Senses with each robot's body. The reference is good until the next call.
    const BodyReadings& sense(std::size_t robot);
    void setWheels(std::size_t robot, const ArcosServer::WheelSpeeds& speeds);
    /// Advances by kPeriod.
    void step();
    Truth truth(std::size_t robot) const;

  private:
    class Model;
    std::unique_ptr<Model> model_;
};

}  // namespace axon::lab
