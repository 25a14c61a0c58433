// SPDX-License-Identifier: GPL-2.0-or-later
// A robot of cluster_faults.py, with the profiles of examples/01_hello_entity. For each stop it prints a
// line, "MOMENT CAUSE": the nanoseconds of CLOCK_MONOTONIC when its callback was called, before it waits for
// anybody.
#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <filesystem>
#include <iostream>
#include <string>

int main(int argc, char** argv) try {
    if (argc != 3) {
        std::cerr << "expected FOLDER PORTS_FILE\n";
        return 2;
    }
    const std::filesystem::path profiles = argv[1];
    axon::EntityInterfacer interfacer({.application = "Greeter", .ports_file = argv[2]});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");
    interfacer.onStop([](const axon::StopSignal& stop) {
        const auto moment = std::chrono::steady_clock::now().time_since_epoch();
        std::cout << std::to_string(std::chrono::nanoseconds(moment).count()) + ' ' + toString(stop.cause)
                  << std::endl;
    });
    interfacer.onTask("Wait", [](axon::Task& task) {
        task.waitFor(std::chrono::duration<double>(task.number("Seconds")));
    });
    interfacer.run();
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
