// SPDX-License-Identifier: MIT
#pragma once
#include <axon/client.hpp>
#include <csignal>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

// What @NAME@ does with the robots of a laboratory. Each function returns an exit status.

constexpr axon::client::Seconds kPatience{60};
constexpr axon::client::Seconds kLook{0.1};  // how often it looks whether somebody has pressed Ctrl-C

/// Ctrl-C: the task is cancelled. A program that simply ended would leave a robot that has to be rearmed.
inline volatile std::sig_atomic_t interrupted = 0;
inline void onInterrupt(int) {
    interrupted = 1;
    std::signal(SIGINT, SIG_DFL);  // a second one ends the program at once
}

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
    std::signal(SIGINT, onInterrupt);
    const auto task = held->run(service, arguments);
    // Reports come with feedback and changes of state, too. (The library copies what is called.)
    task.onUpdate([shown = std::make_shared<int>(-1)](const TaskReport& report) {
        const int percent = static_cast<int>(report.progress * 100);
        if (report.progress < 0 || percent == *shown) return;
        *shown = percent;
        std::cout << percent << " %" << std::endl;
    });
    auto report = task.wait(kLook);
    for (auto waited = kLook; !isFinal(report.state) && !interrupted && waited < kPatience; waited += kLook)
        report = task.wait(kLook);
    if (!isFinal(report.state)) {
        std::cerr << (interrupted ? "interrupted" : "not finished in time") << ", so it is cancelled\n";
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
