// SPDX-License-Identifier: GPL-2.0-or-later
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>

#include "lab/lab_server.hpp"

namespace {

axon::lab::LabServer* running = nullptr;

void onSignal(int /*signal*/) {
    running->stop();
}

constexpr auto kFooter = R"(
Places are metres and degrees, the room's lower left corner is the origin. What is not given has a default.
  axon-lab                                          one PeopleBot in the default room, on 127.0.0.1:8101
  axon-lab --robot name=left --robot name=right       two of them, on ports 8101 and 8102
  axon-lab --robot x=2,y=3,theta=90,port=9000       where it stands, and its port
  axon-lab --empty --box x=4,y=3,dx=0.5,dy=1,height=0.6 --table x=6,y=2
Each robot speaks ARCOS, the protocol of the real one: any ARCOS client can drive it, one at a time.
When the robots can be reached, one line is printed:  ready PeopleBot=127.0.0.1:8101
Ends on Ctrl-C. Exit status: 0 ended when told to, 2 something is wrong with the options.)";

}  // namespace

int main(int argc, char** argv) {
    using namespace axon::lab;
    CLI::App app{"The virtual laboratory: PeopleBots in a room with physics, reached like real ones.",
                 "axon-lab"};
    app.footer(kFooter);
    LabServer::Options options;
    std::vector<std::string> robots;
    std::vector<std::string> boxes;
    std::vector<std::string> tables;
    bool empty = false;
    auto world = defaultWorld();
    app.add_option("--robot", robots, "A PeopleBot: name=,x=,y=,theta=,port= (repeat for several)")
        ->allow_extra_args(false);
    app.add_option("--box", boxes, "A box: x=,y=,dx=,dy=,height=,theta=")->allow_extra_args(false);
    app.add_option("--table", tables, "A table: x=,y=,dx=,dy=,height=,theta=")->allow_extra_args(false);
    app.add_flag("--empty", empty, "Without the boxes and the table of the default room");
    app.add_option("--room-x", world.room_x, "Length of the room in metres")->capture_default_str();
    app.add_option("--room-y", world.room_y, "Width of the room in metres")->capture_default_str();
    app.add_option("--listen", options.listen, "Address to listen on; ARCOS knows no passwords")
        ->capture_default_str();
    app.add_option("--port", options.first_port, "Port of the first robot, 0 for free ones")
        ->capture_default_str()
        ->check(CLI::Range(0, 65535));
    app.add_option("--speed", options.speed, "Seconds of the world in one second")
        ->capture_default_str()
        ->check(CLI::Range(0.01, 100.0));
    app.add_option("--truth", options.truth_path,
                   "Append where the robots really are to this file, as JSON lines, every 100 ms");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        return app.exit(error) == 0 ? 0 : 2;
    }
    try {
        if (empty) world.boxes.clear(), world.tables.clear();
        for (const auto& text : boxes) world.boxes.push_back(parseBox(text));
        for (const auto& text : tables) world.tables.push_back(parseTable(text));
        if (robots.empty()) robots.emplace_back();
        for (const auto& text : robots) world.robots.push_back(parseRobot(text, world.robots.size()));
        LabServer server(world, options);
        running = &server;
        std::signal(SIGINT, &onSignal);
        std::signal(SIGTERM, &onSignal);
        std::string line = "ready";
        const auto ports = server.ports();
        for (std::size_t i = 0; i < ports.size(); ++i)
            line += fmt::format(" {}={}:{}", world.robots[i].name, options.listen, ports[i]);
        fmt::print("{}\n", line);
        std::fflush(stdout);
        server.run();
    } catch (const std::exception& error) {
        fmt::print(stderr, "axon-lab: {}\n", error.what());
        return 2;
    }
    return 0;
}
