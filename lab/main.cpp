// SPDX-License-Identifier: GPL-2.0-or-later
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <filesystem>

#include "lab/lab_server.hpp"

namespace {

axon::lab::LabServer* running = nullptr;

void onSignal(int /*signal*/) {
    running->stop();
}

/// ../share/axon/lab/worlds seen from the program, in the build tree as where it is installed.
std::filesystem::path worldsFolder() {
    return std::filesystem::canonical("/proc/self/exe").parent_path().parent_path() / "share/axon/lab/worlds";
}

axon::lab::WorldDescription knownWorld(const std::string& name) {
    if (name == "plain") return axon::lab::defaultWorld();
    const auto path = worldsFolder() / (name + ".lab");
    if (std::filesystem::is_regular_file(path)) return axon::lab::loadWorld(path.string());
    std::string known = "plain";
    std::error_code none;
    for (const auto& entry : std::filesystem::directory_iterator(worldsFolder(), none)) {
        if (entry.path().extension() == ".lab") known += ", " + entry.path().stem().string();
    }
    throw axon::lab::BadDescription(
        fmt::format("--world {}: expected one of {}, or the name of a file without --world", name, known));
}

constexpr auto kFooter = R"(
Places are metres and degrees, the room's lower left corner is the origin. What is not given has a default.
  axon-lab                                          the transport laboratory: --world transport
  axon-lab FILE.lab                                 a world of your own; lab/README.md tells what is in such a file
  axon-lab --world plain                            one PeopleBot in a room with three boxes and a table
  axon-lab --robot name=left --robot name=right     two of them in this room, on ports 8101 and 8102
  axon-lab --robot x=2,y=3,theta=90,port=9000       where it stands, and its port
  axon-lab --empty --box x=4,y=3,dx=0.5,dy=1,height=0.6 --table x=6,y=2
  axon-lab --robot x=2,y=3 --arm x=1,y=5,z=0.74
Robots are reached like real ones: a PeopleBot by ARCOS, a Cyton by SSC-32, one client at a time.
Ports: PeopleBots 8101 and up, Cytons 8201, cameras 8301 (HTTP), colour blobs 8401 (ACTS), lasers with --laser 8501,
control 8100, --view 8099;
with a --port of your own the others are free ones. When all can be reached, one line tells where:
  ready PeopleBot=127.0.0.1:8101 PeopleBot.camera=127.0.0.1:8301 ... control=127.0.0.1:8100
Ends on Ctrl-C. Exit status: 0 ended when told to, 2 something is wrong with the options.)";

}  // namespace

int main(int argc, char** argv) {
    using namespace axon::lab;
    CLI::App app{
        "The virtual laboratory: PeopleBots and Cytons in a room with physics, reached like real ones.",
        "axon-lab"};
    app.footer(kFooter);
    LabServer::Options options;
    options.noise = 1;
    std::string file;
    std::string name = "transport";
    std::vector<std::string> robots, arms, boxes, tables, objects;
    bool empty = false;
    double room_x = 0, room_y = 0;
    auto* file_option = app.add_option("file", file, "A world's description")->check(CLI::ExistingFile);
    auto* world_option = app.add_option("--world", name, "A world that comes with the program, or plain")
                             ->capture_default_str()
                             ->excludes(file_option);
    app.add_option("--robot", robots, "A PeopleBot: name=,x=,y=,theta=,port= (repeat for several)")
        ->allow_extra_args(false);
    app.add_option("--arm", arms, "A Cyton: name=,x=,y=,z=,theta=,port=")->allow_extra_args(false);
    app.add_option("--box", boxes, "A box: x=,y=,dx=,dy=,height=,theta=")->allow_extra_args(false);
    app.add_option("--table", tables, "A table: x=,y=,dx=,dy=,height=,theta=")->allow_extra_args(false);
    app.add_option("--object", objects, "An object: name=,colour=,shape=,x=,y=,z=,dx=,dy=,dz=,mass=")
        ->allow_extra_args(false);
    app.add_flag("--empty", empty, "Without what stands in the room");
    app.add_option("--room-x", room_x, "Length of the room in metres");
    app.add_option("--room-y", room_y, "Width of the room in metres");
    app.add_option("--listen", options.listen, "Address to listen on; robots know no passwords")
        ->capture_default_str();
    app.add_option("--port", options.first_port, "Port of the first robot, 0 for free ones")
        ->capture_default_str()
        ->check(CLI::Range(0, 65535));
    app.add_option("--speed", options.speed, "Seconds of the world in one second")
        ->capture_default_str()
        ->check(CLI::Range(0.01, 100.0));
    app.add_flag("--step", options.step, R"(Time passes only by {"do":"step","ms":100} at the control port)");
    app.add_option("--seed", options.seed, "Of the sensors' noise")->capture_default_str();
    app.add_option("--noise", options.noise, "Of the sensors: 1 as the real ones have, 0 none")
        ->capture_default_str()
        ->check(CLI::Range(0.0, 10.0));
    app.add_flag("--view", options.overview, "Stream the room: http://127.0.0.1:8099/");
    app.add_flag("--pty", options.pty,
                 "Robots, arms and lasers on pseudo-terminals, as on serial lines with their speeds");
    app.add_flag("--laser", options.lasers,
                 "Each PeopleBot's laser is a SICK LMS-200 on a line of its own, as on the real robot, and "
                 "not reached by ARCOS");
    app.add_option(
        "--clock", options.clock_path,
        "Tell the laboratory's time in this file; it becomes that of programs started with AXON_CLOCK=FILE");
    app.add_option("--truth", options.truth_path,
                   "Append where everything really is to this file, as JSON lines, every 100 ms");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        return app.exit(error) == 0 ? 0 : 2;
    }
    try {
        // Who furnishes a room wants an own one.
        const bool furnished = empty || room_x > 0 || room_y > 0 ||
                               !(robots.empty() && arms.empty() && boxes.empty() && tables.empty());
        if (furnished && file_option->empty() && world_option->empty()) name = "plain";
        auto world = file.empty() ? knownWorld(name) : loadWorld(file);
        if (room_x > 0) world.room_x = room_x;
        if (room_y > 0) world.room_y = room_y;
        if (empty) world.boxes.clear(), world.tables.clear(), world.objects.clear();
        for (const auto& text : boxes) world.boxes.push_back(parseBox(text));
        for (const auto& text : tables) world.tables.push_back(parseTable(text));
        for (const auto& text : objects) world.objects.push_back(parseObject(text));
        for (const auto& text : arms) world.arms.push_back(parseArm(text, world.arms.size()));
        if (robots.empty() && world.robots.empty() && world.arms.empty()) robots.emplace_back();
        for (const auto& text : robots) world.robots.push_back(parseRobot(text, world.robots.size()));
        LabServer server(world, options);
        running = &server;
        std::signal(SIGINT, &onSignal);
        std::signal(SIGTERM, &onSignal);
        std::string line = "ready";
        for (const auto& [what, where] : server.addresses()) line += fmt::format(" {}={}", what, where);
        fmt::print("{}\n", line);
        std::fflush(stdout);
        server.run();
    } catch (const std::exception& error) {
        fmt::print(stderr, "axon-lab: {}\n", error.what());
        return 2;
    }
    return 0;
}
