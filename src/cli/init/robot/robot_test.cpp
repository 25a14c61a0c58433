// SPDX-License-Identifier: MIT
// The robot application with a scripted Entity Manager, on a clock of the test: no server, and no waiting.
#include "robot.hpp"

#include <axon/testing/scripted_manager.hpp>
#include <iostream>

namespace {
using namespace std::chrono_literals;
int failures = 0;

void expect(bool holds, const char* claim) {
    if (holds) return;
    ++failures;
    std::cerr << "failed: " << claim << '\n';
}

struct World {
    axon::testing::ManualClock clock;
    Robot robot{ROBOT_FOLDER, clock.shared()};
    axon::testing::ScriptedManager manager{{.application = "@NAME@", .port = robot.port(), .clock = clock}};
    World() { manager.connect(); }
};

double moved(const axon::testing::Ending& ending) {
    return std::get<double>(ending.results.at("Moved").front());
}

void movesAsFarAsItIsTold() {
    World world;
    auto move = world.manager.run("Move", {{"Distance", {1000.0}, {}}});
    expect(moved(move.expectSucceeded()) == 1000, "it moves 1000 mm");
    expect(world.clock.elapsed() >= 2s, "which takes two seconds at 500 mm/s");
}

void standsStillWhenItIsStopped() {
    World world;
    auto move = world.manager.run("Move", {{"Distance", {5000.0}, {}}});
    move.expectProgress(0.1);
    world.manager.stop();
    expect(moved(move.expectStopped()) < 5000, "it does not arrive");
}
}  // namespace

int main() try {
    movesAsFarAsItIsTold();
    standsStillWhenItIsStopped();
    return failures;
} catch (const axon::testing::Failure& failure) {
    std::cerr << "failed: " << failure.what() << '\n';
    return 1;
}
