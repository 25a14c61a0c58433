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

namespace axon::cyton {

/// How one axon-cyton is started.
struct Settings {
    std::string arm = "127.0.0.1:8201";  ///< host:port, or a serial device
    std::string application = "cyton";
    std::string instance;
    std::string name;   ///< of the entity; empty: that of the basic profile
    std::string ports;  ///< a ports.cfg, or "first-last"; empty: the Entity Interfacer's range
    /// Without an answer for so long the controller is lost.
    std::chrono::steady_clock::duration silence_limit = std::chrono::milliseconds{1000};
    /// Without a sign of life of this process for so long its guard stops the arm; zero: there is no guard.
    std::chrono::milliseconds guard_silence{200};
    std::array<double, 3> at_mm{};  ///< where the arm's base stands, told to clients as the entity's position
    std::filesystem::path profiles;  ///< the folder of the two profiles; empty: found beside the program
    std::vector<std::filesystem::path> resources;  ///< folders in which absolute urls of resources may lead
};

/// A setting that cannot be used; the message says what was expected.
class BadSetting : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// "5500-5600" → the two numbers. Throws BadSetting.
std::pair<std::uint16_t, std::uint16_t> parsePortRange(const std::string& text);
/// "600,3000,700" (mm) → a place. Throws BadSetting.
std::array<double, 3> parsePlace(const std::string& text);
/// A serial device without a speed gets 115200 baud: postures at 25 a second need more than half of 38400.
std::string withSpeed(const std::string& arm);
/// The basic profile with another name in its root element; everything else stays as it is. Throws
/// BadSetting.
std::string withEntityName(const std::string& xml, std::string_view name);
/// The folder with basic_profile.xml and services_profile.xml: what the settings say, else
/// ../share/axon/robots/cyton seen from the program. Throws BadSetting.
std::filesystem::path profileFolder(const Settings& settings);

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

}  // namespace axon::cyton
