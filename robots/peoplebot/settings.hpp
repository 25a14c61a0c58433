// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <filesystem>
#include <string>
#include <string_view>

#include "robots/common/robot_settings.hpp"
#include "robots/peoplebot/map_pose.hpp"

namespace axon::peoplebot {

using robots::BadSetting;

/// How one axon-peoplebot is started.
struct Settings : robots::RobotSettings {
    Settings() : RobotSettings("peoplebot") {}

    std::string robot = "127.0.0.1:8101";   ///< or a serial line: /dev/ttyS0, /dev/ttyUSB0:38400
    std::string camera = "127.0.0.1:8301";  ///< empty: none
    std::string laser;  ///< the line of a SICK LMS-200 that is wired to this computer, as `robot`; empty: by
                        ///< the robot
    /// Without a packet for so long the robot is lost; five are missing then.
    std::chrono::steady_clock::duration robot_silence_limit = std::chrono::milliseconds{500};
    MapPose at;             ///< where the robot stands when the program starts
    bool at_given = false;  ///< somebody said so; else a map's homes tell (home.hpp)
};

/// "1500,3000,90" (mm, mm, deg) → a pose. Throws BadSetting, which says that it is about `what`.
MapPose parsePose(const std::string& text, std::string_view what = "--at");
/// A file of rules: in the settings' folder, where there are some, else in the installed one. Throws
/// BadSetting.
std::filesystem::path rulesFile(const Settings& settings, const std::string& name);

}  // namespace axon::peoplebot
