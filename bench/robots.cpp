// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots.hpp"

#include <unistd.h>

#include <algorithm>
#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <numbers>
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

struct Place {
    double x_mm, y_mm;
};
/// In a square grid, 3 m apart.
Place placeOf(std::size_t index, std::size_t all) {
    constexpr double kApart_mm = 3000;
    const auto side = static_cast<std::size_t>(std::ceil(std::sqrt(static_cast<double>(all))));
    return {static_cast<double>(index % side) * kApart_mm, static_cast<double>(index / side) * kApart_mm};
}

/// What a laser scanner sees in a room of 8 m by 6 m in which somebody walks: `turn` grows with each scan.
Scan scan(int turn) {
    constexpr int kBeams = 181;
    constexpr double kStep = std::numbers::pi / (kBeams - 1), kWall_m = 4, kFront_m = 6, kLeg_m = 0.15;
    Scan its;
    its.start_angle = -std::numbers::pi / 2;
    its.step = kStep;
    its.max_range = 8;
    const double person = std::numbers::pi / 3 * std::sin(turn / 20.0);
    for (int i = 0; i < kBeams; ++i) {
        const double angle = its.start_angle + i * kStep;
        const double side = kWall_m / std::max(std::abs(std::sin(angle)), 1e-9);
        const double front = kFront_m / std::max(std::cos(angle), 1e-9);
        const double noise = 0.01 * std::sin(i * 12.9898 + turn * 78.233);
        const double distance = std::abs(angle - person) < kLeg_m / 2 ? 2 : std::min(side, front);
        its.ranges.push_back(static_cast<float>(distance + noise));
    }
    return its;
}

}  // namespace

std::string basicProfile(const std::string& name, double x_mm, double y_mm) {
    return "<BasicProfile name=\"" + name + "\" category=\"MACHINE\" type=\"STATIONARY\" xpos=\"" +
           std::to_string(x_mm) + "\" ypos=\"" + std::to_string(y_mm) + "\" zpos=\"0\"/>";
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
              const std::string& prefix, std::size_t scans) {
    Board board(board_file, slots, false);
    const auto parent = ::getppid();
    const auto folder = fs::path(board_file).parent_path();
    const auto services =
        folder / (prefix + "-" + std::to_string(first) + ".services.xml");  // each process its own
    write(services, servicesProfile());
    std::vector<std::unique_ptr<EntityInterfacer>> all;
    std::vector<Stream> scanners;
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
        const auto at = placeOf(i, slots);
        write(basic, basicProfile(name, at.x_mm, at.y_mm));
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
        if (i < scans) scanners.push_back(robot.stream("scan"));
    }
    ++board.ready();
    auto due = std::chrono::steady_clock::now();
    for (int turn = 0; ::getppid() == parent; ++turn) {
        const auto seen = scan(turn);
        for (auto& scanner : scanners) scanner.send(seen);
        due += std::chrono::milliseconds{100};
        std::this_thread::sleep_until(due);
    }
    return 0;
}

}  // namespace axon::bench
