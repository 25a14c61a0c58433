// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/motion_control.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace axon::lab {
namespace {

constexpr Duration kPeriod = std::chrono::milliseconds{4};

/// A drive that does at once what it is told.
class MotionControlTest : public ::testing::Test {
  protected:
    void run(double seconds) {
        for (int i = 0; i < seconds / 0.004; ++i) {
            speed_ = motion_.step(kPeriod, distance_mm_, heading_deg_);
            distance_mm_ += speed_.forward_mm_s * 0.004;
            heading_deg_ += speed_.left_deg_s * 0.004;
        }
    }

    MotionControl motion_;
    BodySpeed speed_;
    double distance_mm_ = 0;
    double heading_deg_ = 0;
};

TEST_F(MotionControlTest, SpeedRampsWithTheSetAcceleration) {
    motion_.setVelocity(300);
    run(0.5);
    EXPECT_NEAR(speed_.forward_mm_s, 150, 2);
    run(1);
    EXPECT_DOUBLE_EQ(speed_.forward_mm_s, 300);
    motion_.stop();
    run(0.25);
    EXPECT_NEAR(speed_.forward_mm_s, 150, 4);
    run(0.5);
    EXPECT_TRUE(motion_.resting());
}

TEST_F(MotionControlTest, SpeedIsClampedToTheSetLimit) {
    motion_.setVelocity(-5000);
    run(10);
    EXPECT_DOUBLE_EQ(speed_.forward_mm_s, -750);
}

TEST_F(MotionControlTest, EmergencyStopBrakesHarderThanStop) {
    motion_.setVelocity(600);
    run(4);
    motion_.emergencyStop();
    run(0.3);
    EXPECT_DOUBLE_EQ(speed_.forward_mm_s, 0);
    motion_.setVelocity(600);
    run(1);
    EXPECT_GT(speed_.forward_mm_s, 200);
}

TEST_F(MotionControlTest, AStopDoesNotSoftenAnEmergencyStop) {
    motion_.setVelocity(600);
    motion_.setRotation(80);
    run(4);
    motion_.emergencyStop();
    motion_.stop();
    run(0.3);
    EXPECT_TRUE(motion_.resting());
}

TEST_F(MotionControlTest, MoveEndsAtItsDistance) {
    motion_.move(-800);
    run(10);
    EXPECT_NEAR(distance_mm_, -800, 5);
    EXPECT_TRUE(motion_.resting());
}

TEST_F(MotionControlTest, TurnToTakesTheShorterWayAndTurnByTheWholeOne) {
    heading_deg_ = 170;
    motion_.turnTo(-170);
    run(10);
    EXPECT_NEAR(heading_deg_, 190, 1);
    motion_.turnBy(-270);
    run(10);
    EXPECT_NEAR(heading_deg_, -80, 1.5);
}

TEST_F(MotionControlTest, AReversalGoesThroughZero) {
    motion_.setVelocity(300);
    run(2);
    motion_.setVelocity(-300);
    double slowest = 300;
    for (int i = 0; i < 500; ++i) {
        const double before = speed_.forward_mm_s;
        run(0.004);
        slowest = std::min(slowest, std::abs(speed_.forward_mm_s));
        EXPECT_LT(std::abs(speed_.forward_mm_s - before), 4);
    }
    EXPECT_EQ(slowest, 0);
    EXPECT_DOUBLE_EQ(speed_.forward_mm_s, -300);
}

TEST_F(MotionControlTest, HaltIsImmediateAndForgetsGoals) {
    motion_.move(5000);
    run(2);
    motion_.halt();
    run(1);
    EXPECT_DOUBLE_EQ(speed_.forward_mm_s, 0);
    EXPECT_TRUE(motion_.resting());
}

}  // namespace
}  // namespace axon::lab
