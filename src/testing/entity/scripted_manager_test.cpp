// SPDX-License-Identifier: MIT
// A robot application and its scripted Entity Manager, over the real link.
#include "axon/testing/scripted_manager.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <string>

#include "support/loopback.hpp"

namespace axon::testing {
namespace {

using namespace std::chrono_literals;
using test::loopbackAddress;

constexpr const char* kBasic =
    R"(<BasicProfile name="Rover" category="ROBOT" type="MOBILE" descr="a rover of a test"/>)";
constexpr const char* kServices = R"(<ServiceProfile count="2">
  <Service name="Move" type="SMPL" pausable="true">
    <Parameters>
      <Param name="Distance" type="INPUT" data_type="DBL" units="mm" required="true" minimum="-5000" maximum="5000"/>
      <Param name="Speed" type="CONFIG" data_type="DBL" units="mm/s" value="100" ready="true"/>
      <Param name="Moved" type="OUTPUT" data_type="DBL" units="mm"/>
    </Parameters>
    <Resources><Resource name="Map" url="map.txt"/></Resources>
  </Service>
  <Service name="Fail" type="SMPL"/>
</ServiceProfile>)";

/// Moves by its clock: 100 mm/s, a step every 50 ms.
class Rover {
  public:
    explicit Rover(const std::optional<ManualClock>& clock = {}, const char* services = kServices,
                   const std::function<void(EntityInterfacer&)>& more = {})
        : folder_(std::filesystem::temp_directory_path() /
                  ("axon-scripted-manager-" + std::to_string(::getpid()))) {
        std::filesystem::create_directories(folder_);
        EntityInterfacer::Options options;
        options.application = "Rover";
        options.address = loopbackAddress();
        options.watch_profiles = false;
        options.logger = [](LogLevel, const std::string&) {};
        if (clock) options.clock = clock->shared();
        interfacer = std::make_unique<EntityInterfacer>(std::move(options));
        interfacer->uploadBasicProfile(file("basic.xml", kBasic));
        if (services != nullptr) interfacer->uploadServiceProfile(file("services.xml", services));
        interfacer->onStop([this](const StopSignal& stop) {
            last_cause = stop.cause;
            if (stop_throws) throw std::runtime_error("the brake is stuck");
            ++stops;
            interfacer->standstill();
        });
        interfacer->onParameter([](const std::string&, const Parameter& parameter) {
            return parameter.name == "Distance" && parameter.number() == 13
                       ? Decision::deny("thirteen brings bad luck")
                       : Decision::grant();
        });
        interfacer->onConfig(
            [this](const std::string&, const Parameter& parameter) { speed = parameter.number(); });
        interfacer->onResource([](const std::string&, const std::string&, const std::filesystem::path& path) {
            return std::filesystem::file_size(path) > 0 ? Decision::grant()
                                                        : Decision::deny("the map is empty");
        });
        interfacer->onText([this](const std::string& text, const std::string& from) {
            interfacer->sendInfoMsg(from + " says " + text);
        });
        interfacer->onRaw([this](const std::vector<std::string>& blocks, const std::string&) {
            interfacer->sendRaw(blocks);
        });
        interfacer->onTask("Move", [this](Task& task) {
            const double distance = task.number("Distance");
            double moved = 0;
            if (!task.resource("Map").empty()) task.feedback("with a map");
            while (moved < distance && task.waitFor(50ms)) {
                if (!task.waitWhilePaused()) return;
                moved += task.number("Speed") * 0.05;
                task.progress(moved / distance);
                task.result("Moved", moved, "mm");
                interfacer->stream("position").send(moved, "mm");
            }
            if (moved >= distance) task.feedback("arrived");
        });
        interfacer->onTask("Fail", [](Task& task) { task.fail("no wheels"); });
        if (more) more(*interfacer);
        interfacer->start();
    }
    ~Rover() {
        interfacer->shutdown();  // while the callbacks can use it
        std::filesystem::remove_all(folder_);
    }
    std::filesystem::path file(const std::string& name, const std::string& text) const {
        std::ofstream(folder_ / name) << text;
        return folder_ / name;
    }
    ScriptedManager::Options options() const {
        ScriptedManager::Options options;
        options.application = "Rover";
        options.address = loopbackAddress();
        options.port = interfacer->port();
        return options;
    }

    std::unique_ptr<EntityInterfacer> interfacer;
    std::atomic<int> stops{0};
    std::atomic<double> speed{0};
    std::atomic<bool> stop_throws{false};
    std::atomic<StopSignal::Cause> last_cause{StopSignal::Cause::Unspecified};

  private:
    const std::filesystem::path folder_;
};

/// An application on a clock of the test, and its manager, linked.
struct OnClock {
    explicit OnClock(std::chrono::milliseconds patience = 120s) : rover(clock) {
        auto options = rover.options();
        options.clock = clock;
        options.patience = patience;
        manager.emplace(options);
        registration = manager->connect();
    }
    ManualClock clock;
    Rover rover;
    std::optional<ScriptedManager> manager;
    Registration registration;
};

Failure failureOf(const std::function<void()>& call) {
    try {
        call();
    } catch (const Failure& failure) {
        return failure;
    }
    ADD_FAILURE() << "nothing was thrown";
    return {Failure::Kind::Misuse, "", ""};
}

TEST(ScriptedManager, LinksAndKnowsWhatTheProfilesSay) {
    Rover rover;
    ScriptedManager manager(rover.options());
    EXPECT_FALSE(manager.linked());
    const auto registration = manager.connect();
    EXPECT_TRUE(manager.linked());
    EXPECT_EQ(registration.name, "Rover");
    EXPECT_EQ(registration.category, "ROBOT");
    EXPECT_EQ(registration.type, "MOBILE");
    EXPECT_EQ(registration.services, (std::vector<std::string>{"Move", "Fail"}));
}

TEST(ScriptedManager, FindsAnApplicationInTheRangeByItsName) {
    Rover rover;
    auto options = rover.options();
    options.port = 0;
    options.first_port = 5500;
    options.last_port = rover.interfacer->port();
    ScriptedManager manager(options);
    EXPECT_EQ(manager.connect().name, "Rover");
}

TEST(ScriptedManager, ATaskOfSecondsTakesNoneOfThemOnAClockOfTheTest) {
    OnClock here;
    const auto began = std::chrono::steady_clock::now();
    auto task = here.manager->run("Move", {{"Distance", {std::int64_t{3000}}, {}}});
    task.expectGranted();
    EXPECT_GE(task.expectProgress(0.5), 0.5);
    EXPECT_EQ(task.expectFeedback("arr"), "arrived");
    const auto ending = task.expectSucceeded();
    EXPECT_EQ(ending.results.at("Moved"), std::vector<Value>{3000.0});
    EXPECT_GE(here.clock.elapsed(), 30s);
    EXPECT_LT(std::chrono::steady_clock::now() - began, 30s);
    EXPECT_EQ(here.rover.stops, 0) << "its watchdog has not tripped";
}

TEST(ScriptedManager, AnAdvanceTakesTheApplicationThroughEachOfItsSteps) {
    OnClock here;
    auto task = here.manager->run("Move", {{"Distance", {1000.0}, {}}});
    task.expectGranted();
    here.clock.advance(20s);
    EXPECT_EQ(task.expectSucceeded().results.at("Moved"), std::vector<Value>{1000.0});
    EXPECT_EQ(here.rover.stops, 0);
}

TEST(ScriptedManager, AStopIsCarriedOutAndAcknowledged) {
    OnClock here;
    auto task = here.manager->run("Move", {{"Distance", {5000.0}, {}}});
    task.expectProgress(0.01);
    const auto done = here.manager->stop();
    EXPECT_EQ(done.generation, 1U);
    EXPECT_TRUE(done.standstill_follows);
    here.manager->expectStandstill();
    task.expectStopped();
    EXPECT_EQ(here.rover.last_cause, StopSignal::Cause::Requested);
    here.manager->run("Move", {{"Distance", {100.0}, {}}}).expectSucceeded();
}

TEST(ScriptedManager, AStopCallbackThatThrowsIsAFailureThatSaysWhat) {
    Rover rover;
    ScriptedManager manager(rover.options());
    manager.connect();
    rover.stop_throws = true;
    const auto failure = failureOf([&] { manager.stop(); });
    rover.stop_throws = false;
    EXPECT_EQ(failure.kind(), Failure::Kind::Otherwise);
    EXPECT_NE(failure.happened().find("the brake is stuck"), std::string::npos) << failure.what();
}

TEST(ScriptedManager, PauseResumeAndCancelReachTheHandler) {
    OnClock here;
    auto task = here.manager->run("Move", {{"Distance", {5000.0}, {}}});
    const auto before = task.expectProgress(0.01);
    task.pause();
    here.manager->sendText("still there?");
    here.manager->expectText("still there?");  // what was sent before it has been handled
    task.resume();
    task.expectProgress(before + 0.01);
    task.cancel();
    task.expectCancelled();
    EXPECT_EQ(here.rover.stops, 0);
}

TEST(ScriptedManager, ParametersAreAnsweredByTheApplication) {
    OnClock here;
    const auto denied = here.manager->setParameter("Move", {"Distance", {13.0}, {}});
    EXPECT_FALSE(denied.granted);
    EXPECT_EQ(denied.code, "DENIED");
    EXPECT_EQ(denied.reason, "thirteen brings bad luck");
    EXPECT_TRUE(here.manager->setParameter("Move", {"Distance", {200.0}, {}}).granted);
    here.manager->run("Move").expectSucceeded();
    const auto answer = here.manager->run("Move", {{"Distance", {13.0}, {}}}).expectDenied();
    EXPECT_NE(answer.reason.find("bad luck"), std::string::npos) << answer.reason;
}

TEST(ScriptedManager, ConfigurationIsToldAtTheBeginningAndWhenItIsSet) {
    OnClock here;
    EXPECT_TRUE(here.manager->setParameter("Move", {"Speed", {250.0}, {}}).granted);
    EXPECT_TRUE(test::waitUntil([&] { return here.rover.speed == 250.0; }));
    auto task = here.manager->run("Move", {{"Distance", {5000.0}, {}}});
    task.expectSucceeded();
}

TEST(ScriptedManager, AnUploadedResourceIsTheTasksIfItWasGranted) {
    OnClock here;
    EXPECT_FALSE(here.manager->upload("Move", "Map", here.rover.file("empty.txt", "")).granted);
    EXPECT_TRUE(here.manager->upload("Move", "Map", here.rover.file("new_map.txt", "a wall")).granted);
    auto task = here.manager->run("Move", {{"Distance", {100.0}, {}}});
    EXPECT_EQ(task.expectFeedback(), "with a map");
}

TEST(ScriptedManager, StreamsTextsAndRawDataComeInOrder) {
    OnClock here;
    here.manager->run("Move", {{"Distance", {20.0}, {}}}).expectSucceeded();
    const auto first = here.manager->expectSample("position");
    const auto second = here.manager->expectSample("position");
    EXPECT_EQ(first.numbers, std::vector<double>{5.0});
    EXPECT_EQ(second.numbers, std::vector<double>{10.0});
    EXPECT_EQ(first.units, "mm");
    EXPECT_EQ(second.sequence, first.sequence + 1);
    here.manager->sendText("hello", "somebody");
    EXPECT_EQ(here.manager->expectText(), "somebody says hello");
    here.manager->sendRaw({"a", "b"});
    EXPECT_EQ(here.manager->expectRaw(), (std::vector<std::string>{"a", "b"}));
}

TEST(ScriptedManager, PositionAndServiceActivityAreSeen) {
    OnClock here;
    here.rover.interfacer->setPosition(1, 2, 3);
    EXPECT_EQ(here.manager->expectPosition(), (std::vector<double>{1, 2, 3}));
    here.rover.interfacer->setServiceActive("Move", false, "charging");
    EXPECT_EQ(here.manager->expectInactive("Move"), "charging");
    const auto failure = failureOf([&] { here.manager->run("Move", {{"Distance", {1.0}, {}}}); });
    EXPECT_EQ(failure.kind(), Failure::Kind::Refused);
    EXPECT_NE(failure.happened().find("charging"), std::string::npos) << failure.what();
    here.rover.interfacer->setServiceActive("Move", true);
    here.manager->expectActive("Move");
    here.manager->run("Move", {{"Distance", {1.0}, {}}}).expectSucceeded();
}

TEST(ScriptedManager, SilenceStopsTheRobotByItsWatchdog) {
    OnClock here;
    auto task = here.manager->run("Move", {{"Distance", {5000.0}, {}}});
    task.expectProgress(0.001);
    here.manager->silence();
    here.clock.advance(11s);
    EXPECT_TRUE(test::waitUntil([&] { return here.rover.stops == 1; }));
    EXPECT_EQ(here.rover.last_cause, StopSignal::Cause::LinkLost);
    const auto ending = here.manager->expectLinkEnded();
    EXPECT_NE(ending.reason.find("silent"), std::string::npos) << ending.reason;
}

TEST(ScriptedManager, SilenceStopsTheRobotWithoutAClockOfTheTest) {
    Rover rover;
    auto options = rover.options();
    options.watchdog = 100ms;
    ScriptedManager manager(options);
    manager.connect();
    manager.silence();
    manager.expectLinkEnded();
    EXPECT_TRUE(test::waitUntil([&] { return rover.stops == 1; }));
}

TEST(ScriptedManager, ADisconnectStopsTheRobotAndALaterConnectLinksAgain) {
    Rover rover;
    ScriptedManager manager(rover.options());
    manager.connect();
    manager.disconnect();
    EXPECT_FALSE(manager.linked());
    EXPECT_TRUE(test::waitUntil([&] { return rover.stops == 1; }));
    EXPECT_EQ(manager.connect().name, "Rover");
    EXPECT_TRUE(manager.linked());
}

TEST(ScriptedManager, AnApplicationThatShutsDownSaysGoodBye) {
    Rover rover;
    ScriptedManager manager(rover.options());
    manager.connect();
    rover.interfacer->shutdown();
    const auto ending = manager.expectLinkEnded();
    EXPECT_TRUE(ending.stopped);
    EXPECT_FALSE(ending.reason.empty());
    EXPECT_EQ(failureOf([&] { manager.expectText(); }).kind(), Failure::Kind::LinkLost);
}

TEST(ScriptedManager, AnotherEndThanTheExpectedOneSaysWhy) {
    OnClock here;
    auto task = here.manager->run("Fail");
    const auto failure = failureOf([&] { task.expectSucceeded(); });
    EXPECT_EQ(failure.kind(), Failure::Kind::Otherwise);
    EXPECT_NE(std::string(failure.what()).find("FAILED: no wheels"), std::string::npos) << failure.what();
}

TEST(ScriptedManager, WhatCannotComeAnyMoreFailsAtOnceWithWhatHasCome) {
    OnClock here(1h);
    auto task = here.manager->run("Move", {{"Distance", {10.0}, {}}});
    const auto failure = failureOf([&] { task.expectFeedback("lost my way"); });
    EXPECT_EQ(failure.kind(), Failure::Kind::Otherwise);
    EXPECT_NE(failure.expected().find("lost my way"), std::string::npos);
    EXPECT_NE(failure.happened().find("arrived"), std::string::npos) << failure.what();
}

TEST(ScriptedManager, PatienceEndsOnTheClockOfTheTest) {
    OnClock here(3s);
    const auto failure = failureOf([&] { here.manager->expectText("never said"); });
    EXPECT_EQ(failure.kind(), Failure::Kind::NotInTime);
    EXPECT_GE(here.clock.elapsed(), 3s);
}

TEST(ScriptedManager, WhatAnEntityManagerRefusesDoesNotReachTheApplication) {
    OnClock here;
    const auto refused = [&](const char* service, const std::vector<Parameter>& parameters) {
        const auto failure = failureOf([&] { here.manager->run(service, parameters); });
        EXPECT_EQ(failure.kind(), Failure::Kind::Refused) << failure.what();
        return failure.happened();
    };
    EXPECT_NE(refused("Mvoe", {}).find("Move"), std::string::npos);
    EXPECT_NE(refused("Move", {}).find("Distance"), std::string::npos);
    EXPECT_NE(refused("Move", {{"Distance", {9000.0}, {}}}).find("5000"), std::string::npos);
    refused("Move", {{"Distance", {std::string("far")}, {}}});
    refused("Move", {{"Distance", {1.0, 2.0}, {}}});
    refused("Move", {{"Distance", {1.0}, "km"}});
    refused("Move", {{"Moved", {1.0}, {}}});
    refused("Move", {{"Altitude", {1.0}, {}}});
    EXPECT_EQ(failureOf([&] { here.manager->upload("Move", "Mapp", "/etc/hostname"); }).kind(),
              Failure::Kind::Refused);
    EXPECT_EQ(failureOf([&] { here.manager->upload("Move", "Map", "/no/such/file"); }).kind(),
              Failure::Kind::Misuse);
}

TEST(ScriptedManager, AnErrorInAProfileIsNamedWithItsLine) {
    Rover rover({}, R"(<ServiceProfile count="1">
  <Service name="Move" type="FAST"/>
</ServiceProfile>)");
    ScriptedManager manager(rover.options());
    const auto failure = failureOf([&] { manager.connect(); });
    EXPECT_EQ(failure.kind(), Failure::Kind::Otherwise);
    EXPECT_NE(failure.happened().find("services.xml:2"), std::string::npos) << failure.what();
}

TEST(ScriptedManager, AMissingProfileIsNamed) {
    Rover rover({}, nullptr);
    auto options = rover.options();
    options.patience = 300ms;
    ScriptedManager manager(options);
    const auto failure = failureOf([&] { manager.connect(); });
    EXPECT_EQ(failure.kind(), Failure::Kind::NotInTime);
    EXPECT_NE(failure.expected().find("uploadServiceProfile()"), std::string::npos) << failure.what();
}

TEST(ScriptedManager, AnotherApplicationIsNotItsOwn) {
    Rover rover;
    auto options = rover.options();
    options.application = "Submarine";
    options.patience = 200ms;
    ScriptedManager manager(options);
    const auto failure = failureOf([&] { manager.connect(); });
    EXPECT_EQ(failure.kind(), Failure::Kind::NotInTime);
    EXPECT_NE(failure.happened().find("'Rover'"), std::string::npos) << failure.what();
}

TEST(ScriptedManager, ASecondManagerIsRefusedWithTheApplicationsWords) {
    Rover rover;
    ScriptedManager manager(rover.options());
    manager.connect();
    auto options = rover.options();
    options.patience = 200ms;
    ScriptedManager second(options);
    const auto failure = failureOf([&] { second.connect(); });
    EXPECT_EQ(failure.kind(), Failure::Kind::Refused);
    EXPECT_TRUE(manager.linked());
}

TEST(ScriptedManager, OptionsThatCannotWorkAreMisuse) {
    const auto misused = [](const std::function<void(ScriptedManager::Options&)>& change) {
        ScriptedManager::Options options;
        options.application = "Rover";
        change(options);
        EXPECT_EQ(failureOf([&] { ScriptedManager manager(options); }).kind(), Failure::Kind::Misuse);
    };
    misused([](auto& options) { options.application.clear(); });
    misused([](auto& options) { options.address = "localhost"; });
    misused([](auto& options) { options.watchdog = 5ms; });
    misused([](auto& options) { options.watchdog = 1h; });
    misused([](auto& options) { options.first_port = 7000, options.last_port = 6000; });
}

TEST(ScriptedManager, CallsWithoutALinkAreMisuse) {
    ScriptedManager::Options options;
    options.application = "Rover";
    ScriptedManager manager(options);
    EXPECT_EQ(failureOf([&] { manager.run("Move"); }).kind(), Failure::Kind::Misuse);
    EXPECT_EQ(failureOf([&] { manager.stop(); }).kind(), Failure::Kind::Misuse);
    EXPECT_EQ(failureOf([&] { manager.sendText("hello"); }).kind(), Failure::Kind::Misuse);
    manager.disconnect();
}

}  // namespace
}  // namespace axon::testing
