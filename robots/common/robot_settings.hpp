// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace axon::robots {

/// How a robot application is started, whatever its robot. The settings of one kind of robot derive from it
/// and add what only that kind has.
struct RobotSettings {
    /// `kind_of_robot`: "cyton" of the program axon-cyton, whose profiles are installed in
    /// share/axon/robots/cyton; also the first value of `application`.
    explicit RobotSettings(std::string kind_of_robot) : kind(std::move(kind_of_robot)), application(kind) {}

    std::string kind;
    std::string application;  ///< the name that the Entity Manager is configured with
    std::string instance;     ///< tells equal applications on one host apart
    std::string name;         ///< of the entity; empty: that of the basic profile
    std::string ports;        ///< a ports.cfg, or "first-last"; empty: the Entity Interfacer's range
    /// Without a sign of life of this process for so long its guard stops the robot; zero: there is no guard.
    std::chrono::milliseconds guard_silence{200};
    std::filesystem::path profiles;  ///< the folder of the two profiles; empty: the installed one
    std::vector<std::filesystem::path> resources;  ///< folders in which absolute urls of resources may lead
};

/// A setting that cannot be used; the message says what was expected.
class BadSetting : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// "5500-5600" → the two numbers. Throws BadSetting.
std::pair<std::uint16_t, std::uint16_t> parsePortRange(const std::string& text);
/// "600,-20.5,700" → the three finite numbers. Throws BadSetting, which says that `what`, such as "--at", was
/// to be `expected`, such as "X,Y,Z in mm, for example 600,3000,700".
std::array<double, 3> parseThreeNumbers(std::string_view text, std::string_view what,
                                        std::string_view expected);

/// ../share/axon/robots/KIND seen from the program, in the build tree as where it is installed.
std::filesystem::path installedFolder(const std::string& kind);
/// The folder with basic_profile.xml and services_profile.xml: what the settings say, else the installed one.
/// Throws BadSetting.
std::filesystem::path profileFolder(const RobotSettings& settings);
/// The basic profile with another name in its root element; everything else stays as it is. Throws
/// BadSetting.
std::string withEntityName(const std::string& xml, std::string_view name);

/// The whole of a file; empty where it cannot be read.
std::string contentOf(const std::filesystem::path& file);

/// A file that lives as long as this object. Throws std::system_error.
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

}  // namespace axon::robots
