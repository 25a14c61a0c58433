// SPDX-License-Identifier: MIT
#pragma once
#include <axon/client.hpp>
#include <iostream>
#include <string>
#include <vector>

// What @NAME@ does with the robots of a laboratory. Each function returns an exit status.

constexpr axon::client::Seconds kPatience{60};

inline int refused(const axon::Refusal& refusal) {
    std::cerr << refusal.message << '\n';
    return 1;
}

/// Prints every robot with the names of its services.
inline int listRobots(const axon::client::Client& client) {
    if (client.entities().empty()) std::cout << "no robots at " << client.server() << " yet\n";
    for (const auto& entity : client.entities()) {
        std::cout << entity.name << ":";
        if (const auto services = client.services(entity.name)) {
            for (const auto& service : services.value()) std::cout << ' ' << service.name;
        }
        std::cout << '\n';
    }
    return 0;
}

/// Checks the robot out, runs the service and waits for its end.
inline int runService(axon::client::Client& client, const std::string& robot, const std::string& service,
                      const std::vector<axon::client::Argument>& arguments) {
    using axon::client::TaskReport;
    using axon::client::TaskState;
    const auto held = client.checkOut(robot);
    if (!held) return refused(held.refusal());
    const auto task = held->run(service, arguments);
    task.onUpdate([](const TaskReport& report) {
        if (report.progress >= 0) std::cout << static_cast<int>(report.progress * 100) << " %" << std::endl;
    });
    auto report = task.wait(kPatience);
    if (!isFinal(report.state)) {
        std::cerr << "not finished after " << kPatience.count() << " s, so it is cancelled\n";
        static_cast<void>(task.cancel());
        report = task.wait(kPatience);
    }
    std::cout << service << ": " << toString(report.state) << '\n';
    for (const auto& [name, values] : report.results) {
        std::cout << "  " << name << " =";
        for (const auto& value : values) std::cout << ' ' << axon::client::toText(value);
        std::cout << '\n';
    }
    return report.state == TaskState::Succeeded ? 0 : refused(report.reason);
}
