// SPDX-License-Identifier: MIT
// cart-entity [FOLDER_OF_PROFILES [PORTS_FILE]]: a simulated cart that rolls on for a moment after it was
// stopped.
#include <algorithm>
#include <atomic>
#include <axon/entity_interfacer.hpp>
#include <iostream>
#include <thread>

using namespace std::chrono_literals;

namespace {

// [motor]
/// Stands in for a motor controller. It brakes by itself, and that takes a while.
class Motor {
  public:
    explicit Motor(std::function<void()> stands) : stands_(std::move(stands)) {}

    /// Does nothing while it brakes, so that a task that has not noticed a stop yet cannot undo it.
    void drive() {
        if (!braking_) speed_ = kSpeed_mm_s;
    }
    /// Returns at once. The motor thread brakes, and calls `stands` when the cart has come to rest.
    void brake() { braking_ = true; }

  private:
    void turn(const std::stop_token& end) {
        while (!end.stop_requested()) {
            std::this_thread::sleep_for(20ms);
            if (!braking_) continue;
            speed_ = std::max(0, speed_ - kSpeed_mm_s / 10);
            if (speed_ > 0) continue;
            braking_ = false;
            stands_();
        }
    }

    static constexpr int kSpeed_mm_s = 500;
    const std::function<void()> stands_;
    std::atomic<int> speed_{0};
    std::atomic<bool> braking_{false};
    std::jthread thread_{[this](const std::stop_token& end) { turn(end); }};
};
// [end]

/// Ends the callbacks before the motor goes, which they use.
struct EndOfCallbacks {
    axon::EntityInterfacer& interfacer;
    ~EndOfCallbacks() { interfacer.shutdown(); }
};

}  // namespace

int main(int argc, char** argv) try {
    if (argc > 1 && *argv[1] == '-') return std::cout << "cart-entity [FOLDER_OF_PROFILES [PORTS_FILE]]\n", 0;
    const std::filesystem::path profiles = argc > 1 ? argv[1] : ".";
    axon::EntityInterfacer interfacer(
        {.application = "Cart", .ports_file = argc > 2 ? argv[2] : "", .reports_standstill = true});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");

    Motor motor([&] { interfacer.standstill(); });
    const EndOfCallbacks end{interfacer};
    // [stop]
    interfacer.onStop([&](const axon::StopSignal& stop) {
        motor.brake();
        std::cout << "stop: " << toString(stop.cause) << std::endl;
    });
    // [end]
    // [task]
    interfacer.onAnyTask([&](axon::Task& task) {
        const auto seconds = task.number("Seconds");
        constexpr int kParts = 20;
        for (int part = 0; part < kParts; ++part) {
            if (task.paused()) motor.brake();
            if (!task.waitWhilePaused()) return;
            motor.drive();
            if (!task.waitFor(std::chrono::duration<double>(seconds / kParts))) return;
            task.progress(double(part + 1) / kParts);
        }
        motor.brake();
    });
    // [end]
    interfacer.run();
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
