// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/entity_interfacer.hpp>

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>

#include "robots/arcos/arcos_client.hpp"
#include "robots/peoplebot/drive_gate.hpp"
#include "robots/peoplebot/motion.hpp"
#include "robots/peoplebot/settings.hpp"

namespace axon::peoplebot {

/// One PeopleBot as an entity: the services Driving and Turning, the streams pose, sonar and battery, and a
/// stop that reaches the motors at once. Entity Interfacer on one side, ARCOS on the other, nothing else of
/// Axon.
///
/// While the robot cannot be reached its services are inactive and a running task fails with ROBOT_LOST; both
/// mend themselves when it is back. Threads: those of the Entity Interfacer (stop thread, data thread, one
/// per task) and that of the ArcosClient. The constructor throws what is wrong with the settings (BadSetting,
/// std::invalid_argument, axon::Misconfiguration).
class Application {
  public:
    explicit Application(const Settings& settings);
    ~Application();
    Application(const Application&) = delete;
    Application& operator=(const Application&) = delete;

    /// Listens for the Entity Manager; returns at once.
    void start();
    /// start(), then until SIGINT or SIGTERM.
    void run();

  private:
    void offerServices();
    void drive(Task& task);
    void turn(Task& task);
    template <class Motion>
    void perform(Task& task, Motion& motion, const std::function<void()>& report);
    Decision consider(const Task& task) const;

    // On the stop thread.
    void onStop();

    // On the robot's thread.
    void onRobotOnline(const arcos::RobotIdentity& identity);
    void onRobotState(const arcos::RobotState& robot);
    void onRobotLost(const std::string& reason);
    void setServicesActive(bool active, const std::string& reason);
    void publish(const arcos::RobotState& robot);

    // Constant after construction.
    const SteadyClock clock_;
    std::unique_ptr<TemporaryFile> renamed_profile_;
    EntityInterfacer entity_;
    Stream pose_stream_;
    Stream sonar_stream_;
    Stream battery_stream_;
    std::unique_ptr<arcos::ArcosClient> robot_;
    std::unique_ptr<DriveGate> gate_;

    /// The server information packet after which a robot at rest obeys the last stop; 0: no stop waits for
    /// that.
    std::atomic<std::uint64_t> standstill_after_ = 0;

    // Confined to the robot's thread.
    MapPose origin_;  // of the odometry
    MapPose pose_;
    std::optional<MapPose> told_position_;
    std::string last_loss_;
    bool was_online_ = false;
};

}  // namespace axon::peoplebot
