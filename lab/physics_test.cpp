// SPDX-License-Identifier: GPL-2.0-or-later
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
        lab_->clientConnected(0);
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

    void send(const arcos::Bytes& bytes) override { lab_->receive(0, bytes); }
    void onOnline(const arcos::RobotIdentity& /*identity*/) override {}
    void onState(const arcos::RobotState& /*state*/) override {}
    void onLost(const std::string& reason) override { lost_.push_back(reason); }

    void order(Command command, int argument) { lab_->receive(0, arcos::encodeCommand(command, argument)); }
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

}  // namespace
}  // namespace axon::lab
