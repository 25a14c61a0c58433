// SPDX-License-Identifier: GPL-2.0-or-later
// The motions on the virtual robot: real slip, real sensors, the real protocol, in the laboratory's own time.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "robots/peoplebot/virtual_robot_test.hpp"

namespace axon::peoplebot {
namespace {

using Outcome = MotionStep::Outcome;
using std::chrono::milliseconds;
using ::testing::HasSubstr;

TEST_F(VirtualRobotTest, DrivesTwoMetresInTheDefaultWorld) {
    auto world = lab::defaultWorld();
    world.robots = {lab::parseRobot("", 0)};
    start(world);
    Driving motion({.distance_mm = 2000, .velocity_mm_s = 400}, session_.robot(), lab_->now());
    const auto end = perform(motion);
    EXPECT_EQ(end.outcome, Outcome::Done) << end.reason;
    EXPECT_NEAR(lab_->truth(0).x_m, 3.5, 0.06);
}

/// Of a laboratory that is gone nothing may arrive any more, or its times, which are later, hold up the next
/// one's answers.
TEST_F(VirtualRobotTest, DrivesInASecondLaboratoryToo) {
    auto world = lab::defaultWorld();
    world.robots = {lab::parseRobot("", 0)};
    start(world);
    run(60);
    while (inbox_.empty()) tick();
    start(world);
    Driving motion({.distance_mm = 500, .velocity_mm_s = 400}, session_.robot(), lab_->now());
    const auto end = perform(motion);
    EXPECT_EQ(end.outcome, Outcome::Done) << end.reason;
}

TEST_F(VirtualRobotTest, StopsInFrontOfAWallWithoutTouchingIt) {
    lab::WorldDescription world;
    world.robots = {{.x = 5, .y = 3}};
    start(world);
    Driving motion({.distance_mm = 5000, .velocity_mm_s = 300}, session_.robot(), lab_->now());
    const auto end = perform(motion);
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_THAT(end.reason, HasSubstr("nearer than the threshold 500 mm"));
    EXPECT_EQ(session_.robot().front_bumpers, 0U);
    EXPECT_LT(lab_->truth(0).x_m, 8 - 0.212 - 0.2);
    EXPECT_GT(lab_->truth(0).x_m, 6.9);
}

TEST_F(VirtualRobotTest, WithoutAThresholdTheBumperEndsTheDrive) {
    lab::WorldDescription world;
    world.robots = {{.x = 7, .y = 3}};
    start(world);
    Driving motion({.distance_mm = 5000, .velocity_mm_s = 200, .range_threshold_mm = 0}, session_.robot(),
                   lab_->now());
    const auto end = perform(motion);
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_THAT(end.reason, HasSubstr("front bumper"));
    run(0.6);
    Driving back({.distance_mm = 500, .velocity_mm_s = -200}, session_.robot(), lab_->now());
    EXPECT_EQ(perform(back).outcome, Outcome::Done);
}

TEST_F(VirtualRobotTest, TurnsByItsWheels) {
    lab::WorldDescription world;
    world.robots = {{.x = 3, .y = 3}};
    start(world);
    Turning motion({.angle_deg = -90, .velocity_deg_s = 40}, session_.robot(), lab_->now());
    const auto end = perform(motion);
    EXPECT_EQ(end.outcome, Outcome::Done) << end.reason;
    EXPECT_NEAR(motion.turned_deg(), -90, 3);
    EXPECT_NEAR(lab_->truth(0).theta_deg, -90, 10);
}

class LateAnswersTest : public VirtualRobotTest, public ::testing::WithParamInterface<int> {};
INSTANTIATE_TEST_SUITE_P(Milliseconds, LateAnswersTest, ::testing::Values(0, 60, 150));

TEST_P(LateAnswersTest, DoNotMakeATurnOrADriveOvershoot) {
    lab::WorldDescription world;
    world.robots = {{.x = 3, .y = 3}};
    start(world);
    late_ = std::chrono::milliseconds{GetParam()};
    run(1);
    const auto odometry = [&] {
        run(1);
        return session_.robot();
    };
    for (const double angle : {90.0, -90.0, 30.0}) {
        const double begin = odometry().heading_deg;
        Turning turn({.angle_deg = angle, .velocity_deg_s = 60}, session_.robot(), lab_->now());
        ASSERT_EQ(perform(turn).outcome, Outcome::Done);
        EXPECT_NEAR(odometry().heading_deg - begin, angle, 1.0) << angle << " deg";
    }
    // Turned by 30 degrees in the end.
    const auto from = odometry();
    Driving drive({.distance_mm = 1000, .velocity_mm_s = 500}, from, lab_->now());
    ASSERT_EQ(perform(drive).outcome, Outcome::Done);
    const auto to = odometry();
    EXPECT_NEAR(std::hypot(to.x_mm - from.x_mm, to.y_mm - from.y_mm), 1000, 10);
}

TEST_F(VirtualRobotTest, ATableOverheadCancelsATurn) {
    lab::WorldDescription world;
    world.robots = {{.x = 3, .y = 3}};
    world.tables = {{.x = 3, .y = 3.75, .dx = 1.2, .dy = 0.8}};
    start(world);
    Turning motion({.angle_deg = 180, .velocity_deg_s = 20}, session_.robot(), lab_->now());
    const auto end = perform(motion);
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_THAT(end.reason, HasSubstr("table sensor"));
    EXPECT_LT(motion.turned_deg(), 90);
}

/// "Within one sensor cycle": the robot tells of itself every 100 ms; a bumper and a table sensor are in
/// every packet, a sonar has its turn once in a round of 320 ms (eight of an array, 40 ms each).
class StallTest : public VirtualRobotTest {
  protected:
    static constexpr auto kPacket = std::chrono::milliseconds{100} + 2 * lab::Physics::kPeriod;
    static constexpr auto kRound = std::chrono::milliseconds{8 * 40};

    template <class Motion>
    void expectFailure(Motion motion, std::string_view why, Duration within) {
        const auto end = perform(motion);
        EXPECT_EQ(end.outcome, Outcome::Failed);
        EXPECT_THAT(end.reason, HasSubstr(why));
        ASSERT_TRUE(failed_at_);
        ASSERT_TRUE(seen_at_) << "it ended before it had to";
        EXPECT_LE(*failed_at_ - *seen_at_, within) << toMillis(*failed_at_ - *seen_at_);
    }
    static double toMillis(Duration d) { return std::chrono::duration<double, std::milli>(d).count(); }
    Driving drive(double velocity_mm_s, double threshold_mm) {
        return {{.distance_mm = 5000, .velocity_mm_s = velocity_mm_s, .range_threshold_mm = threshold_mm},
                session_.robot(),
                lab_->now()};
    }
};

class BumperTest : public StallTest, public ::testing::WithParamInterface<double> {};
INSTANTIATE_TEST_SUITE_P(Velocities, BumperTest, ::testing::Values(300, -300, 700));

TEST_P(BumperTest, OfEitherSideEndsADriveWithinOneSensorCycle) {
    lab::WorldDescription world;
    world.robots = {{.x = GetParam() < 0 ? 1.2 : 6.8, .y = 3}};
    start(world);
    must_end_ = [](const lab::Truth& truth) { return !truth.touched.empty(); };
    expectFailure(drive(GetParam(), 0), "bumper", kPacket);
}

TEST_F(StallTest, ARangeBelowTheThresholdEndsADriveWithinOneSensorCycle) {
    lab::WorldDescription world;
    world.robots = {{.x = 4, .y = 3}};
    start(world);
    const auto& sonar = body::kSonars[3];
    // Sonar 3 hears what is nearest in its cone; a little sooner than straight ahead.
    must_end_ = [&](const lab::Truth& truth) { return (8 - truth.x_m) * 1000 - sonar.x_mm < 620; };
    expectFailure(drive(500, 600), "nearer than the threshold 600 mm", kPacket + kRound);
}

TEST_F(StallTest, ATableSensorEndsATurnWithinOneSensorCycle) {
    lab::WorldDescription world;
    world.robots = {{.x = 3, .y = 3}};
    world.tables = {{.x = 3, .y = 3.75, .dx = 1.2, .dy = 0.8}};
    start(world);
    must_end_ = [&](const lab::Truth& truth) {  // the left sensor is below the table's edge
        const double a = truth.theta_deg * std::numbers::pi / 180;
        return 3000 + std::sin(a) * body::kTableSensorX_mm + std::cos(a) * body::kTableSensorY_mm > 3350;
    };
    expectFailure(Turning({.angle_deg = 180, .velocity_deg_s = 40}, session_.robot(), lab_->now()),
                  "table sensor", kPacket);
}

/// A program on a serial line is killed while its robot drives at 400 mm/s: nobody tells the robot.
class KilledProgramTest : public VirtualRobotTest {
  protected:
    void driveAndBeKilled() {
        lab::WorldDescription world;
        world.robots = {{.x = 2, .y = 3}};
        start(world);
        order(Command::Vel, 400);
        run(2);
        ASSERT_NEAR(lab_->truth(0).speed_m_s, 0.4, 0.02);
        order(Command::Pulse, 0);  // the last that the robot hears
        killed_at_m_ = lab_->truth(0).x_m;
    }
    void passWithoutProgram(milliseconds time) {
        for (const auto end = lab_->age() + time; lab_->age() < end;) lab_->step();
        inbox_.clear();  // whoever opens the line forgets what came before
    }
    double travelled_mm() const { return (lab_->truth(0).x_m - killed_at_m_) * 1000; }

    double killed_at_m_ = 0;
};

TEST_F(KilledProgramTest, TheRobotsOwnWatchdogStopsItAlmostAMetreLater) {
    driveAndBeKilled();
    passWithoutProgram(milliseconds{1900});
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0.4, 0.02);
    passWithoutProgram(milliseconds{2000});
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0, 0.01);
    // Two seconds, and the braking: 0.4 m/s at 0.6 m/s2.
    EXPECT_NEAR(travelled_mm(), 933, 25);
}

TEST_F(KilledProgramTest, AProgramThatIsThereAgainStopsItBeforeItShakesHands) {
    driveAndBeKilled();
    passWithoutProgram(milliseconds{300});
    session_.begin(lab_->now(), {.baud = 38400, .asked = 38400});
    run(1.5);
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0, 0.01);
    // What it drove before anybody was there again, and the braking.
    EXPECT_LT(travelled_mm(), 120 + 133 + 20);
    EXPECT_EQ(session_.state(), arcos::ClientSession::State::Online);
}

TEST_F(KilledProgramTest, AProgramThatIsNotHeardDoesNotKeepItDriving) {
    driveAndBeKilled();
    // The wire from the robot is broken, the one to it is not. SYNC0 is PULSE to a robot whose session is
    // open.
    session_.begin(lab_->now(), {.baud = 38400, .asked = 38400});
    for (const auto end = lab_->age() + milliseconds{3000}; lab_->age() < end;) {
        inbox_.clear();
        tick();
    }
    EXPECT_NEAR(lab_->truth(0).speed_m_s, 0, 0.01);
    EXPECT_LT(travelled_mm(), 150);
}

}  // namespace
}  // namespace axon::peoplebot
