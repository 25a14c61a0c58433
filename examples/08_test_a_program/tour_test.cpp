// SPDX-License-Identifier: MIT
// [head]
#include <axon/testing/laboratory.hpp>
#include <future>
#include <iostream>

#include "tour.hpp"

namespace {

using namespace std::chrono_literals;
using axon::testing::Laboratory;
using axon::testing::Passing;
using axon::testing::Request;
using axon::testing::Script;
int failures = 0;

void expect(bool holds, const std::string& claim) {
    if (holds) return;
    ++failures;
    std::cerr << "failed: " << claim << '\n';
}
// [end]

// [begin]
/// A laboratory with a rover of which only the profiles exist.
struct World {
    explicit World(Passing passing)
        : lab({.passing = passing}),
          rover(lab.add(PROFILES "/basic.xml", PROFILES "/services.xml")),
          client(axon::client::Client::connect(lab.clientOptions()).value()) {}
    Laboratory lab;
    axon::testing::ScriptedEntity rover;
    std::unique_ptr<axon::client::Client> client;
};
// [end]

// [tour]
void drivesAllLegs() {
    World world(Passing::AtOnce);
    world.rover.on("Drive", Script().after(5s).progress(0.5).after(5s));
    expect(tour(*world.client, {1000, 500}) == "drove 1500 mm", "both legs are driven");
    expect(world.rover.expectTask("Drive").number("Distance") == 1000, "the first leg is the first one");
    expect(world.rover.expectTask("Drive").number("Distance") == 500, "then comes the second one");
    expect(world.lab.elapsed() == 20s, "the tour takes twenty seconds of the laboratory");
}
// [end]

// [again]
void triesALegThatFailsOnceMore() {
    World world(Passing::AtOnce);
    int tries = 0;
    world.rover.on("Drive", [&](const Request&) {
        return ++tries == 1 ? Script().after(1s).fail("a wheel slips") : Script().after(5s);
    });
    expect(tour(*world.client, {1000}) == "drove 1000 mm", "the second try counts");
}
// [end]

// [stop]
void endsWithAStop() {
    World world(Passing::InAdvance);
    world.rover.on("Drive", Script().after(10s));
    auto told = std::async(std::launch::async, [&] { return tour(*world.client, {1000, 500}); });
    world.rover.expectTask();
    world.lab.advance(10s);
    world.rover.expectTask();
    world.lab.advance(9s);
    expect(world.client->stop({"Rover"})->at(0).confirmed(), "the stop is confirmed");
    expect(told.get() == "ended after 1000 mm: STOPPED", "the second leg is stopped");
}
// [end]

// [refused]
void saysWhoHasTheRover() {
    World world(Passing::AtOnce);
    const auto other = axon::client::Client::connect(world.lab.clientOptions());
    const auto held = other.value()->checkOut("Rover");
    expect(tour(*world.client, {1000}).rfind("no rover: ", 0) == 0, "the program says that it has none");
}
// [end]

// [main]
}  // namespace

int main() try {
    drivesAllLegs();
    triesALegThatFailsOnceMore();
    endsWithAStop();
    saysWhoHasTheRover();
    return failures;
} catch (const axon::testing::Failure& failure) {
    std::cerr << "failed: " << failure.what() << '\n';
    return 1;
}
// [end]
