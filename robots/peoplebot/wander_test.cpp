// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/wander.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "robots/arcos/laser.hpp"
#include "robots/peoplebot/body.hpp"

namespace axon::peoplebot {
namespace {

using Outcome = MotionStep::Outcome;
using std::chrono::milliseconds;
using ::testing::HasSubstr;

class WanderTest : public ::testing::Test {
  protected:
    WanderTest() {
        robot_.online = true;
        see(5000, 5000, 5000, 5000);
    }
    /// Ranges of the sonars to the left, ahead, to the right and behind.
    void see(int left, int front, int right, int rear) {
        left_ = left, front_ = front, right_ = right, rear_ = rear;
    }
    MotionStep next(Wander& wander) {
        now_ += milliseconds{100};
        robot_.taken = now_;
        ++robot_.sequence;
        for (int i = 0; i < 24; ++i) {
            const double direction = *sonarDirection_deg(i);
            const int range = std::abs(direction) <= 30    ? front_
                              : std::abs(direction) >= 130 ? rear_
                              : direction > 0              ? left_
                                                           : right_;
            robot_.sonars[static_cast<std::size_t>(i)] = {range, now_};
        }
        return wander.step(robot_, now_);
    }
    Wander wander(Wander::Request request = {}) { return {request, rules_, robot_, now_}; }

    std::shared_ptr<const fuzzy::Engine> rules_ = loadWanderRules("robots/peoplebot/wander.rules");
    TimePoint now_{std::chrono::seconds{100}};
    arcos::RobotState robot_;
    int left_ = 0, front_ = 0, right_ = 0, rear_ = 0;
};

TEST_F(WanderTest, DrivesOnWhereThereIsRoom) {
    auto motion = wander();
    const auto step = next(motion);
    EXPECT_EQ(step.outcome, Outcome::Running);
    EXPECT_NEAR(step.forward_mm_s, 300, 1);
    EXPECT_LT(std::abs(step.left_deg_s), 9);
}

TEST_F(WanderTest, AnotherVelocityHoldsFromThenOn) {
    auto motion = wander();
    EXPECT_NEAR(next(motion).forward_mm_s, 300, 1);
    motion.setVelocity(100);
    EXPECT_NEAR(next(motion).forward_mm_s, 100, 1);
    motion.setVelocity(5000);
    EXPECT_NEAR(next(motion).forward_mm_s, Wander::kFastest_mm_s, 1);
}

TEST_F(WanderTest, TurnsToTheFreerSideOnTheSpotWhenSomethingIsClose) {
    see(900, 250, 3000, 5000);
    auto motion = wander();
    const auto step = next(motion);
    EXPECT_LT(step.forward_mm_s, 20);
    EXPECT_LT(step.left_deg_s, -40);
}

TEST_F(WanderTest, BetweenEqualSidesItChoosesOneAndKeepsToIt) {
    see(600, 250, 600, 5000);
    auto motion = wander();
    const double first = next(motion).left_deg_s;
    EXPECT_GT(std::abs(first), 40);
    // Turning changes which side is nearer; it must not turn back.
    for (const auto& [left, right] : {std::pair{500, 700}, {700, 500}, {450, 900}, {900, 450}}) {
        see(left, 300, right, 5000);
        EXPECT_GT(next(motion).left_deg_s * first, 0);
    }
}

TEST_F(WanderTest, NeverFasterTowardsSomethingThanItCanStop) {
    for (int front = 100; front < 3000; front += 50) {
        see(5000, front, 5000, 5000);
        auto motion = wander({.velocity_mm_s = 500});
        const double speed = next(motion).forward_mm_s;
        const double way = speed * 0.35 + speed * speed / (2 * 600);
        EXPECT_LE(way, std::max(0, front - 50)) << front;
    }
}

TEST_F(WanderTest, ATableOverheadHaltsItBacksItOffAndTurnsItAway) {
    auto motion = wander();
    next(motion);
    robot_.table_left = true;
    EXPECT_TRUE(next(motion).halt);
    bool backed = false;
    double turned = 0;
    for (int i = 0; i < 100; ++i) {
        const auto step = next(motion);
        backed = backed || step.forward_mm_s < -50;
        if (backed) robot_.table_left = false;
        robot_.heading_deg += step.left_deg_s / 10;
        turned = std::max(turned, std::abs(robot_.heading_deg));
        if (turned > 60 && step.forward_mm_s > 100) break;
    }
    EXPECT_TRUE(backed);
    EXPECT_GT(turned, 60);
    EXPECT_EQ(motion.recoveries(), 1);
}

TEST_F(WanderTest, ARearBumperSendsItForward) {
    auto motion = wander();
    next(motion);
    robot_.rear_bumpers = 1;
    double most = 0;
    for (int i = 0; i < 12; ++i) most = std::max(most, next(motion).forward_mm_s);
    EXPECT_GT(most, 50);
}

TEST_F(WanderTest, InACornerItTurnsAwayAfterAWhileAndGivesUpWhenNothingHelps) {
    see(300, 300, 300, 200);
    auto motion = wander();
    MotionStep step;
    for (int i = 0; i < 3000 && step.outcome == Outcome::Running; ++i) {
        step = next(motion);
        robot_.heading_deg += step.left_deg_s / 10;
    }
    EXPECT_EQ(step.outcome, Outcome::Failed);
    EXPECT_THAT(step.reason, HasSubstr("cannot get free"));
    EXPECT_EQ(motion.recoveries(), Wander::kTries + 1);
}

TEST_F(WanderTest, EndsWhenItsTimeIsUp) {
    auto motion = wander({.duration_s = 2});
    MotionStep step;
    int steps = 0;
    for (; steps < 100 && step.outcome == Outcome::Running; ++steps) {
        step = next(motion);
        robot_.moving = step.forward_mm_s > 0;
    }
    EXPECT_EQ(step.outcome, Outcome::Done);
    EXPECT_NEAR(steps, 21, 3);
}

TEST_F(WanderTest, WithoutRangesOrRobotItFailsWithTheReason) {
    auto motion = wander();
    next(motion);
    for (int i = 0; i < 10; ++i) {
        now_ += milliseconds{100};
        robot_.taken = now_;
        motion.step(robot_, now_);
    }
    now_ += milliseconds{1500};
    robot_.taken = now_;
    EXPECT_THAT(motion.step(robot_, now_).reason, HasSubstr("neither sonars nor laser"));
    auto other = wander();
    robot_.online = false;
    EXPECT_EQ(other.step(robot_, now_).outcome, Outcome::Failed);
}

TEST_F(WanderTest, ObjectionsSayWhatIsPossible) {
    EXPECT_THAT(Wander::objection({.velocity_mm_s = 900}), HasSubstr("give 50 to 500 mm/s"));
    EXPECT_THAT(Wander::objection({.duration_s = -1}), HasSubstr("0 to wander until it is stopped"));
    EXPECT_EQ(Wander::objection({}), "");
}

TEST(Surroundings, WhatWasHeardBeforeATurnStaysWhereItWas) {
    Surroundings surroundings;
    arcos::RobotState robot;
    robot.online = true;
    robot.taken = TimePoint{std::chrono::seconds{10}};
    robot.sonars[0] = {400, robot.taken};  // to the left
    surroundings.update(robot);
    EXPECT_NEAR(surroundings.clearance().left, 400 + 136 - body::kRadius_mm, 60);
    EXPECT_EQ(surroundings.clearance().front, Clearance::kNothing_mm);
    robot.taken += milliseconds{300};
    robot.heading_deg = 90;
    surroundings.update(robot);
    EXPECT_LT(surroundings.clearance().front, 400);
    robot.taken += std::chrono::seconds{2};
    surroundings.update(robot);
    EXPECT_EQ(surroundings.clearance().front, Clearance::kNothing_mm) << "and is forgotten after a while";
}

/// A robot whose laser sees one thing, 5 degrees wide, in this direction and at this range from the laser.
arcos::RobotState seesByLaser(double direction_deg, double range_mm) {
    arcos::RobotState robot;
    robot.online = true;
    robot.taken = TimePoint{std::chrono::seconds{10}};
    arcos::LaserScan scan;
    scan.taken = robot.taken;
    scan.ranges_mm.assign(181, arcos::LaserPacket::kNothing_mm);
    for (int i = -2; i <= 2; ++i)
        scan.ranges_mm.at(static_cast<std::size_t>(direction_deg + 90 + i)) =
            static_cast<std::uint16_t>(range_mm);
    robot.laser = std::make_shared<const arcos::LaserScan>(scan);
    return robot;
}

TEST(Surroundings, ADazzledLaserIsNotHeard) {
    Surroundings surroundings;
    auto robot = seesByLaser(0, 30000);
    surroundings.update(robot);
    EXPECT_TRUE(surroundings.clearance().heard) << "far away is something";
    arcos::LaserScan dazzled = *robot.laser;
    dazzled.ranges_mm.assign(181, arcos::LaserPacket::kNothing_mm);
    robot.laser = std::make_shared<const arcos::LaserScan>(dazzled);
    surroundings.update(robot);
    EXPECT_FALSE(surroundings.clearance().heard);
    robot.sonars[19] = {5000, robot.taken};
    surroundings.update(robot);
    EXPECT_TRUE(surroundings.clearance().heard) << "by its sonars";
}

TEST(Surroundings, AnEchoOfWhatTheLaserSeesIsWhereTheLaserSeesIt) {
    // A door's left jamb as it is met at an angle: the arc of the left sonars reaches into the lane, the jamb
    // does not.
    constexpr double kJamb_deg = 52;
    auto robot = seesByLaser(kJamb_deg, 400);
    const double x = body::kLaserX_mm + 400 * std::cos(kJamb_deg * std::numbers::pi / 180);
    const double y = 400 * std::sin(kJamb_deg * std::numbers::pi / 180);
    const auto& pose = body::kSonars[17];
    const auto range = static_cast<int>(std::hypot(x - pose.x_mm, y - pose.y_mm));
    Surroundings without(Surroundings::Echoes::WhereTheLaserSees);
    without.update(robot);
    robot.sonars[17] = {range, robot.taken};
    Surroundings with(Surroundings::Echoes::WhereTheLaserSees);
    with.update(robot);
    EXPECT_EQ(with.clearance().front, Clearance::kNothing_mm);
    EXPECT_NEAR(with.clearance().left, without.clearance().left, 0.1);
    EXPECT_NEAR(with.roomToTurn(-90), without.roomToTurn(-90), 0.1);
    const double left = with.clearance().left;
    robot.laser.reset();
    robot.taken += milliseconds{300};
    robot.heading_deg = -60;
    with.update(robot);
    EXPECT_NEAR(with.clearance().left, left, 30) << "it stays there when the robot has turned away from it";
}

TEST(Surroundings, AnEchoOfSomethingElseStandsForItsWholeArc) {
    auto robot = seesByLaser(52, 400);
    robot.sonars[17] = {200, robot.taken};  // nearer than what the laser sees: above or below its plane
    robot.sonars[19] = {380, robot.taken};  // ahead, where the laser sees nothing
    Surroundings surroundings(Surroundings::Echoes::WhereTheLaserSees);
    surroundings.update(robot);
    EXPECT_LT(surroundings.clearance().left, 150);
    EXPECT_LT(surroundings.clearance().front, 300);
    robot.laser.reset();
    robot.sonars[17] = {318, robot.taken += milliseconds{300}};
    surroundings.update(robot);
    EXPECT_LT(surroundings.clearance().left, 250) << "without a laser there is only the arc";
}

TEST(Surroundings, ATurnNeedsRoomWhereTheRearSweepsAndWhereItEnds) {
    Surroundings surroundings;
    arcos::RobotState robot;
    robot.online = true;
    robot.taken = TimePoint{std::chrono::seconds{10}};
    robot.sonars[7] = {149, robot.taken};  // to the right of the axis, nearer than the rear is long
    surroundings.update(robot);
    EXPECT_GT(surroundings.roomToTurn(20), 0) << "the rear does not get there";
    EXPECT_LT(surroundings.roomToTurn(90), 0) << "the rear ends there";
    EXPECT_LT(surroundings.roomToTurn(-270), 0) << "whichever way round";
    EXPECT_LT(surroundings.roomToTurn(150), 0) << "the rear passes there";
    EXPECT_GT(surroundings.roomToTurn(-90), 0) << "the rear sweeps the other side";
    robot.sonars[7].range_mm = 300;
    robot.sonars[7].heard = robot.taken += milliseconds{300};
    surroundings.update(robot);
    EXPECT_GT(surroundings.roomToTurn(90), 40);
    EXPECT_LT(surroundings.roomToTurn(90), 200);
}

}  // namespace
}  // namespace axon::peoplebot
