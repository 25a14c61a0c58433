// SPDX-License-Identifier: MIT
#include <axon/entity_interfacer.hpp>
#include <iostream>
using Seconds = std::chrono::duration<double>;

int main(int argc, char** argv) try {
    if (argc > 1 && *argv[1] == '-') {
        std::cout << std::filesystem::path(argv[0]).filename().string() << " [FOLDER [PORTS_FILE]]\n";
        return 0;
    }
    const std::filesystem::path profiles = argc > 1 ? argv[1] : ".";
    axon::EntityInterfacer interfacer({.application = "Greeter", .ports_file = argc > 2 ? argv[2] : ""});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");
    interfacer.onStop([](const axon::StopSignal& stop) { std::cout << toString(stop.cause) << std::endl; });
    interfacer.onTask("Greet", [](axon::Task& task) {
        const auto times = task.number("Times", 3);
        for (int i = 1; i <= times && task.waitFor(Seconds(0.2)); ++i) {
            task.feedback("Hello, " + task.text("Name") + "!");
            task.progress(i / times);
        }
    });
    interfacer.onTask("Wait", [](axon::Task& task) { task.waitFor(Seconds(task.number("Seconds"))); });
    interfacer.run();
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
