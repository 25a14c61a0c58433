// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/entity_interfacer.hpp>

#include <atomic>
#include <functional>
#include <memory>
#include <vector>

#include "common/shared_clock.hpp"
#include "robots/cyton/pick_and_place.hpp"
#include "robots/cyton/servo_gate.hpp"
#include "robots/cyton/settings.hpp"
#include "robots/cyton/trajectory.hpp"
#include "robots/ssc32/ssc32_client.hpp"

namespace axon::cyton {

/// One Cyton as an entity: the services Reach Demo, Control, Grab and Place, the streams joints and gripper,
/// and a stop that freezes the arm at once. Entity Interfacer on one side, an SSC-32 on the other, nothing
/// else of Axon.
///
/// Postures are sent kRate times a second, each to be reached within kReach: an application that dies leaves
/// an arm that stands still 50 ms later. While the controller cannot be reached the services are inactive and
/// a running task fails with ROBOT_LOST; both recover when it is back. Connecting moves nothing;
/// where the controller has given no pulse since it was switched on, the first task goes home slowly first.
///
/// Threads: those of the Entity Interfacer (stop thread, data thread, one per task) and that of the
/// Ssc32Client. The constructor throws what is wrong with the settings (BadSetting, std::invalid_argument,
/// axon::Misconfiguration).
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
    /// Legs from a posture to the end of the task; empty when the task has its verdict already.
    using Planning = std::function<std::vector<Leg>(const Posture& from)>;
    using OnLeg = std::function<void(std::size_t leg, const std::string& name)>;
    /// How many times as fast as it was planned the motion is to be now.
    using Pace = std::function<double()>;

    void offerServices();
    Decision consider(const Task& task) const;
    void reachDemo(Task& task);
    void control(Task& task);
    void grabAndPlace(Task& task);

    /// The whole of a task: takes the arm, plans, plays, gives the arm back. True when it is done; otherwise
    /// the task was stopped, or has its verdict.
    bool perform(Task& task, const Planning& plan, const OnLeg& on_leg, const Pace& pace);
    bool play(Task& task, std::vector<Leg> legs, const OnLeg& on_leg, const Pace& pace);
    /// Where the arm is; after power-up by going home first. Nothing when the task has to end.
    std::optional<Posture> findOut(Task& task);
    /// Why a command did not get through; gives the verdict.
    void tellLoss(Task& task);

    // On the stop thread.
    void onStop();

    // On the controller's thread.
    void onOnline(const std::vector<int>& pulses_us);
    void onStatus(bool moving);
    void onLost(const std::string& reason);
    void setServicesActive(bool active, const std::string& reason);

    // Constant after construction.
    const std::shared_ptr<const Clock> clock_;
    std::unique_ptr<robots::TemporaryFile> renamed_profile_;
    EntityInterfacer entity_;
    Stream joints_stream_;
    Stream gripper_stream_;
    std::unique_ptr<ssc32::Ssc32Client> arm_;
    std::unique_ptr<ServoGate> gate_;

    /// A task ended between closing the claws and opening them: to begin another would drop what they hold.
    std::atomic<bool> may_hold_ = false;
    std::atomic<std::uint64_t> statuses_ = 0;
    /// The status after which an arm without a move obeys the last stop; 0: no stop waits for that.
    std::atomic<std::uint64_t> standstill_after_ = 0;

    // Confined to the controller's thread.
    std::string last_loss_;
    bool was_online_ = false;
};

}  // namespace axon::cyton
