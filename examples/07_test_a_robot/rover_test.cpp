// SPDX-License-Identifier: MIT
// [head]
#include <axon/testing/scripted_manager.hpp>
#include <iostream>

#include "rover.hpp"

namespace {

using namespace std::chrono_literals;
int failures = 0;

void expect(bool holds, const char* claim) {
    if (holds) return;
    ++failures;
    std::cerr << "failed: " << claim << '\n';
}
// [end]

// [begin]
/// The application and the Entity Manager of the test, on a clock of the test.
struct World {
    axon::testing::ManualClock clock;
    Rover rover{ROVER_FOLDER, clock.shared()};
    axon::testing::ScriptedManager manager{{.application = "Rover", .port = rover.port(), .clock = clock}};
    World() { manager.connect(); }
};
// [end]

// [drive]
void drivesAsFarAsItIsTold() {
    World world;
    auto drive = world.manager.run("Drive", {{"Distance", {1000.0}, {}}});
    drive.expectGranted();
    drive.expectProgress(0.5);
    const auto ending = drive.expectSucceeded();
    expect(std::get<double>(ending.results.at("Driven").front()) == 1000, "it drives 1000 mm");
    expect(world.clock.elapsed() >= 5s, "it takes five seconds of the rover's time");
}
// [end]

// [stop]
void stopsWhenItIsTold() {
    World world;
    auto drive = world.manager.run("Drive", {{"Distance", {5000.0}, {}}});
    drive.expectProgress(0.1);
    world.manager.stop();
    expect(!world.rover.motor_on, "the motor is off when the stop is acknowledged");
    drive.expectStopped();
}
// [end]

// [silence]
void stopsWhenItsEntityManagerHangs() {
    World world;
    auto drive = world.manager.run("Drive", {{"Distance", {5000.0}, {}}});
    drive.expectProgress(0.1);
    world.manager.silence();
    world.manager.expectLinkEnded();
    world.clock.advance(1s);
    expect(world.rover.stops == 1, "the application was told to stop");
    expect(!world.rover.motor_on, "the motor is off");
}
// [end]

// [refused]
void refusesADistanceThatIsTooFar() {
    World world;
    try {
        world.manager.run("Drive", {{"Distance", {9000.0}, {}}});
        expect(false, "the profile permits at most 5000 mm");
    } catch (const axon::testing::Failure& failure) {
        expect(failure.kind() == axon::testing::Failure::Kind::Refused, failure.what());
    }
}
// [end]

// [main]
}  // namespace

int main() try {
    drivesAsFarAsItIsTold();
    stopsWhenItIsTold();
    stopsWhenItsEntityManagerHangs();
    refusesADistanceThatIsTooFar();
    return failures;
} catch (const axon::testing::Failure& failure) {
    std::cerr << "failed: " << failure.what() << '\n';
    return 1;
}
// [end]
