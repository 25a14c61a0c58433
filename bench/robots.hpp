// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <filesystem>
#include <string>

namespace axon::bench {

/// The profiles of an entity of the benchmark.
std::string basicProfile(const std::string& name, double x_mm = 0, double y_mm = 0);
std::string servicesProfile();

/// Where application `index` of a crowd listens: an address of the loopback network that is this crowd's own,
/// so that the usual ports of 127.0.0.1 stay free for others; the range of ports is the library's. `board`:
/// a board of the crowd; their folder tells it from other crowds and other runs.
struct RobotPlace {
    std::string address;
    std::uint16_t port;
};
RobotPlace robotPlace(const std::filesystem::path& board, std::size_t index);

/// Applications PREFIX-FIRST … in one process, each with an Entity Interfacer of its own (and its three
/// threads) and nothing behind it. Each notes on a board when its callbacks begin: data by its number, a stop
/// by its generation. A text is sent back. Those of the first `scans` of all of them stream what a laser
/// scanner with 181 beams sees, ten times a second, and stand in a square grid with the others. Runs until
/// its parent dies.
int runRobots(const std::string& board_file, std::size_t slots, std::size_t first, std::size_t count,
              const std::string& prefix, std::size_t scans);

}  // namespace axon::bench
