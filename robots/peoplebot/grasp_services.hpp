// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/entity_interfacer.hpp>

#include <atomic>
#include <functional>
#include <string>

#include "robots/arcos/arcos_client.hpp"
#include "robots/peoplebot/camera_client.hpp"
#include "robots/peoplebot/device_gate.hpp"
#include "robots/peoplebot/drive_gate.hpp"
#include "robots/peoplebot/tracking.hpp"

namespace axon::peoplebot {

/// What the PeopleBot does with its gripper and its camera: the services Operate Gripper and Table Object
/// Tracking and Grabbing, and the stream camera (JPEG, at most 160 x 120, at most 5 a second).
///
/// A part of the Application: it is told what happens to the robot, and drives through the Application's
/// gate. Threads: on…() as named, tasks on theirs, thumbnails on the camera's. What it refers to must outlive
/// it. Ends after all tasks have ended and the robot's client has finished.
class GraspServices {
  public:
    struct Parts {
        EntityInterfacer& entity;
        std::shared_ptr<const Clock> clock;
        DriveGate& drive;
        std::function<arcos::ArcosClient&()> robot;  ///< there from the first task on
    };
    /// `camera`: host:port; empty: this robot has none. Throws std::invalid_argument.
    GraspServices(Parts parts, const std::string& camera);

    using Objection = std::function<std::string(const Task&)>;
    using Handler = std::function<void(Task&)>;
    /// Calls `offer` for each service: its name, what speaks against a task, its handler.
    void offer(const std::function<void(const std::string& service, Objection, Handler)>& offer);

    void onStop();                                      ///< stop thread: paddles, lift and camera halt
    void onRobotState(const arcos::RobotState& robot);  ///< robot's thread

  private:
    void operate(Task& task);
    void track(Task& task);
    bool tell(const GripperCommand& command);
    void sendThumbnail(const CameraPicture& picture);

    const Parts parts_;
    Stream thumbnails_;
    DeviceGate gripper_;
    DeviceGate head_;                // of the camera
    std::atomic<int> watching_ = 0;  // tasks that want pictures
    // Confined to the camera's thread.
    TimePoint next_thumbnail_{};
    std::string camera_trouble_;
    std::unique_ptr<CameraClient> camera_;  // none: no camera
};

}  // namespace axon::peoplebot
