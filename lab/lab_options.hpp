// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <utility>
#include <vector>

#include "lab/lab_server.hpp"

namespace CLI {
class App;
}

namespace axon::lab {

/// What the command line of axon-lab says. As constructed: the program's defaults, which are nowhere else.
struct LabOptions {
    LabServer::Options server{.noise = 1};
    std::string file;                 ///< a world's description; empty: `world` is meant
    std::string world = "transport";  ///< one that comes with the program, or "plain"
    std::vector<std::string> robots, boxes, tables,
        objects;  ///< as parseRobot() and the others read them
    /// DeviceKind::word, and what parseDevice() reads.
    std::vector<std::pair<std::string, std::string>> devices;
    bool empty = false;             ///< without what stands in the room
    double room_x = 0, room_y = 0;  ///< m; 0: as the world has them

    bool operator==(const LabOptions&) const = default;
};

/// Adds the options to `app`, which writes what it parses to `options`; both must outlive the parsing. Its
/// help is complete afterwards.
void addOptions(CLI::App& app, LabOptions& options);

}  // namespace axon::lab
