// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lab_options.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>

namespace axon::lab {
namespace {

constexpr auto kFooter = R"(
Places are in metres and degrees; the origin is the room's lower left corner. Keys that are not given have defaults.
  axon-lab                                          the transport laboratory: --world transport
  axon-lab FILE.lab                                 a world of your own; lab/README.md describes such a file
  axon-lab --world plain                            one PeopleBot in a room with three boxes and a table
  axon-lab --robot name=left --robot name=right     two of them in that room, on ports {robot} and {next_robot}
  axon-lab --robot x=2,y=3,theta=90,port=9000       where it stands, and its port
  axon-lab --empty --box x=4,y=3,dx=0.5,dy=1,height=0.6 --table x=6,y=2
  axon-lab --robot x=2,y=3 --arm x=1,y=5,z=0.74
Robots are reached like real ones: a PeopleBot over ARCOS, {reached}, one client at a time.
Ports: PeopleBots {robot} and up, {devices}, cameras {camera} (HTTP), colour blobs {acts} (ACTS), lasers with --laser {laser},
control {control}, --view {view};
with a --port of your own, the others are free ports. When all of them listen, one line says where:
  ready PeopleBot=127.0.0.1:{robot} PeopleBot.camera=127.0.0.1:{camera} ... control=127.0.0.1:{control}
Ends on Ctrl-C. Exit status: 0 ended on request; 2 an option, the world or a port cannot be used.)";

}  // namespace

void addOptions(CLI::App& app, LabOptions& options) {
    using Server = LabServer;
    std::string reached;
    std::string devices;
    for (const auto& kind : deviceKinds()) {
        const auto* const comma = reached.empty() ? "" : ", ";
        reached += fmt::format("{}a {} over {}", comma, kind.label, kind.protocol);
        devices += fmt::format("{}{}s {}", comma, kind.label, kind.first_port);
    }
    app.footer(
        fmt::format(kFooter, fmt::arg("robot", Server::kFirstPort),
                    fmt::arg("next_robot", Server::kFirstPort + 1), fmt::arg("reached", reached),
                    fmt::arg("devices", devices), fmt::arg("camera", Server::kFirstCameraPort),
                    fmt::arg("acts", Server::kFirstActsPort), fmt::arg("laser", Server::kFirstLaserPort),
                    fmt::arg("control", Server::kControlPort), fmt::arg("view", Server::kOverviewPort)));
    auto* file_option =
        app.add_option("file", options.file, "File that describes a world (.lab)")->check(CLI::ExistingFile);
    app.add_option("--world", options.world, "World that comes with the program, or plain")
        ->capture_default_str()
        ->excludes(file_option);
    app.add_option("--robot", options.robots, "A PeopleBot: name=,x=,y=,theta=,port= (repeat for several)")
        ->allow_extra_args(false);
    for (const auto& kind : deviceKinds()) {
        app.add_option_function<std::vector<std::string>>(
               "--" + kind.noun,
               [&options, word = kind.word](const std::vector<std::string>& texts) {
                   for (const auto& text : texts) options.devices.emplace_back(word, text);
               },
               fmt::format("A {}: name=,x=,y=,z=,theta=,port=", kind.label))
            ->allow_extra_args(false);
    }
    app.add_option("--box", options.boxes, "A box: name=,x=,y=,z=,dx=,dy=,height=,theta=")
        ->allow_extra_args(false);
    app.add_option("--table", options.tables, "A table: name=,x=,y=,dx=,dy=,height=,theta=")
        ->allow_extra_args(false);
    app.add_option("--object", options.objects,
                   "An object: name=,colour=,shape=,x=,y=,z=,theta=,dx=,dy=,dz=,mass=")
        ->allow_extra_args(false);
    app.add_flag("--empty", options.empty, "Leave out boxes, tables and objects");
    app.add_option("--room-x", options.room_x, "Length of the room in metres");
    app.add_option("--room-y", options.room_y, "Width of the room in metres");
    app.add_option("--listen", options.server.listen, "Address to listen on; robots ask for no password")
        ->capture_default_str();
    app.add_option("--port", options.server.first_port, "Port of the first robot; 0 = free ports")
        ->capture_default_str()
        ->check(CLI::Range(0, 65535));
    app.add_option("--speed", options.server.speed, "Seconds of the world per second")
        ->capture_default_str()
        ->check(CLI::Range(0.01, 100.0));
    app.add_flag("--step", options.server.step,
                 R"(Time passes only by {"do":"step","ms":100} at the control port)");
    app.add_option("--seed", options.server.seed, "Seed of the sensors' noise")->capture_default_str();
    app.add_option("--noise", options.server.noise,
                   "Noise of the sensors: 1 = that of real sensors, 0 = none")
        ->capture_default_str()
        ->check(CLI::Range(0.0, 10.0));
    app.add_flag("--view", options.server.overview,
                 fmt::format("Stream the room: http://127.0.0.1:{}/", LabServer::kOverviewPort));
    app.add_flag("--pty", options.server.pty,
                 "Put robots, arms and lasers on pseudo-terminals, like serial lines with their speeds");
    app.add_flag("--laser", options.server.lasers,
                 "Give each PeopleBot a SICK LMS-200 laser on a line of its own, as on the real robot, "
                 "instead of over ARCOS");
    app.add_option(
        "--clock", options.server.clock_path,
        "Write the laboratory's time to this file; programs that are started with AXON_CLOCK=FILE use it");
    app.add_option("--truth", options.server.truth_path,
                   "Append the true positions to this file every 100 ms, as JSON lines");
}

}  // namespace axon::lab
