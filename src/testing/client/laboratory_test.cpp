// SPDX-License-Identifier: GPL-2.0-or-later
// Programs that use axon::Client unchanged, and a laboratory of scripted entities in their process.
#include "axon/testing/laboratory.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "support/loopback.hpp"

namespace axon::testing {
namespace {

using namespace std::chrono_literals;
using client::TaskState;

client::Parameter parameter(std::string name, client::ParameterKind kind) {
    client::Parameter parameter;
    parameter.name = std::move(name);
    parameter.kind = kind;
    parameter.data_type = client::DataType::Double;
    parameter.units = "mm";
    return parameter;
}

std::vector<client::Service> services() {
    client::Service move;
    move.name = "Move";
    move.pausable = true;
    move.parameters = {parameter("Distance", client::ParameterKind::Input),
                       parameter("Moved", client::ParameterKind::Output)};
    move.parameters[0].required = true;
    move.parameters[0].maximum = 5000;
    move.resources = {{.name = "Map"}};
    client::Service wave;
    wave.name = "Wave";
    wave.blocking = false;
    return {move, wave};
}

/// A laboratory with one rover, and a client that may hold it.
struct World {
    explicit World(Passing passing = Passing::InAdvance)
        : lab({.passing = passing}), rover(lab.add("Rover", services())), client(connected()) {}
    std::unique_ptr<client::Client> connected() const {
        auto made = client::Client::connect(lab.clientOptions());
        EXPECT_TRUE(made) << made.refusal().message;
        return std::move(made).value();
    }
    client::CheckOut checkOut() const {
        auto held = client->checkOut("Rover");
        EXPECT_TRUE(held) << held.refusal().message;
        return std::move(held).value();
    }
    Laboratory lab;
    ScriptedEntity rover;
    std::unique_ptr<client::Client> client;
};

const client::Argument kFar{"Distance", {1000.0}};

Failure failureOf(const std::function<void()>& call) {
    try {
        call();
    } catch (const Failure& failure) {
        return failure;
    }
    ADD_FAILURE() << "nothing was thrown";
    return {Failure::Kind::Misuse, "", ""};
}

TEST(Laboratory, AScriptedEntityIsAnEntityLikeAnyOther) {
    World world;
    const auto found = world.client->find("Rover");
    ASSERT_TRUE(found);
    EXPECT_EQ(found->category, "ROBOT");
    EXPECT_EQ(found->state, EntityState::IDLE);
    const auto held = world.checkOut();
    ASSERT_EQ(held.services().size(), 2U);
    EXPECT_EQ(held.service("Move")->parameters.at(0).units, "mm");
}

TEST(Laboratory, AServiceWithoutAScriptSucceeds) {
    World world;
    EXPECT_EQ(world.checkOut().run("Wave").wait(10s).state, TaskState::Succeeded);
}

TEST(Laboratory, AScriptAnswersWhenItsTimeHasCome) {
    World world;
    world.rover.on("Move",
                   Script().after(1s).progress(0.5).feedback("half way").after(1s).result("Moved", {1000.0}));
    const auto task = world.checkOut().run("Move", {kFar});
    EXPECT_EQ(world.rover.expectTask("Move").number("Distance"), 1000.0);
    world.lab.advance(1s);
    EXPECT_TRUE(test::waitUntil([&] { return task.report().feedback == "half way"; }));
    EXPECT_EQ(task.report().progress, 0.5);
    EXPECT_EQ(task.report().state, TaskState::Running);
    world.lab.advance(1s);
    const auto report = task.wait(10s);
    EXPECT_EQ(report.state, TaskState::Succeeded);
    EXPECT_EQ(report.results.at("Moved"), std::vector<client::Value>{1000.0});
    EXPECT_EQ(world.lab.elapsed(), 2s);
}

TEST(Laboratory, TimeThatPassesAtOnceNeedsNoAdvance) {
    World world(Passing::AtOnce);
    world.rover.on("Move", Script().after(1h).progress(0.5).after(1h).fail("a wheel is lost"));
    const auto report = world.checkOut().run("Move", {kFar}).wait(10s);
    EXPECT_EQ(report.state, TaskState::Failed);
    EXPECT_EQ(report.reason.message, "a wheel is lost");
    EXPECT_EQ(world.lab.elapsed(), 2h);
}

TEST(Laboratory, AScriptThatIsAFunctionSeesTheParameters) {
    World world;
    world.rover.on("Move", [](const Request& request) {
        return Script().result("Moved", {request.number("Distance") / 2});
    });
    const auto report = world.checkOut().run("Move", {kFar}).wait(10s);
    EXPECT_EQ(report.results.at("Moved"), std::vector<client::Value>{500.0});
}

TEST(Laboratory, AScriptThatThrowsFailsItsTask) {
    World world;
    world.rover.on("Move",
                   [](const Request& request) { return Script().feedback(request.text("Distance")); });
    const auto report = world.checkOut().run("Move", {kFar}).wait(10s);
    EXPECT_EQ(report.state, TaskState::Failed);
    EXPECT_NE(report.reason.message.find("Distance"), std::string::npos) << report.reason.message;
}

TEST(Laboratory, TheNextTaskOfTheQueueBeginsWhenTheOneBeforeItEnds) {
    World world;
    world.rover.on("Move", Script().after(2s));
    const auto held = world.checkOut();
    const auto first = held.run("Move", {kFar});
    const auto second = held.run("Move", {kFar});
    world.rover.expectTask();
    EXPECT_TRUE(test::waitUntil([&] { return second.report().accepted; }));
    world.lab.advance(3s);
    EXPECT_EQ(first.wait(10s).state, TaskState::Succeeded);
    EXPECT_FALSE(isFinal(second.report().state));
    world.lab.advance(1s);
    EXPECT_EQ(second.wait(10s).state, TaskState::Succeeded);
}

TEST(Laboratory, RefusalsAreThoseOfARealLaboratory) {
    World world;
    const auto held = world.checkOut();
    EXPECT_EQ(world.client->checkOut("Submarine").refusal().code, RefusalCode::UnknownEntity);
    EXPECT_EQ(world.connected()->checkOut("Rover").refusal().code, RefusalCode::AlreadyHeld);
    EXPECT_EQ(held.run("Move").wait(10s).reason.code, RefusalCode::MissingDependency);
    EXPECT_EQ(held.run("Move", {{"Distance", {9000.0}}}).wait(10s).reason.code, RefusalCode::OutOfRange);
    world.rover.on("Wave", Script::denied("the arm is tired"));
    const auto denied = held.run("Wave").wait(10s);
    EXPECT_EQ(denied.reason.code, RefusalCode::Denied);
    EXPECT_EQ(denied.reason.message, "the arm is tired");
    world.rover.denyParameter("Move", "Distance", "too cold");
    EXPECT_EQ(held.set("Move", kFar).refusal().message, "too cold");
}

TEST(Laboratory, AStopEndsTheTaskAndLatchesUntilItIsRearmed) {
    World world;
    world.rover.on("Move", Script().never());
    const auto held = world.checkOut();
    const auto task = held.run("Move", {kFar});
    world.rover.expectTask();
    const auto receipts = world.client->stop({"Rover"});
    ASSERT_TRUE(receipts);
    EXPECT_TRUE(receipts->at(0).confirmed());
    EXPECT_EQ(world.rover.expectStop(), "REQUESTED");
    EXPECT_EQ(task.wait(10s).state, TaskState::Stopped);
    EXPECT_EQ(held.run("Wave").wait(10s).reason.code, RefusalCode::Latched);
    EXPECT_TRUE(world.client->rearm("Rover"));
    EXPECT_EQ(held.run("Wave").wait(10s).state, TaskState::Succeeded);
}

TEST(Laboratory, AStopThatTheApplicationDoesNotConfirmStaysOpen) {
    World world;
    world.rover.confirmStops(false);
    const auto receipts = world.client->stop({"Rover"}, 0.2s);
    ASSERT_TRUE(receipts);
    EXPECT_FALSE(receipts->at(0).confirmed());
    world.rover.confirmStops(true);
    EXPECT_TRUE(world.client->stop({"Rover"})->at(0).confirmed());
}

TEST(Laboratory, AStandstillIsReportedWhenItsTimeHasCome) {
    World world(Passing::AtOnce);
    world.rover.reportStandstill(2s);
    world.rover.on("Move", Script().never());
    const auto held = world.checkOut();
    held.run("Move", {kFar});
    world.rover.expectTask();
    const auto receipts = world.client->stop({"Rover"}, 1s, 10s);
    ASSERT_TRUE(receipts);
    EXPECT_TRUE(receipts->at(0).standstill);
    EXPECT_EQ(world.lab.elapsed(), 2s);
}

TEST(Laboratory, ATaskThatIsPausedWaitsWithItsScript) {
    World world;
    world.rover.on("Move", Script().after(2s));
    const auto task = world.checkOut().run("Move", {kFar});
    world.rover.expectTask();
    EXPECT_TRUE(test::waitUntil([&] { return task.report().state == TaskState::Running; }));
    world.lab.advance(1s);
    EXPECT_TRUE(task.pause());
    EXPECT_TRUE(test::waitUntil([&] { return task.report().state == TaskState::Paused; }));
    world.lab.advance(10s);
    EXPECT_TRUE(task.resume());
    EXPECT_TRUE(test::waitUntil([&] { return task.report().state == TaskState::Running; }));
    world.lab.advance(999ms);
    EXPECT_FALSE(isFinal(task.report().state));
    world.lab.advance(1ms);
    EXPECT_EQ(task.wait(10s).state, TaskState::Succeeded);
    EXPECT_EQ(world.lab.elapsed(), 12s);
}

TEST(Laboratory, ATaskThatIsCancelledEnds) {
    World world;
    world.rover.on("Move", Script().after(1h));
    const auto task = world.checkOut().run("Move", {kFar});
    world.rover.expectTask();
    EXPECT_TRUE(test::waitUntil([&] { return task.report().state == TaskState::Running; }));
    EXPECT_TRUE(task.cancel());
    EXPECT_EQ(task.wait(10s).state, TaskState::Cancelled);
}

TEST(Laboratory, StreamsReachWhoWatchesThem) {
    World world;
    std::atomic<int> samples{0};
    std::string json;
    const auto watching = world.client->watch("Rover", {"position"}, [&](const client::Sample& sample) {
        if (samples == 0) json = sample.json();  // later ones come while the test reads it
        ++samples;
    });
    ASSERT_TRUE(watching) << watching.refusal().message;
    EXPECT_TRUE(test::waitUntil([&] {
        world.rover.sendSample("position", {42.0}, "mm");
        return samples > 0;
    }));
    EXPECT_NE(json.find("42"), std::string::npos) << json;
}

TEST(Laboratory, TextsAndRawDataGoBothWays) {
    World world;
    const auto held = world.checkOut();
    std::atomic<int> heard{0};
    held.onText([&](const std::string& text) { heard += text == "hello" ? 1 : 100; });
    held.onRaw([&](const std::string& bytes) { heard += bytes == "bytes" ? 10 : 100; });
    EXPECT_TRUE(held.sendText("are you there?"));
    EXPECT_TRUE(held.sendRaw("data"));
    EXPECT_EQ(world.rover.expectText(), "are you there?");
    EXPECT_EQ(world.rover.expectRaw(), "data");
    world.rover.sendText("hello");
    world.rover.sendRaw("bytes");
    EXPECT_TRUE(test::waitUntil([&] { return heard == 11; }));
}

TEST(Laboratory, AnUploadArrives) {
    World world;
    const auto file =
        std::filesystem::temp_directory_path() / ("axon-laboratory-test-" + std::to_string(::getpid()));
    std::ofstream(file) << "a wall";
    const auto held = world.checkOut();
    const auto uploaded = held.upload("Move", "Map", file);
    std::filesystem::remove(file);
    ASSERT_TRUE(uploaded) << uploaded.refusal().message;
    EXPECT_EQ(world.rover.uploaded("Move", "Map"), "a wall");
    EXPECT_EQ(failureOf([&] { world.rover.uploaded("Wave", "Map"); }).kind(), Failure::Kind::Otherwise);
}

TEST(Laboratory, AServiceThatIsSwitchedOffIsRefused) {
    World world;
    const auto held = world.checkOut();
    world.rover.setServiceActive("Wave", false, "charging");
    EXPECT_TRUE(test::waitUntil([&] { return !held.service("Wave")->active; }));
    EXPECT_EQ(held.run("Wave").wait(10s).reason.code, RefusalCode::InactiveService);
}

TEST(Laboratory, AnApplicationThatIsLostStopsAndLatchesTheEntity) {
    World world;
    world.rover.on("Move", Script().never());
    const auto held = world.checkOut();
    const auto task = held.run("Move", {kFar});
    world.rover.expectTask();
    world.rover.loseApplication("the battery is empty");
    EXPECT_TRUE(isFinal(task.wait(10s).state));
    EXPECT_TRUE(test::waitUntil([&] { return held.entity().latched; }));
    world.rover.restoreApplication();
    EXPECT_TRUE(world.client->waitFor("Rover", 10s));
    const auto rearmed = world.client->rearm("Rover");
    EXPECT_TRUE(rearmed) << rearmed.refusal().message;
    EXPECT_EQ(held.run("Wave").wait(10s).reason.code, RefusalCode::NotHolder) << "its lease has ended";
    EXPECT_EQ(world.checkOut().run("Wave").wait(10s).state, TaskState::Succeeded);
}

TEST(Laboratory, AnEntityThatIsLostIsNoticedAndCanComeBack) {
    World world;
    const auto held = world.checkOut();
    std::atomic<bool> noticed{false};
    held.onOrphaned([&](const std::string&) { noticed = true; });
    held.onLost([&](const Refusal&) { noticed = true; });
    world.rover.lose();
    EXPECT_TRUE(test::waitUntil([&] { return noticed.load(); }));
    EXPECT_TRUE(test::waitUntil([&] { return world.client->entities().empty(); }));
    world.rover.join();
    EXPECT_TRUE(world.client->waitFor("Rover", 10s));
}

TEST(Laboratory, AnEntityCanLeaveAndJoinAgain) {
    World world;
    world.rover.leave();
    world.rover.leave();
    EXPECT_TRUE(test::waitUntil([&] { return world.client->entities().empty(); }));
    world.rover.sendText("to nobody");
    world.lab.advance(1s);
    world.rover.join();
    EXPECT_TRUE(world.client->waitFor("Rover", 10s));
    EXPECT_EQ(world.checkOut().run("Wave").wait(10s).state, TaskState::Succeeded);
}

TEST(Laboratory, ProfilesOfARealRobotMakeAnEntity) {
    Laboratory lab;
    auto greeter = lab.add("examples/01_hello_entity/basic.xml", "examples/01_hello_entity/services.xml");
    EXPECT_EQ(greeter.name(), "Greeter");
    const auto client = client::Client::connect(lab.clientOptions());
    ASSERT_TRUE(client);
    const auto held = client.value()->checkOut("Greeter");
    ASSERT_TRUE(held);
    EXPECT_EQ(held->run("Greet", {{"Name", {"Ada"}}}).wait(10s).state, TaskState::Succeeded);
    const auto request = greeter.expectTask();
    EXPECT_EQ(request.text("Name"), "Ada");
    EXPECT_EQ(request.number("Times"), 3) << "that of the profile";
}

TEST(Laboratory, SeveralEntitiesShareItsTime) {
    World world;
    auto other = world.lab.add("Crane", services(), "MACHINE", "STATIONARY");
    world.rover.on("Wave", Script().after(1s));
    other.on("Wave", Script().after(2s));
    EXPECT_TRUE(world.client->waitFor("Crane", 10s));
    const auto both = world.client->checkOut(std::vector<std::string>{"Rover", "Crane"});
    ASSERT_TRUE(both) << both.refusal().message;
    const auto first = both->at(0).run("Wave");
    const auto second = both->at(1).run("Wave");
    world.rover.expectTask();
    other.expectTask();
    world.lab.advance(1s);
    EXPECT_EQ(first.wait(10s).state, TaskState::Succeeded);
    EXPECT_FALSE(isFinal(second.report().state));
    world.lab.advance(1s);
    EXPECT_EQ(second.wait(10s).state, TaskState::Succeeded);
}

TEST(Laboratory, WhatDoesNotComeIsAFailureThatSaysWhatWasExpected) {
    Laboratory lab({.patience = 50ms});
    auto rover = lab.add("Rover", services());
    const auto failure = failureOf([&] { rover.expectTask("Move"); });
    EXPECT_EQ(failure.kind(), Failure::Kind::NotInTime);
    EXPECT_NE(failure.expected().find("'Move'"), std::string::npos) << failure.what();
    EXPECT_EQ(failureOf([&] { rover.expectStop(); }).kind(), Failure::Kind::NotInTime);
}

TEST(Laboratory, WhatTheTestGetsWrongIsMisuse) {
    Laboratory lab;
    auto rover = lab.add("Rover", services());
    const auto misused = [](const std::function<void()>& call) {
        EXPECT_EQ(failureOf(call).kind(), Failure::Kind::Misuse);
    };
    misused([&] { rover.on("Fly", Script()); });
    misused([&] { rover.denyParameter("Move", "Speed", "no"); });
    misused([&] { rover.expectTask("Fly"); });
    misused([&] { rover.setServiceActive("Fly", false); });
    misused([&] { lab.add("Rover", services()); });
    misused([&] { lab.add("Crane", services(), "ANIMAL", "MOBILE"); });
    misused([&] { lab.add("", services()); });
    auto twice = services();
    twice[1].name = "Move";
    misused([&] { lab.add("Crane", twice); });
    misused([&] { lab.add("/no/such/basic.xml", "/no/such/services.xml"); });
}

}  // namespace
}  // namespace axon::testing
