// SPDX-License-Identifier: MIT
// The robot application of @NAME@: it offers what services.xml describes.
#include <axon/entity_interfacer.hpp>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <mutex>

#include "motor.hpp"

namespace {
using Seconds = std::chrono::duration<double>;
constexpr Seconds kStep{0.05};
}  // namespace

int main(int argc, char** argv) try {
    if (argc > 1 && *argv[1] == '-') {
        std::cout << "@TARGET@ [FOLDER]   FOLDER has basic.xml, services.xml and ports.cfg\n";
        return 0;
    }
    const std::filesystem::path folder = argc > 1 ? argv[1] : ROBOT_FOLDER;
    // The callbacks run on several threads. They use the motor while they have the mutex, and never for long:
    // a stop waits for it.
    std::mutex mutex;
    Motor motor;

    axon::EntityInterfacer interfacer({.application = "@NAME@", .ports_file = folder / "ports.cfg"});
    interfacer.uploadBasicProfile(folder / "basic.xml");
    interfacer.uploadServiceProfile(folder / "services.xml");
    auto position = interfacer.stream("position");

    interfacer.onStop([&](const axon::StopSignal& stop) {
        {
            const std::lock_guard lock(mutex);
            motor.stop();
        }
        interfacer.standstill();  // a real robot reports it when its sensors show that it stands
        std::cout << "stopped: " << toString(stop.cause) << std::endl;
    });

    interfacer.onTask("Move", [&, position](axon::Task& task) mutable {
        const double distance = task.number("Distance");
        double start = 0;
        {
            const std::lock_guard lock(mutex);
            // A stop that came before this line has set stopRequested(); one that comes later stops the
            // motor.
            if (task.stopRequested()) return;
            start = motor.position();
            motor.moveTo(start + distance, task.number("Speed", 500));
        }
        bool arrived = false;
        while (!arrived && task.waitFor(kStep)) {
            const std::lock_guard lock(mutex);
            motor.advance(kStep.count());
            arrived = motor.arrived();
            const double moved = motor.position() - start;
            position.send(motor.position(), "mm");
            task.progress(distance == 0 ? 1 : moved / distance);
            task.result("Moved", moved, "mm");
        }
    });

    interfacer.run();  // until Ctrl-C
    return 0;
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
