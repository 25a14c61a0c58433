// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "robots/peoplebot/map_pose.hpp"

namespace axon::peoplebot {

/// How one axon-peoplebot is started.
struct Settings {
    std::string robot = "127.0.0.1:8101";   ///< or a serial line: /dev/ttyS0, /dev/ttyUSB0:38400
    std::string camera = "127.0.0.1:8301";  ///< empty: none
    std::string laser;  ///< the line of a SICK LMS-200 that is wired to this computer, as `robot`; empty: by
                        ///< the robot
    std::string application = "peoplebot";
    std::string instance;
    std::string name;   ///< of the entity; empty: that of the basic profile
    std::string ports;  ///< a ports.cfg, or "first-last"; empty: the Entity Interfacer's range
    /// Without a packet for so long the robot is lost; five are missing then.
    std::chrono::steady_clock::duration robot_silence_limit = std::chrono::milliseconds{500};
    /// Without a sign of life of this process for so long its guard stops the robot; zero: there is no guard.
    std::chrono::milliseconds guard_silence{200};
    MapPose at;                      ///< where the robot stands when the program starts
    bool at_given = false;           ///< somebody said so; else a map's homes tell (home.hpp)
    std::filesystem::path profiles;  ///< the folder of the two profiles; empty: found beside the program
    std::vector<std::filesystem::path> resources;  ///< folders in which absolute urls of resources may lead
};

/// A setting that cannot be used; the message says what was expected.
class BadSetting : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// "5500-5600" → the two numbers. Throws BadSetting.
std::pair<std::uint16_t, std::uint16_t> parsePortRange(const std::string& text);
/// "1500,3000,90" (mm, mm, deg) → a pose. Throws BadSetting, which says that it is about `what`.
MapPose parsePose(const std::string& text, std::string_view what = "--at");
/// The basic profile with another name in its root element; everything else stays as it is. Throws
/// BadSetting.
std::string withEntityName(const std::string& xml, std::string_view name);
/// The folder with basic_profile.xml and services_profile.xml: what the settings say, else
/// ../share/axon/robots/peoplebot seen from the program. Throws BadSetting.
std::filesystem::path profileFolder(const Settings& settings);

/// A file of rules: in the settings' folder, where there are some, else in the installed one. Throws
/// BadSetting.
std::filesystem::path rulesFile(const Settings& settings, const std::string& name);

/// A file that lives as long as this object: the renamed profile, which the Entity Interfacer reads from
/// disk.
class TemporaryFile {
  public:
    explicit TemporaryFile(const std::string& content);
    ~TemporaryFile();
    TemporaryFile(const TemporaryFile&) = delete;
    TemporaryFile& operator=(const TemporaryFile&) = delete;
    const std::filesystem::path& path() const { return path_; }

  private:
    std::filesystem::path path_;
};

}  // namespace axon::peoplebot
