// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>

namespace axon::faults {

/// How the robots of a run are called: to clients, and between Entity Manager and application.
std::string robotName(std::size_t i);
std::string applicationName(std::size_t i);
/// How long a lost holder's lease lives on, in seconds: short, since the next trial waits for its end.
inline constexpr double kLeaseGrace = 0.5;
/// The port of the i-th Entity Interfacer.
std::uint16_t linkPort(std::size_t i);

/// The first robot of the last tenth, which has at least one robot.
constexpr std::size_t lastTenthOf(std::size_t entities) {
    return entities - (entities < 20 ? 1 : entities / 10);
}

/// One motion that an application began, as a line of the run's log of motions.
struct Motion {
    std::string task;  ///< UUID
    std::size_t robot = 0;
    std::int64_t at = 0;  ///< CLOCK_MONOTONIC nanoseconds
};
/// Nothing for a line that is not whole yet.
bool parseMotion(const std::string& line, Motion& motion);

struct RobotsPlan {
    std::string board;
    std::filesystem::path folder;  ///< for profiles, state, the log of motions
    std::size_t entities = 1;
    std::size_t first = 0, count = 0;  ///< of Entity Managers: those of this process; a count of 0 is all
    std::string address;               ///< where applications listen, and Entity Managers look for them
    std::string server;                ///< HOST:PORT of the entity server, for Entity Managers
};

/// A robot application with many robots: the real Entity Interfacer library, one for each. Each notes every
/// stop callback and every motion that begins on the board, and appends the task to <folder>/motions.
/// Services: Drive moves until it is stopped; Step moves for Seconds. Runs until its parent dies or kills it.
int runApplication(const RobotsPlan& plan);

/// Entity Managers of all robots in one process, each the library that the daemon is made of. Runs until its
/// parent dies or kills it.
int runManagers(const RobotsPlan& plan);

}  // namespace axon::faults
