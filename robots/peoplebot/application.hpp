// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/entity_interfacer.hpp>

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>

#include "common/shared_clock.hpp"
#include "robots/arcos/arcos_client.hpp"
#include "robots/lms2xx/lms2xx_client.hpp"
#include "robots/peoplebot/drive_gate.hpp"
#include "robots/peoplebot/grasp_services.hpp"
#include "robots/peoplebot/localisation.hpp"
#include "robots/peoplebot/motion.hpp"
#include "robots/peoplebot/settings.hpp"
#include "robots/peoplebot/wander.hpp"

namespace axon::peoplebot {

/// One PeopleBot as an entity: its services (thesis 4.1.2), the streams of what it senses and of where it
/// takes itself to be, and a stop that reaches the motors at once. Entity Interfacer on one side, ARCOS on
/// the other, nothing else of Axon.
///
/// Once a map was used, the robot goes on finding itself on it, whatever it does, until the program ends; its
/// pose is then that on the map, and the odometry's from `at` on before.
///
/// While the robot cannot be reached its services are inactive and a running task fails with ROBOT_LOST; both
/// recover when it is back. Threads: those of the Entity Interfacer (stop thread, data thread, one
/// per task), that of the ArcosClient, and that of the Lms2xxClient where the laser has a line of its own.
/// The constructor throws what is wrong with the settings (BadSetting, std::invalid_argument,
/// axon::Misconfiguration, fuzzy::BadRules).
class Application {
  public:
    explicit Application(const Settings& settings,
                         std::shared_ptr<const Clock> clock = clockFromEnvironment());
    ~Application();
    Application(const Application&) = delete;
    Application& operator=(const Application&) = delete;

    /// Listens for the Entity Manager; returns at once.
    void start();
    /// start(), then until SIGINT or SIGTERM.
    void run();

  private:
    // Each service is registered in a function of its own: its handler, and what speaks against a task.
    using Objection = std::function<std::string(const Task&)>;
    using Handler = std::function<void(Task&)>;
    void offer(const std::string& service, Objection objection, Handler handler);
    void offerServices();
    void offerDriving();
    void offerTurning();
    void offerWander();
    void offerNavigation();
    void offerTableApproach();

    /// `configure`: before each step, what has been set since. `report`: after it, of the robot as the step
    /// saw it.
    template <class Motion>
    void perform(Task& task, Motion& motion, const std::function<void()>& configure,
                 const std::function<void(const arcos::RobotState&)>& report);
    Decision consider(const Task& task) const;

    void navigate(Task& task);
    /// The map that lies in this file, read once. Throws mapper3::BadMap.
    std::shared_ptr<const FloorPlan> planOf(const std::filesystem::path& file) const;
    /// Where the robot is on a map: what the task says, else what is known, else startFromHome(). Nothing:
    /// the present localisation is on this map. Throws std::invalid_argument with the remedy.
    std::optional<Localisation::Start> startOn(const std::shared_ptr<const FloorPlan>& plan,
                                               const Task& task) const;

    // On the stop thread.
    void onStop();

    // On the robot's thread.
    void onRobotOnline(const arcos::RobotIdentity& identity);
    void onRobotState(const arcos::RobotState& robot);
    void onRobotLost(const std::string& reason);
    void setServicesActive(bool active, const std::string& reason);
    void locate(const arcos::RobotState& robot);
    void publish(const arcos::RobotState& robot);
    /// To whoever holds the entity, and at the terminal. Any thread.
    void tell(const std::string& text);
    void tellWatchdog(const arcos::RobotConfig& config);

    // On the laser's thread, where it has a line of its own.
    void onLaserOnline(const lms2xx::Setting& setting);
    void onLaserScan(const lms2xx::Scan& scan);
    void onLaserLost(const std::string& reason);

    // Constant after construction.
    const std::shared_ptr<const Clock> clock_;
    std::unique_ptr<robots::TemporaryFile> renamed_profile_;
    EntityInterfacer entity_;
    Stream pose_stream_;
    Stream sonar_stream_;
    Stream battery_stream_;
    Stream laser_stream_;
    Stream localisation_stream_;
    Stream quality_stream_;
    Stream particles_stream_;
    const bool start_given_;
    std::map<std::string, Objection> services_;
    std::shared_ptr<const fuzzy::Engine> wander_rules_;
    std::shared_ptr<const fuzzy::Engine> navigation_rules_;
    std::unique_ptr<arcos::ArcosClient> robot_;
    std::unique_ptr<lms2xx::Lms2xxClient> laser_;  // none where the robot itself sends the scans; uses robot_
    std::unique_ptr<DriveGate> gate_;
    std::unique_ptr<GraspServices> grasp_;

    /// The server information packet after which a robot at rest obeys the last stop; 0: no stop waits for
    /// that.
    std::atomic<std::uint64_t> standstill_after_ = 0;

    struct ReadMap {
        std::filesystem::path file;
        std::filesystem::file_time_type written;
        std::shared_ptr<const FloorPlan> plan;
    };
    mutable std::mutex read_map_mutex_;
    mutable ReadMap read_map_;  // guarded by read_map_mutex_: the last one

    mutable std::mutex place_mutex_;              // held for some milliseconds while a scan is weighed
    MapPose origin_;                              // of the odometry; guarded by place_mutex_
    MapPose pose_;                                // guarded by place_mutex_
    std::unique_ptr<Localisation> localisation_;  // guarded by place_mutex_; none until a map was used
    bool odometry_began_anew_ = false;            // guarded by place_mutex_

    // Confined to the robot's thread.
    std::uint64_t last_scan_sent_ = 0;
    std::optional<MapPose> told_position_;
    std::string last_loss_;
    bool was_online_ = false;
    bool watchdog_told_ = false;

    // Confined to the laser's thread.
    std::string last_laser_loss_;
    bool pollution_told_ = false;
};

}  // namespace axon::peoplebot
