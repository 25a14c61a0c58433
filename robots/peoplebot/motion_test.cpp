// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/motion.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "robots/peoplebot/drive_gate.hpp"
#include "robots/peoplebot/map_pose.hpp"

namespace axon::peoplebot {
namespace {

using arcos::RobotState;
using std::chrono::milliseconds;
using ::testing::HasSubstr;
using Outcome = MotionStep::Outcome;

/// A robot that ramps with 600 mm/s2 and 100 deg/s2 and tells of itself ten times a second, free of slip.
class SimulatedRobot {
  public:
    SimulatedRobot() {
        state.online = true;
        hear(5000);
    }
    void hear(int range_mm) {
        for (auto& sonar : state.sonars) sonar = {range_mm, clock.now()};
    }
    void pass(double forward_mm_s, double left_deg_s) {
        for (int i = 0; i < 25; ++i) {
            forward_ += std::clamp(forward_mm_s - forward_, -2.4, 2.4);
            turn_ += std::clamp(left_deg_s - turn_, -0.4, 0.4);
            if (stuck) forward_ = turn_ = 0;
            state.heading_deg += turn_ * 0.004;
            const double a = state.heading_deg * std::numbers::pi / 180;
            state.x_mm += std::cos(a) * forward_ * 0.004;
            state.y_mm += std::sin(a) * forward_ * 0.004;
        }
        clock.advance(milliseconds{100});
        for (auto& sonar : state.sonars) sonar.heard = deaf ? sonar.heard : clock.now();
        state.left_mm_s = state.right_mm_s = forward_;
        state.rotation_deg_s = turn_;
        state.moving = std::abs(forward_) > 2 || std::abs(turn_) > 0.5;
        ++state.sequence;
    }
    template <class Motion>
    MotionStep run(Motion& motion, int packets = 2000, const std::function<void()>& each = {}) {
        MotionStep step;
        for (int i = 0; i < packets && step.outcome == Outcome::Running; ++i) {
            if (each) each();
            step = motion.step(state, clock.now());
            fastest = std::max(fastest, std::abs(step.forward_mm_s));
            pass(step.forward_mm_s, step.left_deg_s);
        }
        return step;
    }

    ManualClock clock;
    RobotState state;
    bool stuck = false;
    bool deaf = false;
    double fastest = 0;

  private:
    double forward_ = 0;
    double turn_ = 0;
};

class DrivingTest : public ::testing::Test {
  protected:
    Driving begin(const Driving::Request& request) { return {request, robot_.state, robot_.clock.now()}; }
    SimulatedRobot robot_;
};

class LatencyTest : public ::testing::Test {
  protected:
    static constexpr double kAcceleration = 100;
    void seen(double speed, int ms) { latency_.seen(speed, start_ + milliseconds{ms}); }
    const TimePoint start_{std::chrono::seconds{1000}};
    LatencyWatch latency_{kAcceleration, true};
};

TEST_F(LatencyTest, IsWhatTheSpeedDoesNotExplain) {
    seen(0, 0);
    seen(0, 100);
    EXPECT_DOUBLE_EQ(latency_.seconds(), LatencyWatch::kUsual_s);
    seen(5, 200);
    EXPECT_NEAR(latency_.seconds(), 0.15, 1e-9);
    seen(15, 300);
    EXPECT_NEAR(latency_.seconds(), 0.15, 1e-9);
}

TEST_F(LatencyTest, DoesNotGrowWhileTheRobotKeepsItsSpeed) {
    seen(0, 0);
    seen(20, 250);
    for (int ms = 350; ms < 2000; ms += 100) seen(30, ms);
    EXPECT_NEAR(latency_.seconds(), 0.05, 1e-9);
}

TEST_F(LatencyTest, IsNeitherNegativeNorLongerThanItsBound) {
    seen(0, 0);
    seen(1, 5000);
    EXPECT_DOUBLE_EQ(latency_.seconds(), LatencyWatch::kMost_s);
    seen(90, 5100);
    EXPECT_DOUBLE_EQ(latency_.seconds(), LatencyWatch::kMost_s);
    LatencyWatch quick(kAcceleration, true);
    quick.seen(0, start_);
    quick.seen(60, start_ + milliseconds{100});
    EXPECT_DOUBLE_EQ(quick.seconds(), 0);
}

TEST_F(LatencyTest, OfARobotThatMovesAlreadyNothingIsMeasured) {
    LatencyWatch moving(kAcceleration, false);
    moving.seen(10, start_);
    moving.seen(20, start_ + milliseconds{400});
    EXPECT_DOUBLE_EQ(moving.seconds(), LatencyWatch::kUsual_s);
}

TEST_F(DrivingTest, EndsAtItsDistanceWhateverTheVelocity) {
    for (const double velocity : {20.0, 100.0, 200.0, 500.0, 800.0, -200.0, -800.0}) {
        SimulatedRobot robot;
        robot.state.heading_deg = 400;
        Driving motion({.distance_mm = 1500, .velocity_mm_s = velocity}, robot.state, robot.clock.now());
        const auto end = robot.run(motion);
        EXPECT_EQ(end.outcome, Outcome::Done) << velocity << ": " << end.reason;
        EXPECT_NEAR(motion.travelled_mm(), 1500, 15) << velocity;
        EXPECT_LE(robot.fastest, std::abs(velocity));
        EXPECT_EQ(end.progress, 1);
    }
}

TEST_F(DrivingTest, ProgressGrowsWithTheWay) {
    auto motion = begin({.distance_mm = 1000, .velocity_mm_s = 200});
    EXPECT_EQ(motion.step(robot_.state, robot_.clock.now()).progress, 0);
    double last = 0;
    robot_.run(motion, 30, [&] {
        const double now = motion.step(robot_.state, robot_.clock.now()).progress;
        EXPECT_GE(now, last);
        last = now;
    });
    EXPECT_GT(last, 0.4);
    EXPECT_LT(last, 0.7);
}

TEST_F(DrivingTest, AReadingBelowTheThresholdStopsAndIsNamed) {
    auto motion = begin({.distance_mm = 3000, .velocity_mm_s = 300});
    robot_.run(motion, 20);
    robot_.state.sonars[3].range_mm = 412;
    const auto end = robot_.run(motion, 1);
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_EQ(end.reason, "sonar 3 at 412 mm is nearer than the threshold 500 mm");
    EXPECT_EQ(end.forward_mm_s, 0);
}

TEST_F(DrivingTest, SonarsThatHaveNotBeenHeardYetAreWaitedForASecond) {
    robot_.state.sonars = {};
    robot_.deaf = true;
    auto motion = begin({.distance_mm = 1000, .velocity_mm_s = 300});
    EXPECT_EQ(robot_.run(motion, 9).outcome, Outcome::Running);
    EXPECT_EQ(robot_.fastest, 0) << "nobody knows what is in the way";
    robot_.deaf = false;
    robot_.hear(5000);
    EXPECT_EQ(robot_.run(motion).outcome, Outcome::Done);

    robot_.state.sonars = {};
    robot_.deaf = true;
    robot_.fastest = 0;
    auto deaf = begin({.distance_mm = 1000, .velocity_mm_s = 300});
    const auto end = robot_.run(deaf, 12);
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_THAT(end.reason, HasSubstr("no sonar in the direction of travel"));
    EXPECT_EQ(robot_.fastest, 0);
}

TEST_F(DrivingTest, AReadingAtTheThresholdIsFarEnough) {
    auto motion = begin({.distance_mm = 3000, .velocity_mm_s = 300, .range_threshold_mm = 412});
    robot_.state.sonars[3].range_mm = 412;
    EXPECT_EQ(robot_.run(motion, 1).outcome, Outcome::Running);
}

TEST_F(DrivingTest, OnlySonarsThatLookAheadCount) {
    for (int i = 0; i < 32; ++i) {
        const double direction = std::abs(*sonarDirection_deg(i));
        for (const double velocity : {200.0, -200.0}) {
            SimulatedRobot robot;
            robot.state.sonars[static_cast<std::size_t>(i)].range_mm = 200;
            Driving motion({.distance_mm = 1000, .velocity_mm_s = velocity}, robot.state, robot.clock.now());
            const bool ahead = velocity > 0 ? direction <= 30 : direction >= 150;
            EXPECT_EQ(robot.run(motion, 1).outcome, ahead ? Outcome::Failed : Outcome::Running)
                << i << " at " << velocity;
        }
    }
}

TEST_F(DrivingTest, ABumperOnTheSideOfTravelStopsAndOneBehindOnlyWhenNewlyPressed) {
    robot_.state.front_bumpers = 0b00110;
    auto forward = begin({.distance_mm = 1000});
    const auto end = robot_.run(forward, 1);
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_EQ(end.reason, "front bumper 2, 3 is pressed");
    auto backward = begin({.distance_mm = 1000, .velocity_mm_s = -200});
    EXPECT_EQ(robot_.run(backward, 5).outcome, Outcome::Running);
    robot_.state.front_bumpers |= 0b10000;
    EXPECT_EQ(robot_.run(backward, 1).outcome, Outcome::Failed);
}

TEST_F(DrivingTest, AStallIsAFailure) {
    auto motion = begin({.distance_mm = 1000});
    robot_.state.left_stall = true;
    EXPECT_THAT(robot_.run(motion, 1).reason, HasSubstr("left motor stalled"));
}

TEST_F(DrivingTest, TheLaserStopsADriveForwardToo) {
    auto scan = std::make_shared<arcos::LaserScan>();
    scan->taken = robot_.clock.now();
    scan->ranges_mm.assign(181, 8000);
    scan->ranges_mm[80] = 400;
    robot_.state.laser = scan;
    auto forward = begin({.distance_mm = 1000});
    EXPECT_THAT(robot_.run(forward, 1).reason,
                HasSubstr("the laser's 400 mm at -10 deg are nearer than the threshold 500 mm"));
    auto backward = begin({.distance_mm = 1000, .velocity_mm_s = -200});
    EXPECT_EQ(robot_.run(backward, 1).outcome, Outcome::Running);
}

TEST_F(DrivingTest, ADazzledLaserDoesNotStandInForSilentSonars) {
    robot_.deaf = true;
    robot_.clock.advance(milliseconds{2000});
    const auto laser = [this](std::uint16_t range_mm) {
        auto scan = std::make_shared<arcos::LaserScan>();
        scan->taken = robot_.clock.now();
        scan->ranges_mm.assign(181, range_mm);
        return scan;
    };
    robot_.state.laser = laser(8000);
    auto seeing = begin({.distance_mm = 1000});
    EXPECT_EQ(robot_.run(seeing, 1).outcome, Outcome::Running);
    auto dazzled = begin({.distance_mm = 1000});
    const auto end =
        robot_.run(dazzled, 12, [&] { robot_.state.laser = laser(arcos::LaserPacket::kNothing_mm); });
    EXPECT_THAT(end.reason, HasSubstr("was heard"));
}

TEST_F(DrivingTest, SilentSonarsAreAFailureUnlessTheyAreNotWanted) {
    robot_.deaf = true;
    auto motion = begin({.distance_mm = 3000});
    EXPECT_THAT(robot_.run(motion).reason, HasSubstr("was heard"));
    auto blind = begin({.distance_mm = 1000, .range_threshold_mm = 0});
    EXPECT_EQ(robot_.run(blind).outcome, Outcome::Done);
}

TEST_F(DrivingTest, ARobotThatDoesNotMoveIsAFailureAfterThreeSeconds) {
    robot_.stuck = true;
    auto motion = begin({.distance_mm = 1000});
    EXPECT_EQ(robot_.run(motion, 30).outcome, Outcome::Running);
    EXPECT_THAT(robot_.run(motion, 2).reason, HasSubstr("does not move"));
}

TEST_F(DrivingTest, APauseIsNoStandstill) {
    auto motion = begin({.distance_mm = 1000});
    robot_.run(motion, 20);
    for (int i = 0; i < 100; ++i) robot_.pass(0, 0);
    motion.resume(robot_.clock.now());
    EXPECT_EQ(robot_.run(motion).outcome, Outcome::Done);
}

TEST_F(DrivingTest, ASpeedLimitHoldsOnTheWayTooAndLiftedItGoesOn) {
    auto motion = begin({.distance_mm = 5000, .velocity_mm_s = -400});
    const auto fastestOf = [&](int packets) {
        robot_.fastest = 0;
        EXPECT_EQ(robot_.run(motion, packets).outcome, Outcome::Running);
        return robot_.fastest;
    };
    EXPECT_EQ(fastestOf(20), 400);
    motion.limitSpeed(100);
    EXPECT_EQ(fastestOf(30), 100);
    motion.limitSpeed(0);
    EXPECT_EQ(fastestOf(10), Driving::kSlowest_mm_s) << "no slower than any velocity";
    motion.limitSpeed(800);
    EXPECT_EQ(fastestOf(20), 400) << "no faster than it was asked to";
    EXPECT_NEAR(motion.travelled_mm() + motion.remaining_mm(), 5000, 1e-9);
    EXPECT_EQ(robot_.run(motion).outcome, Outcome::Done);
    EXPECT_NEAR(motion.travelled_mm(), 5000, 15);
    Driving limited({.distance_mm = 500, .velocity_mm_s = 400, .speed_limit_mm_s = 50}, robot_.state,
                    robot_.clock.now());
    robot_.fastest = 0;
    EXPECT_EQ(robot_.run(limited).outcome, Outcome::Done);
    EXPECT_EQ(robot_.fastest, 50);
}

TEST_F(DrivingTest, ALostRobotIsSaidSo) {
    auto motion = begin({.distance_mm = 1000});
    robot_.state.online = false;
    EXPECT_THAT(robot_.run(motion, 1).reason, HasSubstr("connection to the robot"));
}

TEST_F(DrivingTest, RequestsThatCannotBeDrivenAreRefusedWithTheMend) {
    EXPECT_EQ(Driving::objection({.distance_mm = 1}), "");
    EXPECT_THAT(Driving::objection({.distance_mm = 0}), HasSubstr("above 0"));
    EXPECT_THAT(Driving::objection({.distance_mm = -5}), HasSubstr("sign of Velocity"));
    EXPECT_THAT(Driving::objection({.distance_mm = std::nan("")}), HasSubstr("above 0"));
    EXPECT_THAT(Driving::objection({.distance_mm = 1, .velocity_mm_s = 10}), HasSubstr("20 to 800"));
    EXPECT_THAT(Driving::objection({.distance_mm = 1, .velocity_mm_s = std::nan("")}),
                HasSubstr("20 to 800"));
    EXPECT_THAT(Driving::objection({.distance_mm = 1, .range_threshold_mm = 5000}), HasSubstr("0 to 4999"));
}

TEST(Turning, EndsAtItsAngleInBothDirectionsAndBeyondAFullTurn) {
    for (const double angle : {5.0, 90.0, -90.0, 400.0, -720.0}) {
        for (const double velocity : {5.0, 30.0, 100.0}) {
            SimulatedRobot robot;
            Turning motion({.angle_deg = angle, .velocity_deg_s = velocity}, robot.state, robot.clock.now());
            const auto end = robot.run(motion, 5000);
            EXPECT_EQ(end.outcome, Outcome::Done) << angle << " at " << velocity << ": " << end.reason;
            EXPECT_NEAR(motion.turned_deg(), angle, 2.5) << velocity;
        }
    }
}

TEST(Turning, ASpeedLimitHoldsOnTheWayToo) {
    SimulatedRobot robot;
    Turning motion({.angle_deg = -300, .velocity_deg_s = 60}, robot.state, robot.clock.now());
    const auto fastestOf = [&](int packets) {
        double fastest = 0;
        for (int i = 0; i < packets; ++i) {
            const auto step = motion.step(robot.state, robot.clock.now());
            EXPECT_EQ(step.outcome, Outcome::Running);
            fastest = std::max(fastest, -step.left_deg_s);
            robot.pass(0, step.left_deg_s);
        }
        return fastest;
    };
    EXPECT_EQ(fastestOf(10), 60);
    motion.limitSpeed(10);
    EXPECT_EQ(fastestOf(20), 10);
    motion.limitSpeed(100);
    EXPECT_EQ(fastestOf(5), 60);
    EXPECT_NEAR(motion.turned_deg() + motion.remaining_deg(), -300, 1e-9);
    EXPECT_EQ(robot.run(motion).outcome, Outcome::Done);
    EXPECT_NEAR(motion.turned_deg(), -300, 2.5);
}

TEST(Turning, ATableSensorCancels) {
    SimulatedRobot robot;
    Turning motion({.angle_deg = 90}, robot.state, robot.clock.now());
    EXPECT_EQ(robot.run(motion, 10).outcome, Outcome::Running);
    robot.state.table_right = true;
    const auto end = robot.run(motion, 1);
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_EQ(end.reason, "the right table sensor sees a surface");
    EXPECT_EQ(end.left_deg_s, 0);
}

TEST(Turning, ANewlyPressedBumperAStallAndALossFail) {
    SimulatedRobot robot;
    robot.state.rear_bumpers = 1;
    Turning motion({.angle_deg = 90}, robot.state, robot.clock.now());
    EXPECT_EQ(robot.run(motion, 3).outcome, Outcome::Running);
    robot.state.rear_bumpers = 3;
    EXPECT_THAT(robot.run(motion, 1).reason, HasSubstr("bumper"));
    robot.state.rear_bumpers = 0;
    robot.state.right_stall = true;
    EXPECT_THAT(robot.run(motion, 1).reason, HasSubstr("right motor stalled"));
    robot.state.online = false;
    EXPECT_THAT(robot.run(motion, 1).reason, HasSubstr("connection to the robot"));
}

TEST(Turning, RequestsThatCannotBeTurnedAreRefusedWithTheMend) {
    EXPECT_EQ(Turning::objection({.angle_deg = -90}), "");
    EXPECT_THAT(Turning::objection({.angle_deg = 0}), HasSubstr("not 0"));
    EXPECT_THAT(Turning::objection({.angle_deg = std::nan("")}), HasSubstr("not 0"));
    EXPECT_THAT(Turning::objection({.angle_deg = 1, .velocity_deg_s = -30}), HasSubstr("sign of Angle"));
}

struct GateTest : ::testing::Test {
    int driven = 0;
    int stopped = 0;
    DriveGate gate{
        {.drive = [this](double, double) { return ++driven > 0; }, .stop = [this] { return ++stopped > 0; }}};
};

TEST_F(GateTest, NoVelocityFollowsAStop) {
    ASSERT_TRUE(gate.take([] { return false; }));
    EXPECT_TRUE(gate.drive(100, 0));
    gate.stop();
    EXPECT_FALSE(gate.drive(100, 0));
    EXPECT_EQ(driven, 1);
    EXPECT_FALSE(gate.take([] { return false; }));  // the stopped motion has not given the drive back
    gate.giveBack();
    EXPECT_TRUE(gate.take([] { return false; }));
}

TEST_F(GateTest, AStopBeforeTheFirstVelocityIsNotForgotten) {
    gate.stop();
    EXPECT_FALSE(gate.take([] { return true; }));
    EXPECT_FALSE(gate.drive(100, 0));
    EXPECT_EQ(driven, 0);
}

TEST_F(GateTest, AMotionThatMissedTheLossOfItsRobotGivesNoOrdersToItOnceItIsBack) {
    ASSERT_TRUE(gate.take([] { return false; }));
    EXPECT_TRUE(gate.drive(100, 0));
    gate.lost();
    EXPECT_FALSE(gate.drive(100, 0));
    EXPECT_FALSE(gate.halt());
    EXPECT_EQ(driven, 1);
    gate.giveBack();
    EXPECT_TRUE(gate.take([] { return false; }));
}

TEST_F(GateTest, OneMotionAtATimeAndTheRobotRestsBetweenThem) {
    ASSERT_TRUE(gate.take([] { return false; }));
    EXPECT_FALSE(gate.take([] { return false; }));
    gate.giveBack();
    EXPECT_EQ(stopped, 1);
    EXPECT_FALSE(gate.drive(100, 0));
}

TEST(MapPose, OdometryStartsWhereTheRobotStands) {
    const auto pose = MapPose{1000, 2000, 90}.then({500, 100, 10});
    EXPECT_NEAR(pose.x_mm, 900, 1e-9);
    EXPECT_NEAR(pose.y_mm, 2500, 1e-9);
    EXPECT_EQ(pose.heading_deg, 100);
}

}  // namespace
}  // namespace axon::peoplebot
