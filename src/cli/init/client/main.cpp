// SPDX-License-Identifier: MIT
// @NAME@: a program that uses the robots of an Axon laboratory.
#include <axon/client.hpp>
#include <filesystem>
#include <iostream>

#include "words.hpp"

namespace {
using namespace axon::client;

constexpr Seconds kPatience{60};

int refused(const axon::Refusal& refusal) {
    std::cerr << refusal.message << '\n';
    return 1;
}

/// Prints every robot with the names of its services.
int list(const Client& client) {
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
int run(Client& client, const std::string& robot, const std::string& service,
        const std::vector<Argument>& arguments) {
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
        for (const auto& value : values) std::cout << ' ' << toText(value);
        std::cout << '\n';
    }
    return report.state == TaskState::Succeeded ? 0 : refused(report.reason);
}
}  // namespace

int main(int argc, char** argv) {
    const std::vector<std::string> words(argv + 1, argv + argc);
    if (words.size() == 1) {
        std::cout << "@TARGET@                                     lists the robots\n"
                     "@TARGET@ ROBOT SERVICE [PARAMETER=VALUE…]    runs a service\n"
                     "It reads client.cfg in the working folder, if there is one.\n";
        return words[0] == "--help" ? 0 : 2;
    }
    std::vector<Argument> arguments;
    for (std::size_t i = 2; i < words.size(); ++i) {
        const auto argument = readArgument(words[i]);
        if (!argument) {
            std::cerr << "expected PARAMETER=VALUE, found " << words[i] << '\n';
            return 2;
        }
        arguments.push_back(*argument);
    }
    Options options;
    options.display_name = "@NAME@";
    if (std::filesystem::exists("client.cfg")) {
        const auto read = readConfiguration("client.cfg", options);
        if (!read) return refused(read.refusal());
        options = read.value();
    }
    const auto connected = Client::connect(options);
    if (!connected) return refused(connected.refusal());
    auto& client = *connected.value();
    const int exit = words.empty() ? list(client) : run(client, words[0], words[1], arguments);
    client.close();  // releases what is checked out
    return exit;
}
