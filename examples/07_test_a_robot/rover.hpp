// SPDX-License-Identifier: MIT
// [rover]
#pragma once
#include <atomic>
#include <axon/entity_interfacer.hpp>
#include <filesystem>
#include <memory>

/// The application of a rover that drives at 200 mm/s. `clock` is that of a test; none = real time.
class Rover {
  public:
    explicit Rover(const std::filesystem::path& folder, std::shared_ptr<const axon::Clock> clock = {})
        : interfacer_({.application = "Rover", .clock = std::move(clock)}) {
        interfacer_.uploadBasicProfile(folder / "basic.xml");
        interfacer_.uploadServiceProfile(folder / "services.xml");
        interfacer_.onStop([this](const axon::StopSignal&) { motor_on = false, ++stops; });
        interfacer_.onTask("Drive", [this](axon::Task& task) { drive(task); });
        interfacer_.start();
    }
    ~Rover() { interfacer_.shutdown(); }  // while the callbacks can use what they refer to

    void run() { interfacer_.run(); }
    std::uint16_t port() const { return interfacer_.port(); }

    std::atomic<bool> motor_on{false};
    std::atomic<int> stops{0};  ///< how often it was told to stop

  private:
    void drive(axon::Task& task) {
        const double distance_mm = task.number("Distance");
        double driven_mm = 0;
        motor_on = true;
        while (driven_mm < distance_mm && task.waitFor(std::chrono::milliseconds{50})) {
            driven_mm += 10;
            task.progress(driven_mm / distance_mm);
            task.result("Driven", driven_mm, "mm");
        }
        motor_on = false;
    }

    axon::EntityInterfacer interfacer_;
};
// [end]
