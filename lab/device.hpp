// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "common/clock.hpp"

// MuJoCo's own names; its header stays out of ours.
using mjModel = struct mjModel_;
using mjData = struct mjData_;

/// What the laboratory has to know of a kind of robot that stands where it is put, such as an arm: how to
/// build it, and what its controller does. A kind is a folder of this one with a function that gives its
/// DeviceKind, and a word in the list DEVICES of CMakeLists.txt. PeopleBots, which drive about and sense, are
/// not devices; README.md says why.
namespace axon::lab {

/// Where a device stands; in a world's file one line.
struct DevicePlacement {
    std::string kind;  ///< DeviceKind::word
    std::string name{};
    double x = 0, y = 0;
    std::optional<double>
        z;  ///< of what it is screwed to; none: the table or box that is there, else the floor
    double theta = 0;
    std::optional<int> port;  ///< 0: one that is free; none: the usual one
};

/// A device as a part of a world's model, and the names that its parts have there.
struct DeviceModel {
    /// Whole sections of MJCF (<worldbody>, <actuator>, <equality> …), to be put directly below <mujoco>;
    /// angles in degrees. Geoms that range sensors see are in group 1, others in group 4.
    std::string mjcf;
    std::string root;  ///< the body that stands in the world: it and what is below it is the device
    std::vector<std::string> joints{};
    std::vector<std::string> actuators{};
    std::vector<std::string> geoms{};
    std::vector<std::string> sites{};
    std::vector<std::string> cameras{};
};

/// The same parts in a built model: MuJoCo's numbers, in the order in which DeviceModel names them. Model and
/// data outlive the device.
struct DeviceParts {
    const mjModel* model = nullptr;
    mjData* data = nullptr;
    int root = 0;
    std::vector<int> joints{};
    std::vector<int> actuators{};
    std::vector<int> geoms{};
    std::vector<int> sites{};
    std::vector<int> cameras{};
};
/// Throws std::invalid_argument when the model has no part of such a name.
DeviceParts partsOf(const DeviceModel& described, const mjModel* model, mjData* data);

/// One thing that ground truth tells of a device.
struct Measure {
    std::string name;  ///< with its unit: "claw_mm"
    std::variant<double, std::vector<double>> value;
    double least_move = 0;  ///< told again in a --truth file when it has changed by more than this
};

/// The line on which a client speaks to a controller: that of a device, of a PeopleBot or of a laser. There
/// is one client at a time, and on a serial line nobody knows whether there is one. Threads: as of what it
/// belongs to.
class ClientLine {
  public:
    virtual ~ClientLine() = default;
    virtual void clientConnected() {}
    virtual void clientLost() {}
    /// Bytes of the client, cut anywhere; gives what is answered at once.
    virtual std::vector<std::uint8_t> receive(std::span<const std::uint8_t> bytes) = 0;
    /// The speed of its end of a serial line; 0: any will do.
    virtual int baud() const { return 0; }
};

/// One device: its body and its controller. Threads: none; used by whoever steps the physics. Time comes in
/// with step() only, and the same calls give the same numbers.
class Device : public ClientLine {
  public:
    /// As in the beginning of the world: the body at rest, the controller switched off and on, faults mended.
    /// mj_forward is the caller's.
    virtual void reset() = 0;
    /// Right before each step of the physics: what the controller does in this time, and with it the motors.
    virtual void step(Duration period) = 0;

    /// Breaks something, or mends it. Throws std::invalid_argument, which says what was expected, for a kind
    /// of fault and a number that it does not have.
    virtual void setFault(std::string_view kind, std::size_t which, bool broken) = 0;
    /// Where it really is: for tests and judges.
    virtual std::vector<Measure> truth() const = 0;
};

/// A kind of device in words and numbers, and how one is made.
struct DeviceKind {
    std::string word;   ///< "cyton": begins its line in a world's file
    std::string label;  ///< "Cyton": in the help, and the name of one that is given none
    /// "arm": what it is called in messages, as an option (--arm) and, with an s, in ground truth.
    std::string noun;
    std::string protocol;   ///< "SSC-32": what it speaks, for the help
    int first_port = 0;     ///< of the first one, the next ones' follow
    double radius_m = 0.1;  ///< two devices stand at least the sum of their radii apart
    /// `prefix` makes the names in the model different from those of all others; `at` is complete.
    DeviceModel (*model)(const std::string& prefix, const DevicePlacement& at) = nullptr;
    /// The parts are those of model().
    std::unique_ptr<Device> (*make)(const DeviceParts& parts) = nullptr;
};

/// What begins the other lines of a world's file, and is therefore no kind's word.
inline constexpr std::array<std::string_view, 7> kOtherWords{"box",       "glass", "map",  "object",
                                                             "peoplebot", "room",  "table"};
/// The other options of axon-lab, which are therefore no kind's nouns.
inline constexpr std::array<std::string_view, 20> kOtherOptions{
    "box",   "clock",  "empty",  "help", "laser", "listen", "noise", "object", "port", "pty",
    "robot", "room-x", "room-y", "seed", "speed", "step",   "table", "truth",  "view", "world"};

/// Gives back the kinds where each has a word, a noun and a first port of its own, and neither word nor noun
/// is one of the above. Otherwise throws std::invalid_argument, which says what has to be changed.
std::vector<DeviceKind> distinct(std::vector<DeviceKind> kinds);

/// All there are, in the order of CMakeLists.txt. Throws as distinct().
const std::vector<DeviceKind>& deviceKinds();
/// The kind whose lines begin with this word, or nothing.
const DeviceKind* deviceKind(std::string_view word);

}  // namespace axon::lab
