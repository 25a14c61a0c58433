// SPDX-License-Identifier: MIT
// turntable-entity [FOLDER_OF_PROFILES [PORTS_FILE]]: a robot whose device is served by a thread of its own.
#include <axon/entity_interfacer.hpp>
#include <cmath>
#include <iostream>

#include "device_thread.hpp"
#include "simulated_motor.hpp"

using namespace std::chrono_literals;

/// Ends the callbacks before the device goes, which they use.
struct EndOfCallbacks {
    axon::EntityInterfacer& interfacer;
    ~EndOfCallbacks() { interfacer.shutdown(); }
};

int main(int argc, char** argv) try {
    if (argc > 1 && *argv[1] == '-')
        return std::cout << "turntable-entity [FOLDER_OF_PROFILES [PORTS_FILE]]\n", 0;
    const std::filesystem::path profiles = argc > 1 ? argv[1] : ".";
    const SimulatedMotor motor;
    axon::EntityInterfacer interfacer(
        {.application = "Turntable", .ports_file = argc > 2 ? argv[2] : "", .reports_standstill = true});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");

    // [device]
    DeviceThread device(motor.descriptor(), [&] { interfacer.standstill(); });
    const EndOfCallbacks end{interfacer};
    interfacer.onStop([&](const axon::StopSignal& stop) {
        device.stop();
        std::cout << "stop: " << toString(stop.cause) << std::endl;
    });
    // [end]
    // [turn]
    interfacer.onTask("Turn", [&](axon::Task& task) {
        const auto pass = device.pass();
        if (task.stopRequested()) return;  // the stop came before the pass was taken
        const auto angle_deg = task.number("Angle");
        const auto start_deg = device.angle_deg();
        device.turn(pass, angle_deg < 0 ? -90 : 90);
        double turned_deg = 0;
        while (std::abs(turned_deg) < std::abs(angle_deg)) {
            if (!task.waitFor(20ms)) return;
            if (device.lost()) return task.robotLost("the motor does not answer: check its cable");
            turned_deg = device.angle_deg() - start_deg;
            task.progress(std::min(1.0, turned_deg / angle_deg));
        }
        device.turn(pass, 0);
        task.result("Turned", turned_deg, "deg");
    });
    // [end]
    interfacer.run();
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
