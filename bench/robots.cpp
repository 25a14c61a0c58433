// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots.hpp"

#include <unistd.h>

#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <thread>
#include <vector>

#include "board.hpp"

namespace axon::bench {

namespace fs = std::filesystem;

namespace {

constexpr std::size_t kPortsOfAddress = 2000;

void write(const fs::path& file, const std::string& text) {
    std::ofstream out(file);
    out << text;
    out.close();
    if (!out) throw std::runtime_error("cannot write " + file.string());
}

}  // namespace

std::string basicProfile(const std::string& name) {
    return "<BasicProfile name=\"" + name +
           "\" category=\"MACHINE\" type=\"STATIONARY\" xpos=\"0\" ypos=\"0\" zpos=\"0\"/>";
}

std::string servicesProfile() {
    return "<ServiceProfile count=\"1\"><Service name=\"Nothing\" type=\"SMPL\" "
           "global_id=\"nothing\"/></ServiceProfile>";
}

RobotPlace robotPlace(const fs::path& board, std::size_t index) {
    const auto of = std::hash<std::string>()(board.parent_path().string());
    return {"127." + std::to_string(100 + index / kPortsOfAddress) + "." + std::to_string(of >> 8U & 255U) +
                "." + std::to_string(of & 255U),
            static_cast<std::uint16_t>(5500 + index % kPortsOfAddress)};
}

int runRobots(const std::string& board_file, std::size_t slots, std::size_t first, std::size_t count,
              const std::string& prefix) {
    Board board(board_file, slots, false);
    const auto parent = ::getppid();
    const auto folder = fs::path(board_file).parent_path();
    const auto services =
        folder / (prefix + "-" + std::to_string(first) + ".services.xml");  // each process its own
    write(services, servicesProfile());
    std::vector<std::unique_ptr<EntityInterfacer>> all;
    for (auto i = first; i < first + count; ++i) {
        const auto name = prefix + "-" + std::to_string(i);
        const auto place = robotPlace(board_file, i);
        EntityInterfacer::Options options;
        options.application = name;
        options.address = place.address;
        options.first_port = options.last_port = place.port;
        options.watch_profiles = false;
        options.logger = [](LogLevel level, const std::string& text) {
            if (level != LogLevel::Info) std::cerr << text << "\n";
        };
        all.push_back(std::make_unique<EntityInterfacer>(std::move(options)));
        auto& robot = *all.back();
        auto& slot = board[i];
        const auto basic = folder / (name + ".xml");
        write(basic, basicProfile(name));
        robot.uploadBasicProfile(basic);
        robot.uploadServiceProfile(services);
        fs::remove(basic);  // the library has read it
        robot.onStop([&slot](const StopSignal& stop) { slot.reachedGeneration(stop.generation, nowNs()); });
        robot.onRaw([&slot](const std::vector<std::string>& blocks, const std::string&) {
            const auto now = nowNs();
            for (const auto& block : blocks) slot.arrived(Kind::Data, now, block.data(), block.size());
        });
        robot.onText([&robot](const std::string& text, const std::string&) {
            robot.sendInfoMsg(text);  // an echo, for round trips
        });
        robot.start();
    }
    ++board.ready();
    while (::getppid() == parent) std::this_thread::sleep_for(std::chrono::milliseconds{200});
    return 0;
}

}  // namespace axon::bench
