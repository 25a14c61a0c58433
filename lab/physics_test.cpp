// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "lab/laboratory.hpp"
#include "robots/arcos/client_session.hpp"

namespace axon::lab {
namespace {

using arcos::Command;

/// A whole laboratory with an ARCOS client on its only robot, in the laboratory's own time.
class PhysicsTest : public ::testing::Test, public arcos::ClientSession::Port {
  protected:
    void start(WorldDescription world) {
        lab_ = std::make_unique<Laboratory>(world, [this](std::size_t robot, const arcos::Bytes& bytes) {
            if (robot == 0) inbox_.insert(inbox_.end(), bytes.begin(), bytes.end());
        });
        lab_->robot(0).clientConnected();
        session_.begin(lab_->now());
        run(0.3);
        ASSERT_EQ(session_.state(), arcos::ClientSession::State::Online);
        order(Command::Enable, 1);
        order(Command::BumpStall, 0);
        run(1.0);  // settle on the floor, and hear each sonar
    }
    void start(double x, double y, double theta) {
        WorldDescription world;
        world.robots = {{.x = x, .y = y, .theta = theta}};
        start(world);
    }

    void send(const arcos::Bytes& bytes) override { lab_->robot(0).receive(bytes); }
    void onOnline(const arcos::RobotIdentity& /*identity*/) override {}
    void onState(const arcos::RobotState& /*state*/) override {}
    void onLost(const std::string& reason) override { lost_.push_back(reason); }

    void order(Command command, int argument) {
        lab_->robot(0).receive(arcos::encodeCommand(command, argument));
    }
    void run(double seconds) {
        const auto end =
            lab_->age() + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(seconds));
        while (lab_->age() < end) {
            session_.receive(std::exchange(inbox_, {}), lab_->now());
            lab_->step();
            session_.tick(lab_->now());
        }
    }
    const arcos::RobotState& robot() const { return session_.robot(); }

    std::unique_ptr<Laboratory> lab_;
    arcos::Bytes inbox_;
    std::vector<std::string> lost_;
    arcos::ClientSession session_{*this};
};

TEST_F(PhysicsTest, StandsStillWhereItWasPut) {
    start(2, 3, 30);
    run(5);
    const auto truth = lab_->truth(0);
    EXPECT_NEAR(truth.x_m, 2, 0.005);
    EXPECT_NEAR(truth.y_m, 3, 0.005);
    EXPECT_NEAR(truth.theta_deg, 30, 0.5);
    EXPECT_NEAR(robot().heading_deg, 0, 0.2);
}

TEST_F(PhysicsTest, OneMetreAt300MillimetresASecondEndsWithinFivePercent) {
    start(2, 3, 0);
    order(Command::SetV, 300);
    order(Command::Move, 1000);
    run(6);
    const auto truth = lab_->truth(0);
    EXPECT_NEAR(truth.x_m, 3, 0.05);
    EXPECT_NEAR(truth.y_m, 3, 0.03);
    EXPECT_NEAR(robot().x_mm, 1000, 10);
    EXPECT_NEAR(truth.speed_m_s, 0, 0.005);
    RecordProperty("way_mm", static_cast<int>((truth.x_m - 2) * 1000));
}

TEST_F(PhysicsTest, CruisesAtTheOrderedSpeed) {
    start(1, 3, 0);
    order(Command::Vel, 300);
    run(3);
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0.3, 0.015);
    EXPECT_NEAR(robot().speed_mm_s(), 300, 15);
    order(Command::Vel, 0);
    run(2);
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0, 0.005);
}

TEST_F(PhysicsTest, HoldsTheOrderedSpeedWithoutOvershoot) {
    for (const int speed : {60, 100, 300, 700, -100, -300, -700}) {
        WorldDescription world;
        world.room_x = 20;
        world.robots = {{.x = 10, .y = 3}};
        start(world);
        order(Command::Vel, speed);
        double fastest = 0;
        const auto go = [&](int tenths) {
            for (int i = 0; i < tenths; ++i) {
                run(0.1);
                fastest = std::max(fastest, std::abs(robot().speed_mm_s()));
            }
        };
        go(35);
        const double by_wheels = robot().x_mm;
        const double truth = lab_->truth(0).x_m;
        go(30);
        EXPECT_NEAR((robot().x_mm - by_wheels) / 3, speed, std::abs(speed) * 0.01) << speed;
        EXPECT_NEAR((lab_->truth(0).x_m - truth) * 1000 / 3, speed, std::abs(speed) * 0.01) << speed;
        EXPECT_LE(fastest, std::abs(speed) + 1.5) << speed;
        session_.end("");
    }
}

TEST_F(PhysicsTest, HoldsTheOrderedRateOfATurn) {
    for (const int rate : {5, 20, 50, 100, -5, -20, -50, -100}) {
        start(4, 3, 0);
        order(Command::RVel, rate);
        run(2.5);
        const auto turned = [](double from_deg, double to_deg) {
            return std::remainder(to_deg - from_deg, 360);
        };
        double by_wheels = 0;
        double truly = 0;
        for (int i = 0; i < 30; ++i) {
            const double wheels_before = robot().heading_deg;
            const double before = lab_->truth(0).theta_deg;
            run(0.1);
            by_wheels += turned(wheels_before, robot().heading_deg);
            truly += turned(before, lab_->truth(0).theta_deg);
        }
        EXPECT_NEAR(by_wheels / 3, rate, 0.5) << rate;
        EXPECT_NEAR(truly / 3, rate, std::abs(rate) * 0.03) << rate << ": the tyres slip";
        order(Command::RVel, 0);
        run(2);
        const double rests = lab_->truth(0).theta_deg;
        run(3);
        EXPECT_NEAR(turned(rests, lab_->truth(0).theta_deg), 0, 0.01) << rate;
        session_.end("");
    }
}

TEST_F(PhysicsTest, ATurnByAnAngleDoesNotSwingBeyondIt) {
    for (const int angle : {90, -90}) {
        start(4, 3, 0);
        order(Command::SetRv, 50);
        order(Command::DHead, angle);
        double farthest = 0;
        for (int i = 0; i < 50; ++i) {
            run(0.1);
            farthest = std::max(farthest, std::abs(robot().heading_deg));
        }
        EXPECT_NEAR(robot().heading_deg, angle, 1) << angle;
        EXPECT_LE(farthest, 90.6) << angle;
        session_.end("");
    }
}

TEST_F(PhysicsTest, ARampThatTheMotorsCannotFollowEndsWithoutOvershoot) {
    start(1, 3, 0);
    order(Command::SetA, 5000);
    order(Command::Vel, 700);
    double fastest = 0;
    for (int i = 0; i < 250; ++i) {
        run(0.004);
        fastest = std::max(fastest, lab_->truth(0).speed_m_s);
    }
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0.7, 0.007);
    EXPECT_LE(fastest, 0.715) << "what the motors could not give is not made up for";
}

TEST_F(PhysicsTest, ABlockedMotorStallsHoweverSlowlyItWasToTurn) {
    start(7.6, 3, 0);
    order(Command::Vel, 40);
    run(8);
    EXPECT_GE(lab_->controller(0).counters().stalls, 1U);
    order(Command::Vel, 0);
    run(1);
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0, 0.002) << "and pushes no more";
    order(Command::Vel, -100);
    run(2);
    EXPECT_NEAR(robot().speed_mm_s(), -100, 1.5);
}

TEST_F(PhysicsTest, ATurnSlipsALittleAndOnlyTheTruthKnows) {
    start(3, 3, 0);
    order(Command::SetRv, 50);
    order(Command::DHead, 90);
    run(6);
    EXPECT_NEAR(robot().heading_deg, 90, 1.5);
    EXPECT_NEAR(lab_->truth(0).theta_deg, 90, 9);
    EXPECT_NEAR(lab_->truth(0).x_m, 3, 0.05);
}

TEST_F(PhysicsTest, AWallPressesTheFrontBumperAndStallsTheMotors) {
    start(7, 3, 0);
    order(Command::BumpStall, 3);
    order(Command::Vel, 300);
    run(5);
    EXPECT_NE(robot().front_bumpers, 0U);
    EXPECT_EQ(robot().rear_bumpers, 0U);
    EXPECT_GE(lab_->controller(0).counters().stalls, 1U);
    EXPECT_NEAR(lab_->truth(0).x_m, 8 - 0.212, 0.03);
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0, 0.01);
    order(Command::Vel, -200);
    run(2);
    EXPECT_LT(lab_->truth(0).x_m, 7.6);
    EXPECT_EQ(robot().front_bumpers, 0U);
}

TEST_F(PhysicsTest, BackingIntoAWallPressesTheRearBumper) {
    start(0.8, 3, 0);
    order(Command::BumpStall, 3);
    order(Command::Vel, -200);
    run(5);
    EXPECT_NE(robot().rear_bumpers, 0U);
    EXPECT_EQ(robot().front_bumpers, 0U);
    EXPECT_NEAR(lab_->truth(0).x_m, 0.301, 0.03);
}

TEST_F(PhysicsTest, WithoutBumpStallTheMotorsBlockAgainstAWall) {
    start(7.5, 3, 0);
    order(Command::Vel, 300);
    run(6);
    EXPECT_GE(lab_->controller(0).counters().stalls, 1U);
}

TEST_F(PhysicsTest, SonarsSeeTheWallsAtTheRightDistance) {
    start(3, 2.5, 0);
    // Ahead: the sonars at +-10 degrees have the wall's normal inside their cones.
    EXPECT_NEAR(robot().sonars[3].range_mm, 8000 - 3000 - 166, 10);
    EXPECT_NEAR(robot().sonars[0].range_mm, 6000 - 2500 - 136, 10);
    EXPECT_NEAR(robot().sonars[7].range_mm, 2500 - 136, 10);
    EXPECT_NEAR(robot().sonars[11].range_mm, 3000 - 255, 10);
    EXPECT_NEAR(robot().sonars[16].range_mm, 6000 - 2500 - 136, 10);
    EXPECT_EQ(robot().sonars[24].heard, TimePoint{});
}

TEST_F(PhysicsTest, ALowBoxIsSeenByTheBaseRingOnly) {
    WorldDescription world;
    world.robots = {{.x = 2, .y = 3}};
    world.boxes = {{.x = 4, .y = 3, .dx = 0.4, .dy = 2, .height = 0.6}};
    start(world);
    EXPECT_NEAR(robot().sonars[3].range_mm, 1800 - 166, 40);
    EXPECT_GT(robot().sonars[19].range_mm, 4500);
}

TEST_F(PhysicsTest, AnotherRobotIsSeen) {
    WorldDescription world;
    world.robots = {{.x = 2, .y = 3}, {.name = "Right", .x = 4, .y = 3, .theta = 90}};
    start(world);
    EXPECT_LT(robot().sonars[3].range_mm, 1900);
    EXPECT_GT(robot().sonars[3].range_mm, 1500);
}

TEST_F(PhysicsTest, ATableAboveFiresTheTableSensorOfItsSide) {
    WorldDescription world;
    world.robots = {{.x = 2, .y = 3}};
    world.tables = {{.x = 2.6, .y = 3.45, .dx = 0.6, .dy = 0.5}};  // over the left sensor only
    start(world);
    EXPECT_TRUE(robot().table_left);
    EXPECT_FALSE(robot().table_right);
}

TEST_F(PhysicsTest, TheBatterySlowlyRunsDown) {
    start(2, 3, 0);
    EXPECT_NEAR(robot().battery_v, 12.9, 0.05);
    run(600);
    EXPECT_LT(robot().battery_v, 12.9);
    EXPECT_GT(robot().battery_v, 12.7);
}

TEST_F(PhysicsTest, TheSameCommandsGiveTheSameNumbers) {
    const auto drive = [this] {
        start(2, 3, 10);
        order(Command::Vel, 250);
        order(Command::RVel, 20);
        run(4);
        return lab_->truth(0);
    };
    const auto first = drive();
    session_.end("");
    const auto second = drive();
    EXPECT_EQ(first.x_m, second.x_m);
    EXPECT_EQ(first.theta_deg, second.theta_deg);
}

TEST_F(PhysicsTest, WhatTheRobotTouchesIsRememberedByName) {
    WorldDescription world;
    world.robots = {{.x = 2, .y = 3}};
    world.boxes = {{.name = "crate", .x = 3.2, .y = 3, .height = 0.8}};
    world.objects = {{.name = "bottle", .x = 2.4, .y = 3.1, .dz = 0.3, .mass = 0.2}};
    start(world);
    EXPECT_TRUE(lab_->truth(0).touched.empty());
    order(Command::Vel, 200);
    run(6);
    EXPECT_THAT(lab_->truth(0).touched, ::testing::UnorderedElementsAre("bottle", "crate"));
    const auto bottle = lab_->physics().truthOfObjects().at(0);
    EXPECT_GT(bottle.tilt_deg, 45) << "a bottle of 30 cm is knocked over, not pushed";
    EXPECT_THAT(bottle.on, ::testing::Contains("floor"));
    lab_->physics().forgetTouches();
    order(Command::Vel, -200);
    run(3);
    order(Command::Vel, 0);
    lab_->physics().forgetTouches();
    run(2);
    EXPECT_TRUE(lab_->truth(0).touched.empty());
}

TEST_F(PhysicsTest, AnObstacleAppearsMovesStopsTheRobotAndGoes) {
    start(2, 3, 0);
    auto& physics = lab_->physics();
    physics.addObstacle({.name = "cart", .x = 4, .y = 3, .dx = 0.4, .dy = 1, .height = 1});
    run(1);
    EXPECT_NEAR(robot().sonars[3].range_mm, 1800 - 166, 40);
    physics.moveObstacle("cart", 3, 3, 0);
    run(1);
    EXPECT_NEAR(robot().sonars[3].range_mm, 800 - 166, 40);
    order(Command::BumpStall, 3);
    order(Command::Vel, 200);
    run(6);
    EXPECT_NEAR(lab_->truth(0).x_m, 2.8 - 0.212, 0.02) << "it cannot be pushed";
    EXPECT_THAT(lab_->truth(0).touched, ::testing::ElementsAre("cart"));
    physics.removeObstacle("cart");
    run(1);
    EXPECT_GT(robot().sonars[3].range_mm, 4500);
    EXPECT_THROW(physics.moveObstacle("cart", 3, 3, 0), std::invalid_argument);
    for (int i = 0; i < kObstacles; ++i)
        physics.addObstacle({.name = std::to_string(i), .x = 1.0 + i, .y = 1});
    EXPECT_THROW(physics.addObstacle({.name = "one more"}), std::invalid_argument);
}

TEST_F(PhysicsTest, FaultsBreakWhatTheyNameUntilTheyAreMended) {
    start(2, 3, 0);
    auto& physics = lab_->physics();
    physics.setFault(0, {Fault::Kind::DeadSonar, 0}, true);
    physics.setFault(0, {Fault::Kind::FlatBattery}, true);
    physics.setFault(0, {Fault::Kind::SlippingWheel, 0}, true);
    run(1);
    EXPECT_EQ(robot().sonars[0].range_mm, 5000);
    EXPECT_LT(robot().sonars[7].range_mm, 3000);
    EXPECT_NEAR(robot().battery_v, 11, 0.05);
    order(Command::Vel, 300);
    run(4);
    EXPECT_NEAR(robot().heading_deg, 0, 5) << "the odometry knows nothing of the slip";
    EXPECT_GT(lab_->truth(0).theta_deg, 3) << "the left wheel does not push";
    order(Command::Vel, 0);
    run(2);
    const double x = robot().x_mm;
    lab_->reset();
    run(1);
    EXPECT_NEAR(robot().x_mm, x, 5) << "carried back: the wheels did not turn";
    EXPECT_NEAR(lab_->truth(0).x_m, 2, 0.01);
    EXPECT_LT(robot().sonars[0].range_mm, 3100);
    EXPECT_GT(robot().battery_v, 12);
    EXPECT_THROW(physics.setFault(0, {Fault::Kind::DeadSonar, 24}, true), std::invalid_argument);
}

TEST(Physics, TheLaserMeasuresTheRoomFromRightToLeft) {
    WorldDescription world;
    world.robots = {{.x = 3, .y = 2.5}};
    Physics physics(world);
    physics.setLaser(0, {.on = true});
    const auto& readings = physics.sense(0);
    ASSERT_TRUE(readings.laser_scanned);
    ASSERT_EQ(readings.laser_mm.size(), 181U);
    EXPECT_NEAR(readings.laser_mm[0], 2500, 2);
    EXPECT_NEAR(readings.laser_mm[90], 5000 - 21, 2);
    EXPECT_NEAR(readings.laser_mm[180], 3500, 2);
    physics.step();
    EXPECT_FALSE(physics.sense(0).laser_scanned);
    int scans = 0;
    for (int i = 0; i < 250; ++i) {
        physics.step();
        scans += physics.sense(0).laser_scanned ? 1 : 0;
    }
    EXPECT_NEAR(scans, 10, 1);
    physics.setLaser(0, {.on = true, .resolution_deg = 0.5});
    for (int i = 0; i < 30; ++i) {
        physics.step();
        physics.sense(0);
    }
    EXPECT_EQ(physics.sense(0).laser_mm.size(), 361U);
}

TEST(Physics, SonarsSeeGlassAndTheLaserLooksThrough) {
    auto world = parseWorld("room x=8 y=6\nglass x=4 y=3 dx=2 theta=90\npeoplebot x=3 y=3\n", "a.lab", {});
    Physics physics(world);
    physics.setLaser(0, {.on = true});
    EXPECT_NEAR(physics.sense(0).laser_mm.at(90), 5000 - 21, 2);
    for (int i = 0; i < 100; ++i) {  // each sonar has fired
        physics.step();
        physics.sense(0);
    }
    EXPECT_NEAR(physics.sense(0).sonar_mm[3], 1000 - 10 - 166, 30);
}

TEST(Physics, NoiseComesFromItsSeedAlone) {
    WorldDescription world;
    world.robots = {{.x = 3, .y = 2.5}};
    const auto scan = [&world](const Physics::Options& options) {
        Physics physics(world, options);
        physics.setLaser(0, {.on = true});
        return physics.sense(0).laser_mm;
    };
    const auto exact = scan({});
    const auto noisy = scan({.seed = 7, .noise = 1});
    EXPECT_EQ(noisy, scan({.seed = 7, .noise = 1}));
    EXPECT_NE(noisy, scan({.seed = 8, .noise = 1}));
    EXPECT_EQ(exact, scan({.seed = 7, .noise = 0}));
    double squares = 0;
    for (std::size_t i = 0; i < exact.size(); ++i) squares += std::pow(exact[i] - noisy[i], 2);
    EXPECT_NEAR(std::sqrt(squares / static_cast<double>(exact.size())), 3, 0.8);
}

TEST(Physics, ObjectsStandWhereTheyArePut) {
    WorldDescription world;
    world.tables = {{.name = "west", .x = 2, .y = 2, .height = 0.66}};
    world.objects = {{.name = "red", .x = 2, .y = 2},
                     {.name = "can", .shape = Object::Shape::Cylinder, .x = 5, .y = 3}};
    Physics physics(world);
    for (int i = 0; i < 250; ++i) physics.step();
    auto objects = physics.truthOfObjects();
    EXPECT_NEAR(objects[0].z_m, 0.66, 0.002);
    EXPECT_THAT(objects[0].on, ::testing::ElementsAre("west"));
    EXPECT_NEAR(objects[1].z_m, 0, 0.002);
    physics.placeObject("red", 2.3, 2.1, 0.7, 30);
    for (int i = 0; i < 250; ++i) physics.step();
    objects = physics.truthOfObjects();
    EXPECT_NEAR(objects[0].x_m, 2.3, 0.01);
    EXPECT_NEAR(objects[0].z_m, 0.66, 0.002) << "it has dropped 4 cm";
    EXPECT_THROW(physics.placeObject("blue", 1, 1, 1, 0), std::invalid_argument);
}

TEST(SerialLineTest, ARobotFillsALineOf9600BaudAndAQuarterOfOneOf38400) {
    WorldDescription world;
    world.robots = {{.x = 2, .y = 3}};
    std::size_t bytes = 0;
    // The laser has a line of its own, as on the real robot.
    Laboratory lab(world, [&bytes](std::size_t, const arcos::Bytes& said) { bytes += said.size(); }, {},
                   {.send = [](std::size_t, const arcos::Bytes&) {}, .serial = true});
    lab.robot(0).clientConnected();
    for (const int sync : {0, 1, 2}) lab.robot(0).receive(arcos::encodeCommand(static_cast<Command>(sync)));
    lab.robot(0).receive(arcos::encodeCommand(Command::Open));
    lab.robot(0).receive(arcos::encodeCommand(Command::IoRequest, 2));
    bytes = 0;
    constexpr int kSeconds = 20;
    for (int second = 0; second < kSeconds; ++second) {
        lab.robot(0).receive(arcos::encodeCommand(Command::Pulse));
        for (int i = 0; i < 250; ++i) lab.step();
    }
    const double bits_per_second =
        static_cast<double>(bytes) * 10 / kSeconds;  // a byte has ten bits on the line
    EXPECT_NEAR(bits_per_second / 9600, 0.97, 0.03);
    EXPECT_NEAR(bits_per_second / 38400, 0.24, 0.01);
}

}  // namespace
}  // namespace axon::lab
