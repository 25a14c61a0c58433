// SPDX-License-Identifier: GPL-2.0-or-later
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>
#include <filesystem>

#include "lab/lab_options.hpp"

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

}  // namespace

int main(int argc, char** argv) {
    using namespace axon::lab;
    CLI::App app{
        "The virtual laboratory: PeopleBots and Cytons in a room with physics, reached like real ones.",
        "axon-lab"};
    LabOptions options;
    try {
        addOptions(app, options);
        app.parse(argc, argv);
        // Who furnishes a room wants an own one.
        const bool furnished = options.empty || options.room_x > 0 || options.room_y > 0 ||
                               !(options.robots.empty() && options.devices.empty() && options.boxes.empty() &&
                                 options.tables.empty());
        if (furnished && app.count("--world") == 0) options.world = "plain";
        auto world = options.file.empty() ? knownWorld(options.world) : loadWorld(options.file);
        if (options.room_x > 0) world.room_x = options.room_x;
        if (options.room_y > 0) world.room_y = options.room_y;
        if (options.empty) world.boxes.clear(), world.tables.clear(), world.objects.clear();
        for (const auto& text : options.boxes) world.boxes.push_back(parseBox(text));
        for (const auto& text : options.tables) world.tables.push_back(parseTable(text));
        for (const auto& text : options.objects) world.objects.push_back(parseObject(text));
        for (const auto& [kind, text] : options.devices)
            world.devices.push_back(parseDevice(*deviceKind(kind), text));
        if (options.robots.empty() && world.robots.empty() && world.devices.empty())
            options.robots.emplace_back();
        for (const auto& text : options.robots) world.robots.push_back(parseRobot(text, world.robots.size()));
        LabServer server(world, options.server);
        running = &server;
        std::signal(SIGINT, &onSignal);
        std::signal(SIGTERM, &onSignal);
        std::string line = "ready";
        for (const auto& [what, where] : server.addresses()) line += fmt::format(" {}={}", what, where);
        fmt::print("{}\n", line);
        std::fflush(stdout);
        server.run();
    } catch (const CLI::ParseError& error) {
        return app.exit(error) == 0 ? 0 : 2;
    } catch (const std::exception& error) {
        fmt::print(stderr, "axon-lab: {}\n", error.what());
        return 2;
    }
    return 0;
}
