// SPDX-License-Identifier: MIT
// hello-entity [FOLDER_OF_PROFILES] [PORTS_CFG]
#include <axon/entity_interfacer.hpp>
#include <iostream>

int main(int argc, char** argv) try {
    const std::filesystem::path profiles = argc > 1 ? argv[1] : ".";
    axon::EntityInterfacer interfacer({.application = "Greeter", .ports_file = argc > 2 ? argv[2] : ""});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");
    interfacer.onStop(
        [](const axon::StopSignal& stop) { std::cout << "stop: " << toString(stop.cause) << std::endl; });
    interfacer.onTask("Greet", [](axon::Task& task) {
        const auto times = static_cast<int>(task.integer("Times", 3));
        for (int i = 1; i <= times && task.waitFor(std::chrono::milliseconds(200)); ++i) {
            task.feedback("Hello, " + task.text("Name") + "!");
            task.progress(1.0 * i / times);
        }
    });
    interfacer.onTask("Wait", [](axon::Task& task) {
        task.waitFor(std::chrono::duration<double>(task.number("Seconds")));
    });
    interfacer.run();
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
