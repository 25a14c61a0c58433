// SPDX-License-Identifier: MIT
#pragma once
#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <filesystem>
#include <iostream>
#include <memory>
#include <mutex>
#include <utility>

#include "motor.hpp"

/// The robot application of @NAME@: it offers what services.xml describes. `clock` is that of a test; none =
/// real time. Throws axon::Misconfiguration, which says how to fix it.
class Robot {
  public:
    explicit Robot(const std::filesystem::path& folder, std::shared_ptr<const axon::Clock> clock = {})
        : interfacer_(
              {.application = "@NAME@", .ports_file = folder / "ports.cfg", .clock = std::move(clock)}) {
        interfacer_.uploadBasicProfile(folder / "basic.xml");
        interfacer_.uploadServiceProfile(folder / "services.xml");
        interfacer_.onStop([this](const axon::StopSignal& stop) { onStop(stop); });
        interfacer_.onTask("Move", [this, position = interfacer_.stream("position")](
                                       axon::Task& task) mutable { move(task, position); });
        interfacer_.start();
    }
    ~Robot() { interfacer_.shutdown(); }  // while the callbacks can use what they refer to

    void run() { interfacer_.run(); }  // until Ctrl-C
    std::uint16_t port() const { return interfacer_.port(); }

  private:
    using Seconds = std::chrono::duration<double>;
    static constexpr Seconds kStep{0.05};

    void onStop(const axon::StopSignal& stop) {
        {
            const std::lock_guard lock(mutex_);
            motor_.stop();
        }
        interfacer_.standstill();  // a real robot reports it when its sensors show that it stands
        std::cout << "stopped: " << toString(stop.cause) << std::endl;
    }

    void move(axon::Task& task, axon::Stream& position) {
        const double distance = task.number("Distance");
        double start = 0;
        {
            const std::lock_guard lock(mutex_);
            // A stop that came before this line has set stopRequested(); one that comes later stops the
            // motor.
            if (task.stopRequested()) return;
            start = motor_.position();
            motor_.moveTo(start + distance, task.number("Speed", 500));
        }
        bool arrived = false;
        while (!arrived && task.waitFor(kStep)) {
            const std::lock_guard lock(mutex_);
            motor_.advance(kStep.count());
            arrived = motor_.arrived();
            const double moved = motor_.position() - start;
            position.send(motor_.position(), "mm");
            task.progress(distance == 0 ? 1 : moved / distance);
            task.result("Moved", moved, "mm");
        }
    }

    // The callbacks run on several threads. They use the motor while they have the mutex, and never for long:
    // a stop waits for it.
    std::mutex mutex_;
    Motor motor_;
    axon::EntityInterfacer interfacer_;
};
