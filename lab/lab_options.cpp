// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lab_options.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>

namespace axon::lab {
namespace {

constexpr auto kFooter = R"(
Places are metres and degrees, the room's lower left corner is the origin. What is not given has a default.
  axon-lab                                          the transport laboratory: --world transport
  axon-lab FILE.lab                                 a world of your own; lab/README.md tells what is in such a file
  axon-lab --world plain                            one PeopleBot in a room with three boxes and a table
  axon-lab --robot name=left --robot name=right     two of them in this room, on ports {robot} and {next_robot}
  axon-lab --robot x=2,y=3,theta=90,port=9000       where it stands, and its port
  axon-lab --empty --box x=4,y=3,dx=0.5,dy=1,height=0.6 --table x=6,y=2
  axon-lab --robot x=2,y=3 --arm x=1,y=5,z=0.74
Robots are reached like real ones: a PeopleBot by ARCOS, {reached}, one client at a time.
Ports: PeopleBots {robot} and up, {devices}, cameras {camera} (HTTP), colour blobs {acts} (ACTS), lasers with --laser {laser},
control {control}, --view {view};
with a --port of your own the others are free ones. When all can be reached, one line tells where:
  ready PeopleBot=127.0.0.1:{robot} PeopleBot.camera=127.0.0.1:{camera} ... control=127.0.0.1:{control}
Ends on Ctrl-C. Exit status: 0 ended when told to, 2 something is wrong with the options.)";

}  // namespace

void addOptions(CLI::App& app, LabOptions& options) {
    using Server = LabServer;
    std::string reached;
    std::string devices;
    for (const auto& kind : deviceKinds()) {
        const auto* const comma = reached.empty() ? "" : ", ";
        reached += fmt::format("{}a {} by {}", comma, kind.label, kind.protocol);
        devices += fmt::format("{}{}s {}", comma, kind.label, kind.first_port);
    }
    app.footer(
        fmt::format(kFooter, fmt::arg("robot", Server::kFirstPort),
                    fmt::arg("next_robot", Server::kFirstPort + 1), fmt::arg("reached", reached),
                    fmt::arg("devices", devices), fmt::arg("camera", Server::kFirstCameraPort),
                    fmt::arg("acts", Server::kFirstActsPort), fmt::arg("laser", Server::kFirstLaserPort),
                    fmt::arg("control", Server::kControlPort), fmt::arg("view", Server::kOverviewPort)));
    auto* file_option =
        app.add_option("file", options.file, "A world's description")->check(CLI::ExistingFile);
    app.add_option("--world", options.world, "A world that comes with the program, or plain")
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
    app.add_flag("--empty", options.empty, "Without what stands in the room");
    app.add_option("--room-x", options.room_x, "Length of the room in metres");
    app.add_option("--room-y", options.room_y, "Width of the room in metres");
    app.add_option("--listen", options.server.listen, "Address to listen on; robots know no passwords")
        ->capture_default_str();
    app.add_option("--port", options.server.first_port, "Port of the first robot, 0 for free ones")
        ->capture_default_str()
        ->check(CLI::Range(0, 65535));
    app.add_option("--speed", options.server.speed, "Seconds of the world in one second")
        ->capture_default_str()
        ->check(CLI::Range(0.01, 100.0));
    app.add_flag("--step", options.server.step,
                 R"(Time passes only by {"do":"step","ms":100} at the control port)");
    app.add_option("--seed", options.server.seed, "Of the sensors' noise")->capture_default_str();
    app.add_option("--noise", options.server.noise, "Of the sensors: 1 as the real ones have, 0 none")
        ->capture_default_str()
        ->check(CLI::Range(0.0, 10.0));
    app.add_flag("--view", options.server.overview,
                 fmt::format("Stream the room: http://127.0.0.1:{}/", LabServer::kOverviewPort));
    app.add_flag("--pty", options.server.pty,
                 "Robots, arms and lasers on pseudo-terminals, as on serial lines with their speeds");
    app.add_flag("--laser", options.server.lasers,
                 "Each PeopleBot's laser is a SICK LMS-200 on a line of its own, as on the real robot, and "
                 "not reached by ARCOS");
    app.add_option(
        "--clock", options.server.clock_path,
        "Tell the laboratory's time in this file; it becomes that of programs started with AXON_CLOCK=FILE");
    app.add_option("--truth", options.server.truth_path,
                   "Append where everything really is to this file, as JSON lines, every 100 ms");
}

}  // namespace axon::lab
