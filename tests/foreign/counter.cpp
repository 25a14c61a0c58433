// SPDX-License-Identifier: GPL-2.0-or-later
// The robot application that the clients in other languages drive: it counts, streams how far it is, and
// stands still 30 ms after a stop.
#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <condition_variable>
#include <iostream>
#include <mutex>
#include <optional>
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

    std::mutex mutex;
    std::condition_variable_any stopped;
    using Clock = std::chrono::steady_clock;
    std::optional<Clock::time_point> rests_at;  // guarded by mutex: after the last one of several stops
    interfacer.onStop([&](const axon::StopSignal& stop) {
        std::cout << "stop: " << toString(stop.cause) << std::endl;
        const std::lock_guard lock(mutex);
        rests_at = Clock::now() + std::chrono::milliseconds(30);
        stopped.notify_one();
    });
    const std::jthread sensor([&](const std::stop_token& ending) {
        std::unique_lock lock(mutex);
        while (stopped.wait(lock, ending, [&] { return rests_at.has_value(); })) {
            const auto until = *rests_at;
            if (stopped.wait_until(lock, ending, until, [&] { return rests_at != until; })) continue;
            if (ending.stop_requested()) return;
            rests_at.reset();
            lock.unlock();
            interfacer.standstill();
            lock.lock();
        }
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
