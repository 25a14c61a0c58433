// SPDX-License-Identifier: GPL-2.0-or-later
// The robot application that the clients in other languages drive: it counts, streams how far it is, and
// stands still 30 ms after a stop.
#include <axon/entity_interfacer.hpp>
#include <iostream>
#include <semaphore>
#include <thread>

int main(int argc, char** argv) try {
    if (argc != 4) {
        std::cerr << "foreign-counter FOLDER_OF_PROFILES PORTS_FILE APPLICATION\n";
        return 2;
    }
    const std::filesystem::path profiles = argv[1];
    axon::EntityInterfacer interfacer(
        {.application = argv[3], .ports_file = argv[2], .reports_standstill = true});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");
    auto stream = interfacer.stream("count");

    std::counting_semaphore<> stops{0};
    interfacer.onStop([&](const axon::StopSignal& stop) {
        std::cout << "stop: " << toString(stop.cause) << std::endl;
        stops.release();
    });
    const std::jthread sensor([&](const std::stop_token& ending) {
        std::binary_semaphore end{0};
        const std::stop_callback wake(ending, [&] { end.release(), stops.release(); });
        for (stops.acquire(); !end.try_acquire_for(std::chrono::milliseconds(30)); stops.acquire())
            interfacer.standstill();
    });

    interfacer.onParameter([](const std::string&, const axon::Parameter& parameter) {
        const bool unlucky = parameter.name == "Step" && parameter.integer() == 13;
        return unlucky ? axon::Decision::deny("13 brings bad luck") : axon::Decision::grant();
    });
    interfacer.onTask("Count", [&](axon::Task& task) {
        const auto to = task.integer("To");
        const auto step = task.integer("Step", 1);
        std::int64_t total = 0;
        while (total < to && task.waitWhilePaused() && task.waitFor(std::chrono::milliseconds(20))) {
            total = std::min(to, total + step);
            stream.send(double(total), "steps");
            task.feedback("at " + std::to_string(total));
            task.progress(double(total) / double(to));
        }
        task.result("Total", total);
    });
    interfacer.run();
    return 0;
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
