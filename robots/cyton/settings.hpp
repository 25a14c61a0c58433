// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <chrono>
#include <string>

#include "robots/common/robot_settings.hpp"

namespace axon::cyton {

using robots::BadSetting;

/// How one axon-cyton is started.
struct Settings : robots::RobotSettings {
    Settings() : RobotSettings("cyton") {}

    std::string arm = "127.0.0.1:8201";  ///< host:port, or a serial device
    /// Without an answer for so long the controller is lost.
    std::chrono::steady_clock::duration silence_limit = std::chrono::milliseconds{1000};
    std::array<double, 3> at_mm{};  ///< where the arm's base stands, told to clients as the entity's position
};

/// "600,3000,700" (mm) → a place. Throws BadSetting.
std::array<double, 3> parsePlace(const std::string& text);
/// A serial device without a speed gets 115200 baud: postures at 25 a second need more than half of 38400.
std::string withSpeed(const std::string& arm);

}  // namespace axon::cyton
