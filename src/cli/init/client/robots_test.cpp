// SPDX-License-Identifier: MIT
// The program in a laboratory of the test: the servers are those of Axon, and the robot is a script.
#include "robots.hpp"

#include <axon/testing/laboratory.hpp>
#include <memory>

namespace {
using namespace std::chrono_literals;
using axon::testing::Script;
int failures = 0;

void expect(bool holds, const char* claim) {
    if (holds) return;
    ++failures;
    std::cerr << "failed: " << claim << '\n';
}

std::vector<axon::client::Service> moving() {
    axon::client::Parameter distance;
    distance.name = "Distance";
    distance.data_type = axon::client::DataType::Double;
    axon::client::Service move;
    move.name = "Move";
    move.parameters = {distance};
    return {move};
}

/// A robot called Rover that can move.
struct World {
    axon::testing::Laboratory lab{{.passing = axon::testing::Passing::AtOnce}};
    axon::testing::ScriptedEntity rover = lab.add("Rover", moving());
    std::unique_ptr<axon::client::Client> client = axon::client::Client::connect(lab.clientOptions()).value();
};

void runsAService() {
    World world;
    world.rover.on("Move", Script().after(1s).progress(0.5).after(1s));
    expect(runService(*world.client, "Rover", "Move", {{"Distance", {1000.0}}}) == 0, "the task succeeds");
    expect(world.rover.expectTask("Move").number("Distance") == 1000, "the robot is told how far");
}

void saysWhatFails() {
    World world;
    world.rover.on("Move", Script().after(1s).fail("a wheel slips"));
    expect(runService(*world.client, "Rover", "Move", {{"Distance", {1000.0}}}) == 1, "the task fails");
    const auto other = axon::client::Client::connect(world.lab.clientOptions());
    const auto held = other.value()->checkOut("Rover");
    expect(runService(*world.client, "Rover", "Move", {}) == 1, "somebody else has the robot");
}
}  // namespace

int main() try {
    runsAService();
    saysWhatFails();
    return failures;
} catch (const axon::testing::Failure& failure) {
    std::cerr << "failed: " << failure.what() << '\n';
    return 1;
}
