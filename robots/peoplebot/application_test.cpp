// SPDX-License-Identifier: GPL-2.0-or-later
// The whole application between its two neighbours, over real sockets: the Entity Manager's end of the link
// on one side, the virtual laboratory on the other.
#include "robots/peoplebot/application.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <functional>
#include <optional>
#include <thread>

#include "lab/lab_server.hpp"
#include "tests/support/loopback.hpp"
#include "tests/support/robot_manager.hpp"

namespace axon::peoplebot {
namespace {

using std::chrono::milliseconds;
using test::waitUntil;
using ::testing::HasSubstr;

// The default world's room and boxes, seen by a laser.
constexpr auto kDefaultWorld =
    "2D-Map\nCairn: GoalWithHeading 2600 2600 -90 \"\" ICON \"middle\"\nLINES\n0 0 8000 0\n8000 0 8000 "
    "6000\n8000 6000 0 6000\n0 6000 0 0\n"
    "4950 750 5450 750\n4950 1250 5450 1250\n4950 750 4950 1250\n5450 750 5450 1250\n6000 5000 6800 "
    "5000\n6000 5000 6000 5400\n"
    "3150 5150 3650 5150\n3150 5150 3150 5650\n3650 5150 3650 5650\n";

class ApplicationTest : public ::testing::Test {
  protected:
    void SetUp() override {
        serve(0);
        Settings settings;
        settings.robot = lab_->address("PeopleBot");
        if (serial_) settings.laser = lab_->address("PeopleBot.laser");
        // Pictures are tried where the laboratory is a program of its own: MRPT brings along a GL that is not
        // OSMesa's.
        settings.camera.clear();
        settings.application = "peoplebot-test-" + std::to_string(::getpid());
        settings.ports = ports_.path();
        settings.profiles = "robots/peoplebot";
        settings.at = at_.value_or(MapPose{});
        settings.at_given = at_.has_value();
        // This machine may stand still for a while; loss of the robot has its own tests, which close the
        // connection.
        settings.robot_silence_limit = std::chrono::seconds{10};
        settings.guard_silence = milliseconds{2000};
        application_ = std::make_unique<Application>(settings);
        application_->start();
        manager_ = std::make_unique<test::RobotManager>(settings.application);
        ASSERT_TRUE(waitUntil([&] { return manager_->active("Driving") && manager_->active("Turning"); }));
    }
    void TearDown() override {
        application_.reset();
        manager_.reset();
        unserve();
        std::filesystem::remove(truth_path_);
    }
    void serve(int port) {
        auto world = world_;
        if (world.robots.empty()) world.robots = {lab::parseRobot("", 0)};
        lab::LabServer::Options options{.listen = test::loopbackAddress(), .first_port = port, .speed = 2};
        options.truth_path = truth_path_;
        options.pty = options.lasers = serial_;
        lab_ = std::make_unique<lab::LabServer>(world, options);
        port_ = lab_->ports().at(0);
        lab_thread_ = std::thread([this] { lab_->run(); });
    }
    void unserve() {
        if (!lab_) return;
        lab_->stop();
        lab_thread_.join();
        lab_.reset();
    }
    std::string drive(double distance_mm, double velocity_mm_s = 300) {
        return manager_->dispatch("Driving", {{"Distance", distance_mm}, {"Velocity", velocity_mm_s}});
    }
    std::string navigate(const std::string& map,
                         const std::vector<std::pair<std::string, std::string>>& params) {
        std::vector<std::pair<std::string, std::string>> resources;
        if (!map.empty()) resources.emplace_back("Map", map);
        return manager_->dispatchTexts("Navigation", params, resources);
    }
    /// From the laboratory's truth.
    double lastTrue(const std::string& field) const {
        std::ifstream file(truth_path_);
        std::string line;
        std::string last;
        while (std::getline(file, line)) last = line;
        const auto at = last.find("\"" + field + "\":");
        return at == std::string::npos ? 0 : std::stod(last.substr(at + field.size() + 3));
    }
    bool stands() const { return std::abs(lastTrue("speed_m_s")) < 0.005; }
    bool moves() const { return lastTrue("speed_m_s") > 0.1; }

    const std::string truth_path_ =
        (std::filesystem::temp_directory_path() / ("axon-peoplebot-truth-" + std::to_string(::getpid())))
            .string();
    const robots::TemporaryFile ports_{"Axon.Ports = 5500-8000\nAxon.Address = " + test::loopbackAddress() +
                                       "\n"};
    int port_ = 0;
    std::optional<MapPose> at_ = MapPose{1500, 3000, 0};  // what the program is told
    bool serial_ = false;  // robot and laser are each on a serial line, as on the real one
    lab::WorldDescription world_;
    std::unique_ptr<lab::LabServer> lab_;
    std::thread lab_thread_;
    std::unique_ptr<test::RobotManager> manager_;
    std::unique_ptr<Application> application_;
};

TEST_F(ApplicationTest, DrivingMovesTheRobotAndTellsTheWay) {
    const auto task = drive(500);
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }));
    const auto end = *manager_->end(task);
    EXPECT_EQ(end.state(), proto::TASK_SUCCEEDED) << end.reason().message();
    double travelled = 0;
    for (const auto& result : end.results()) {
        if (result.name() == "Travelled") travelled = result.values(0).dbl();
    }
    EXPECT_NEAR(travelled, 500, 15);
    ASSERT_TRUE(waitUntil([&] { return stands(); }));
    EXPECT_NEAR(lastTrue("x_m"), 2.0, 0.04);
}

TEST_F(ApplicationTest, TurningTurns) {
    const auto task = manager_->dispatch("Turning", {{"Angle", 90}, {"Velocity", 60}});
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_SUCCEEDED) << manager_->end(task)->reason().message();
    EXPECT_NEAR(lastTrue("theta_deg"), 90, 10);
}

TEST_F(ApplicationTest, ATaskThatBeginsAtTheEndOfAnotherFindsTheDriveFree) {
    constexpr int kTurns = 20;
    const auto turn = [&] { return manager_->dispatch("Turning", {{"Angle", 5}, {"Velocity", 60}}); };
    std::mutex mutex;
    std::vector<proto::TaskEvent> ends;
    const auto count = [&] {
        const std::lock_guard lock(mutex);
        return ends.size();
    };
    manager_->on_end = [&](const proto::TaskEvent& event) {
        {
            const std::lock_guard lock(mutex);
            ends.push_back(event);
            if (ends.size() == kTurns) return;
        }
        turn();
    };
    turn();
    ASSERT_TRUE(waitUntil([&] { return count() == kTurns; }, std::chrono::seconds{60}));
    for (const auto& end : ends) EXPECT_EQ(end.state(), proto::TASK_SUCCEEDED) << end.reason().message();
}

TEST_F(ApplicationTest, AStopInMidDriveHaltsTheRobotAndIsAcknowledgedTwice) {
    const auto task = drive(5000);
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    const auto generation = manager_->stop();
    EXPECT_TRUE(
        waitUntil([&] { return manager_->reached(generation, proto::StopReceipt::CALLBACK_RETURNED); }));
    EXPECT_TRUE(waitUntil([&] { return manager_->reached(generation, proto::StopReceipt::STANDSTILL); }));
    EXPECT_TRUE(waitUntil([&] { return stands(); }));
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_STOPPED);
    // What was stopped does not keep the next task from driving.
    const auto next = drive(300);
    ASSERT_TRUE(waitUntil([&] { return manager_->end(next).has_value(); }));
    EXPECT_EQ(manager_->end(next)->state(), proto::TASK_SUCCEEDED);
}

TEST_F(ApplicationTest, ASpeedLimitThatIsSetOnTheWayHoldsAndFeedbackTellsIt) {
    const auto task = drive(5000, 600);
    const auto speed = [&] {
        const auto told = manager_->told(task, "Speed");
        return told ? told->values(0).dbl() : 0;
    };
    ASSERT_TRUE(waitUntil([&] { return speed() > 300; }));
    manager_->configure("Driving", "Speed Limit", 100, task);
    EXPECT_TRUE(waitUntil([&] { return speed() > 50 && speed() < 120; }));
    EXPECT_TRUE(waitUntil([&] { return std::abs(lastTrue("speed_m_s") - 0.1) < 0.02; }));
    EXPECT_EQ(manager_->told(task, "Speed")->units(), "mm/s");
    const auto remaining = manager_->told(task, "Remaining");
    ASSERT_TRUE(remaining);
    EXPECT_EQ(remaining->units(), "mm");
    EXPECT_LT(remaining->values(0).dbl(), 5000);
    manager_->configure("Driving", "Speed Limit", 800, task);
    EXPECT_TRUE(waitUntil([&] { return speed() > 300; }));
    // While a stop is latched it moves nothing.
    const auto generation = manager_->stop();
    ASSERT_TRUE(waitUntil([&] { return manager_->reached(generation, proto::StopReceipt::STANDSTILL); }));
    manager_->configure("Driving", "Speed Limit", 700, task);
    manager_->configure("Driving", "Speed Limit", 700);
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_STOPPED);
    EXPECT_TRUE(waitUntil([&] { return stands(); }));
}

TEST_F(ApplicationTest, ACancelHaltsTheRobotToo) {
    const auto task = drive(5000);
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    manager_->cancel(task);
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_CANCELLED);
    EXPECT_TRUE(waitUntil([&] { return stands(); }));
}

TEST_F(ApplicationTest, APauseHoldsTheRobotAndResumeFinishesTheWay) {
    const auto task = drive(800);
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    manager_->pause(task, false);
    ASSERT_TRUE(waitUntil([&] { return stands(); }));
    EXPECT_FALSE(manager_->end(task));
    manager_->pause(task, true);
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_SUCCEEDED) << manager_->end(task)->reason().message();
}

TEST_F(ApplicationTest, LosingTheEntityManagerStopsTheRobot) {
    drive(5000);
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    manager_->die();
    EXPECT_TRUE(waitUntil([&] { return stands(); }));
}

TEST_F(ApplicationTest, EndingTheApplicationStopsTheRobot) {
    drive(5000);
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    application_.reset();
    EXPECT_TRUE(waitUntil([&] { return stands(); }));
}

TEST_F(ApplicationTest, LosingTheRobotFailsTheTaskAndItsReturnMendsEverything) {
    const auto task = drive(5000);
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    unserve();
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_FAILED);
    EXPECT_EQ(manager_->end(task)->reason().code(), proto::ROBOT_LOST);
    ASSERT_TRUE(waitUntil([&] { return !manager_->active("Driving") && !manager_->active("Turning"); }));
    EXPECT_THAT(manager_->inactiveReason("Driving"), HasSubstr("the robot is lost"));
    const auto refused = drive(100);
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(refused).has_value(); }));
    EXPECT_EQ(manager_->answer(refused)->code(), proto::ROBOT_LOST);

    serve(port_);
    ASSERT_TRUE(waitUntil([&] { return manager_->active("Driving"); }));
    const auto next = drive(300);
    ASSERT_TRUE(waitUntil([&] { return manager_->end(next).has_value(); }));
    EXPECT_EQ(manager_->end(next)->state(), proto::TASK_SUCCEEDED) << manager_->end(next)->reason().message();
}

TEST_F(ApplicationTest, WhatCannotBeDrivenIsDeniedWithTheMend) {
    const auto slow = drive(1000, 5);
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(slow).has_value(); }));
    EXPECT_THAT(manager_->answer(slow)->message(), HasSubstr("give 20 to 800 mm/s"));
    const auto nowhere = manager_->dispatch("Driving", {});
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(nowhere).has_value(); }));
    EXPECT_NE(manager_->answer(nowhere)->code(), proto::OK);
    EXPECT_TRUE(stands());
}

TEST_F(ApplicationTest, AWallEndsTheDriveWithTheSonarThatSawIt) {
    const auto task =
        manager_->dispatch("Driving", {{"Distance", 9000}, {"Velocity", 600}, {"Range Threshold", 3000}});
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }, std::chrono::seconds{30}));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_FAILED);
    EXPECT_THAT(manager_->end(task)->reason().message(), HasSubstr("nearer than the threshold 3000 mm"));
}

TEST_F(ApplicationTest, WanderingGoesOnUntilItIsStopped) {
    const auto task = manager_->dispatch("Wander", {{"Velocity", 300}});
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    EXPECT_FALSE(manager_->end(task));
    const auto generation = manager_->stop();
    EXPECT_TRUE(waitUntil([&] { return manager_->reached(generation, proto::StopReceipt::STANDSTILL); }));
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_STOPPED);
    EXPECT_TRUE(waitUntil([&] { return stands(); }));
}

TEST_F(ApplicationTest, ANavigationThatCannotBeIsDeniedWithTheReason) {
    const auto refusal = [&](const std::string& map,
                             const std::vector<std::pair<std::string, std::string>>& params) {
        const auto task = navigate(map, params);
        waitUntil([&] { return manager_->answer(task).has_value(); });
        return manager_->answer(task).value_or(proto::Refusal()).message();
    };
    const std::string map = "robots/peoplebot/testdata/small.map";
    EXPECT_THAT(refusal("", {{"Destination", "west"}}), HasSubstr("upload one made with Mapper3"));
    EXPECT_THAT(refusal("robots/peoplebot/wander.rules", {{"Destination", "west"}}), HasSubstr("2D-Map"));
    EXPECT_THAT(refusal(map, {{"Destination", "moon"}}), HasSubstr("no goal \"moon\": it has"));
    EXPECT_THAT(refusal(map, {{"Destination", "kept out"}}), HasSubstr("forbidden area"));
    EXPECT_THAT(refusal(map, {{"Destination", "west"}, {"Start", "here"}}),
                HasSubstr("Start here: expected X,Y,HEADING"));
    EXPECT_THAT(refusal(map, {{"Destination", "west"}, {"Start", "90000,0,0"}}), HasSubstr("not on the map"));
    EXPECT_TRUE(stands());
}

TEST_F(ApplicationTest, NavigationDrivesToAGoalOfTheMap) {
    for (const char* stream : {"laser", "localisation", "localisation quality", "particles"})
        manager_->watch(stream);
    const robots::TemporaryFile map(kDefaultWorld);
    const auto task = navigate(map.path().string(), {{"Destination", "middle"}, {"Start", "1500,3000,0"}});
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }, std::chrono::seconds{60}));
    const auto end = *manager_->end(task);
    EXPECT_EQ(end.state(), proto::TASK_SUCCEEDED) << end.reason().message();
    EXPECT_NEAR(lastTrue("x_m"), 2.6, 0.25);
    EXPECT_NEAR(lastTrue("y_m"), 2.6, 0.25);
    EXPECT_NEAR(lastTrue("theta_deg"), -90, 8);
    ASSERT_TRUE(manager_->told(task, "Remaining"));
    EXPECT_LT(manager_->told(task, "Remaining")->values(0).dbl(), 400);
    for (const char* stream : {"laser", "localisation", "localisation quality", "particles"})
        EXPECT_GT(manager_->samples(stream), 0) << stream;
}

/// Nobody has said where the robot stands.
class HomeApplicationTest : public ApplicationTest {
  protected:
    HomeApplicationTest() { at_.reset(); }
    /// The room with a niche, so that it looks different from everywhere; the home is `home`.
    static std::string map(const std::string& home) {
        return "2D-Map\nCairn: Goal 5500 2600 0 \"\" ICON \"middle\"\nCairn: " + home +
               " \"\" ICON \"home\"\nLINES\n0 0 8000 0\n8000 0 8000 6000\n8000 6000 0 6000\n0 6000 0 0\n"
               "2000 5000 3000 5000\n2000 5000 2000 6000\n3000 5000 3000 6000\n";
    }
    void SetUp() override {
        world_.boxes = {{.x = 2.5, .y = 5.5, .dx = 1, .dy = 0.999, .height = 1.5}};
        world_.robots = {{.x = 1.5, .y = 3}};
        ApplicationTest::SetUp();
    }
};

TEST_F(HomeApplicationTest, NavigationCountsTheWaySinceTheRobotLeftItsHome) {
    const robots::TemporaryFile file(map("RobotHome 1500 3000 0"));
    const auto driven = drive(1400, 400);
    ASSERT_TRUE(waitUntil([&] { return manager_->end(driven).has_value(); }, std::chrono::seconds{30}));
    const auto task = navigate(file.path().string(), {{"Destination", "middle"}});
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }, std::chrono::seconds{60}));
    EXPECT_EQ(manager_->end(task)->state(), proto::TASK_SUCCEEDED) << manager_->end(task)->reason().message();
    EXPECT_NEAR(lastTrue("x_m"), 5.5, 0.25);
    EXPECT_NEAR(lastTrue("y_m"), 2.6, 0.25);
}

TEST_F(HomeApplicationTest, ARobotThatIsNotAtTheMapsHomeIsDeniedAndStandsStill) {
    for (const char* home : {"RobotHome 6500 1000 90", "Dock 6500 1000 90", "Elsewhere 0 0 0"}) {
        const robots::TemporaryFile file(map(home));
        std::string why;
        // The laser's first readings come a little after the connection.
        ASSERT_TRUE(waitUntil([&] {
            const auto task = navigate(file.path().string(), {{"Destination", "middle"}});
            waitUntil([&] { return manager_->answer(task).has_value(); });
            why = manager_->answer(task).value_or(proto::Refusal()).message();
            return why.find("sends no readings") == std::string::npos;
        }));
        EXPECT_THAT(why, HasSubstr("nobody has said where the robot is")) << home;
        EXPECT_THAT(why, HasSubstr("fix: give Start")) << home;
    }
    EXPECT_TRUE(stands());
    EXPECT_NEAR(lastTrue("x_m"), 1.5, 0.01);
}

class SerialLinesTest : public ApplicationTest {
  protected:
    void SetUp() override {
        serial_ = true;
        ApplicationTest::SetUp();
    }
    /// The experimenter's hands: requests of lab/control.hpp, a line each.
    void control(const std::vector<std::string>& requests) const {
        auto line = std::move(robots::tcpStreams(lab_->address("control"))(std::chrono::seconds{5})).value();
        std::string all;
        for (const auto& request : requests) all += request + "\n";
        ASSERT_TRUE(line->write({reinterpret_cast<const std::uint8_t*>(all.data()), all.size()}));
        std::size_t answers = 0;
        EXPECT_TRUE(waitUntil([&] {
            std::array<std::uint8_t, 4096> chunk{};
            const int got = line->read(chunk);
            answers +=
                static_cast<std::size_t>(std::count(chunk.begin(), chunk.begin() + std::max(got, 0), '\n'));
            return answers >= requests.size();
        }));
    }
};

TEST_F(SerialLinesTest, ScansOfTheLasersOwnLineFindTheWayToAGoal) {
    manager_->watch("laser");
    const robots::TemporaryFile map(kDefaultWorld);
    const auto task = navigate(map.path().string(), {{"Destination", "middle"}, {"Start", "1500,3000,0"}});
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }, std::chrono::seconds{60}));
    const auto end = *manager_->end(task);
    EXPECT_EQ(end.state(), proto::TASK_SUCCEEDED) << end.reason().message();
    EXPECT_NEAR(lastTrue("x_m"), 2.6, 0.25);
    EXPECT_NEAR(lastTrue("y_m"), 2.6, 0.25);
    EXPECT_GT(manager_->samples("laser"), 0);
}

TEST_F(SerialLinesTest, WanderKeepsOffAWallThatOnlyTheLaserSees) {
    manager_->watch("laser");
    ASSERT_TRUE(waitUntil([&] { return manager_->samples("laser") > 0; }));
    std::vector<std::string> faults;
    for (int sonar = 0; sonar < 24; ++sonar)
        faults.push_back(R"({"do":"fault","name":"PeopleBot","kind":"dead-sonar","which":)" +
                         std::to_string(sonar) + "}");
    faults.emplace_back(R"({"do":"move","name":"PeopleBot","x":6.5,"y":3,"theta":0})");
    control(faults);
    const auto task = manager_->dispatch("Wander", {{"Velocity", 300}, {"Duration", 10}});
    ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }, std::chrono::seconds{30}));
    const auto end = *manager_->end(task);
    EXPECT_EQ(end.state(), proto::TASK_SUCCEEDED) << end.reason().message();
    double travelled = 0;
    std::int64_t recoveries = -1;
    for (const auto& result : end.results()) {
        if (result.name() == "Travelled") travelled = result.values(0).dbl();
        if (result.name() == "Recoveries") recoveries = result.values(0).int_();
    }
    EXPECT_GT(travelled, 1500) << "further than the wall in front of it";
    EXPECT_EQ(recoveries, 0) << "it touched something";
}

TEST_F(SerialLinesTest, AStopReachesTheMotorsAndTheEndOfTheProgramToo) {
    drive(5000);
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    const auto generation = manager_->stop();
    EXPECT_TRUE(waitUntil([&] { return manager_->reached(generation, proto::StopReceipt::STANDSTILL); }));
    EXPECT_TRUE(waitUntil([&] { return stands(); }));
    drive(5000);
    ASSERT_TRUE(waitUntil([&] { return moves(); }));
    application_.reset();
    EXPECT_TRUE(waitUntil([&] { return stands(); }));
}

TEST_F(ApplicationTest, StreamsCarryPoseSonarAndBattery) {
    for (const char* stream : {"pose", "sonar", "battery"}) manager_->watch(stream);
    for (const char* stream : {"pose", "sonar", "battery"}) {
        EXPECT_TRUE(waitUntil([&] { return manager_->samples(stream) > 0; })) << stream;
    }
}

class GraspApplicationTest : public ApplicationTest {
  protected:
    void SetUp() override {
        lab::Object object;
        object.colour = "red";
        object.x = 3.05;
        object.y = 3.1;
        world_.objects = {object};
        world_.tables = {{.name = "west", .x = 3.4, .y = 3, .dx = 0.8, .dy = 2, .height = 0.66}};
        lab::RobotPlacement robot;
        robot.x = 2.0;
        robot.y = 3;
        world_.robots = {robot};
        ApplicationTest::SetUp();
        ASSERT_TRUE(waitUntil([&] { return manager_->active("Operate Gripper"); }));
    }
    std::optional<proto::TaskEvent> wait(const std::string& task) {
        waitUntil([&] { return manager_->end(task).has_value(); }, std::chrono::seconds{60});
        return manager_->end(task);
    }
    std::string grip(const std::string& direction, std::optional<bool> open) {
        std::vector<std::pair<std::string, Value>> params{{"Direction", direction}};
        if (open) params.emplace_back("Open/Close", *open);
        return manager_->dispatchValues("Operate Gripper", params);
    }
};

TEST_F(GraspApplicationTest, ComesUpToTheTableAndSquaresUp) {
    const auto task = manager_->dispatchValues("Approach Table", {{"Velocity", 250.0}});
    const auto end = wait(task);
    ASSERT_TRUE(end) << manager_->answer(task)->message();
    EXPECT_EQ(end->state(), proto::TASK_SUCCEEDED) << end->reason().message();
    ASSERT_TRUE(waitUntil([&] { return stands(); }));
    EXPECT_NEAR(lastTrue("x_m"), 3.0 - 0.333 + 0.23, 0.05);
}

TEST_F(GraspApplicationTest, AStopHaltsLiftAndPaddlesAndTheNextTaskMovesThemAgain) {
    const auto up = grip("up", true);
    ASSERT_TRUE(
        waitUntil([&] { return manager_->progress(up) > 0.1 || manager_->end(up) || manager_->answer(up); }));
    const auto generation = manager_->stop();
    EXPECT_TRUE(
        waitUntil([&] { return manager_->reached(generation, proto::StopReceipt::CALLBACK_RETURNED); }));
    auto end = wait(up);
    ASSERT_TRUE(end);
    EXPECT_EQ(end->state(), proto::TASK_STOPPED);
    end = wait(grip("none", false));
    ASSERT_TRUE(end);
    EXPECT_EQ(end->state(), proto::TASK_SUCCEEDED) << end->reason().message();
}

TEST_F(GraspApplicationTest, AnUnknownColourAndNothingToDoAreDenied) {
    const auto pink =
        manager_->dispatchValues("Table Object Tracking and Grabbing", {{"Color", std::string("pink")}});
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(pink).has_value(); }));
    EXPECT_THAT(manager_->answer(pink)->message(), HasSubstr("red, orange, yellow, green or blue"));
    const auto nothing = grip("none", std::nullopt);
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(nothing).has_value(); }));
    EXPECT_THAT(manager_->answer(nothing)->message(), HasSubstr("nothing to do"));
}

}  // namespace
}  // namespace axon::peoplebot
