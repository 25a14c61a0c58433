// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/tracking.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <random>
#include <set>

#include "robots/peoplebot/grasp_world_test.hpp"

namespace axon::peoplebot {
namespace {

using Outcome = MotionStep::Outcome;
using test::GraspWorld;
using ::testing::HasSubstr;

class TrackingTest : public ::testing::Test {
  protected:
    Tracking::Step track(const Tracking::Request& request = {},
                         const std::function<void(Tracking::Phase)>& meanwhile = {}) {
        Tracking tracking(request, world.geometry, world.clock.now());
        Tracking::Step step;
        for (int i = 0; i < 4000 && step.outcome == Outcome::Running; ++i) {
            step = tracking.step(world.robot, world.pictures > 0 ? &world.view : nullptr, world.clock.now());
            phases.insert(tracking.phase());
            if (meanwhile) meanwhile(tracking.phase());
            world.apply(step.forward_mm_s, step.left_deg_s, step.gripper, step.look);
            world.pass();
        }
        EXPECT_EQ(step.forward_mm_s, 0);
        EXPECT_EQ(step.left_deg_s, 0);
        return step;
    }
    void expectGaveUp(const Tracking::Step& step, const std::string& reason) {
        EXPECT_EQ(step.outcome, Outcome::Failed);
        EXPECT_THAT(step.reason, HasSubstr(reason));
        EXPECT_FALSE(world.robot.moving);
        EXPECT_TRUE(world.robot.gripper.open);
    }

    GraspWorld world;
    std::set<Tracking::Phase> phases;
};

TEST_F(TrackingTest, GrabsLiftsAndBacksOff) {
    const auto step = track({.back_off_mm = 400});
    EXPECT_EQ(step.outcome, Outcome::Done) << step.reason;
    EXPECT_TRUE(world.holding);
    EXPECT_TRUE(world.robot.gripper.lift_up);
    EXPECT_NEAR(world.x, 1260 - world.geometry.paddles_mm - 400, 40);
}

TEST_F(TrackingTest, FindsItWhereverTheRobotStandsAndHoweverItIsTurned) {
    std::mt19937 random(1);
    std::uniform_real_distribution<double> any(0, 1);
    for (int i = 0; i < 60; ++i) {
        world = GraspWorld();
        world.x = -600 * any(random);
        world.y = -300 + 600 * any(random);
        world.heading_deg = -180 + 360 * any(random);
        world.object_x = 1230 + 60 * any(random);
        world.object_y = -150 + 300 * any(random);
        world.table_turn_deg = -8 + 16 * any(random);
        const auto step = track();
        EXPECT_EQ(step.outcome, Outcome::Done)
            << i << ": " << step.reason << " from " << world.x << ", " << world.y;
        EXPECT_TRUE(world.holding) << i;
    }
}

TEST_F(TrackingTest, TooNearForTurningItBacksAwayFirst) {
    world.x = 850;
    world.object_y = 220;
    world.object_x = 1260;
    const auto step = track();
    EXPECT_EQ(step.outcome, Outcome::Done) << step.reason;
    EXPECT_TRUE(phases.contains(Tracking::Phase::Clearing));
}

TEST_F(TrackingTest, NothingOfTheColourIsNotFoundAfterLookingAllAround) {
    world.visible = false;
    const auto step = track();
    expectGaveUp(step, "not found");
    EXPECT_NEAR(std::abs(world.heading_deg), 180, 6);
    EXPECT_LT(world.travelled, 1);
}

TEST_F(TrackingTest, AnObjectThatIsTakenAwayIsLost) {
    const auto step = track({}, [&](Tracking::Phase phase) {
        if (phase == Tracking::Phase::Approaching && world.x > 300) world.visible = false;
    });
    expectGaveUp(step, "not found");
    EXPECT_LT(world.x, 800);
}

TEST_F(TrackingTest, AnObjectThatVanishesForAMomentIsFollowedOn) {
    int hidden = 0;
    const auto step = track({}, [&](Tracking::Phase phase) {
        if (phase == Tracking::Phase::Approaching) world.visible = ++hidden < 5 || hidden > 15;
    });
    EXPECT_EQ(step.outcome, Outcome::Done) << step.reason;
}

TEST_F(TrackingTest, AnObjectTooFarFromTheEdgeIsOutOfReach) {
    world.object_x = 1560;
    expectGaveUp(track(), "out of reach");
}

TEST_F(TrackingTest, AnEmptyGripIsTriedAgainAndThenSaid) {
    int tries = 0;
    bool before = false;
    const auto step = track({}, [&](Tracking::Phase phase) {
        const bool closing = phase == Tracking::Phase::Closing;
        if (closing && !before) ++tries;
        before = closing;
        // Somebody's hand takes it away each time and puts it back.
        world.object_y = closing ? 5000 : 0;
    });
    expectGaveUp(step, "the grip is empty");
    EXPECT_EQ(tries, 3);
}

TEST_F(TrackingTest, WhatSlipsOutIsSaid) {
    world.slippery = true;
    expectGaveUp(track(), "slipped");
}

TEST_F(TrackingTest, ABumperAStallAndANearSonarEndTheApproach) {
    const auto approach = [&](const std::function<void()>& happens) {
        world = GraspWorld();
        return track({}, [&](Tracking::Phase phase) {
            if (phase == Tracking::Phase::Approaching && world.x > 300) happens();
        });
    };
    expectGaveUp(approach([&] { world.robot.front_bumpers = 4; }), "front bumper");
    expectGaveUp(approach([&] { world.robot.left_stall = true; }), "stalled");
    expectGaveUp(approach([&] { world.wall_ahead = 140; }), "nearer than the threshold 150 mm");
    EXPECT_LT(world.x, 350);
}

TEST_F(TrackingTest, ABlindCameraEndsIt) {
    world.camera_works = false;
    expectGaveUp(track(), "the camera sends no pictures");
}

TEST_F(TrackingTest, PaddlesThatDoNotOpenEndIt) {
    world.stuck_paddles = true;
    const auto step = track();
    EXPECT_EQ(step.outcome, Outcome::Failed);
    EXPECT_THAT(step.reason, HasSubstr("do not open"));
    EXPECT_LT(world.travelled, 1);
}

TEST_F(TrackingTest, HeldBackItKeepsWhatItHolds) {
    const auto step = track({}, [&](Tracking::Phase phase) {
        if (phase == Tracking::Phase::BackingOff) world.robot.rear_bumpers = 1;
    });
    EXPECT_EQ(step.outcome, Outcome::Failed);
    EXPECT_THAT(step.reason, HasSubstr("holds the object, but cannot back off"));
    EXPECT_TRUE(world.holding);
}

TEST_F(TrackingTest, WhatIsSetOnTheWayHoldsFromThenOn) {
    Tracking tracking({.back_off_mm = 400}, world.geometry, world.clock.now());
    Tracking::Step step;
    double fastest = 0;
    for (int i = 0; i < 4000 && step.outcome == Outcome::Running; ++i) {
        tracking.reconfigure(80, 150, 200);
        step = tracking.step(world.robot, world.pictures > 0 ? &world.view : nullptr, world.clock.now());
        if (tracking.phase() == Tracking::Phase::Approaching) fastest = std::max(fastest, step.forward_mm_s);
        world.apply(step.forward_mm_s, step.left_deg_s, step.gripper, step.look);
        world.pass();
    }
    EXPECT_EQ(step.outcome, Outcome::Done) << step.reason;
    EXPECT_EQ(fastest, 80);
    EXPECT_NEAR(world.x, 1260 - world.geometry.paddles_mm - 200, 40);

    world = GraspWorld();
    Tracking guarded({}, world.geometry, world.clock.now());
    world.wall_ahead = 900;
    for (int i = 0; i < 4000; ++i) {
        if (guarded.phase() == Tracking::Phase::Approaching) guarded.reconfigure(200, 1000, 500);
        step = guarded.step(world.robot, world.pictures > 0 ? &world.view : nullptr, world.clock.now());
        if (step.outcome != Outcome::Running) break;
        world.apply(step.forward_mm_s, step.left_deg_s, step.gripper, step.look);
        world.pass();
    }
    EXPECT_THAT(step.reason, HasSubstr("nearer than the threshold 1000 mm"));
}

TEST_F(TrackingTest, NothingIsDrivenBeforeTheGripperIsReady) {
    track({}, [&](Tracking::Phase phase) {
        if (phase != Tracking::Phase::Approaching || world.forward == 0) return;
        EXPECT_TRUE(world.robot.gripper.open);
        EXPECT_NEAR(world.geometry.lift_top_mm - world.geometry.lift_travel_mm + world.lift, 700, 3);
    });
}

TEST_F(TrackingTest, WhatCannotBeDoneIsSaidBefore) {
    EXPECT_THAT(Tracking::objection({.table_height_mm = 900}, {}, world.robot), HasSubstr("reaches from"));
    EXPECT_THAT(Tracking::objection({.back_off_mm = -1}, {}, world.robot), HasSubstr("Back Off"));
    world.robot.gripper.fitted = false;
    EXPECT_THAT(Tracking::objection({}, {}, world.robot), HasSubstr("no gripper"));
}

class TableApproachTest : public TrackingTest {
  protected:
    MotionStep approach(const TableApproach::Request& request = {}) {
        world.object_x.reset();
        TableApproach motion(request, world.robot, world.clock.now());
        MotionStep step;
        for (int i = 0; i < 2000 && step.outcome == Outcome::Running; ++i) {
            step = motion.step(world.robot, world.clock.now());
            world.apply(step.forward_mm_s, step.left_deg_s, {}, {});
            world.pass();
        }
        return step;
    }
};

TEST_F(TableApproachTest, SquaresUpToAnEdgeAtAnyAngle) {
    for (const double angle : {-20.0, -6.0, 0.0, 9.0, 20.0}) {
        world = GraspWorld();
        world.table_turn_deg = angle;
        const auto step = approach({.reach_mm = 230});
        EXPECT_EQ(step.outcome, Outcome::Done) << step.reason;
        EXPECT_NEAR(world.heading_deg, angle, 5) << angle;
        const auto [gx, gy] = world.toWorld(world.geometry.paddles_mm, 0);
        EXPECT_NEAR(world.edgeDistance(gx, gy), 67, 30) << angle << ": what is held is above the table";
    }
}

TEST_F(TableApproachTest, WhatIsSetOnTheWayHoldsFromThenOn) {
    world.object_x.reset();
    TableApproach motion({.velocity_mm_s = 100}, world.robot, world.clock.now());
    EXPECT_EQ(motion.step(world.robot, world.clock.now()).forward_mm_s, 100);
    motion.reconfigure(1000, 150);
    EXPECT_EQ(motion.step(world.robot, world.clock.now()).forward_mm_s, TableApproach::kFastest_mm_s);
    world.wall_ahead = 600;
    world.pass();
    EXPECT_EQ(motion.step(world.robot, world.clock.now()).outcome, Outcome::Running);
    motion.reconfigure(100, 700);
    EXPECT_THAT(motion.step(world.robot, world.clock.now()).reason,
                HasSubstr("nearer than the threshold 700 mm"));
}

TEST_F(TableApproachTest, ALongTurnIsNoStandstillToEitherSide) {
    for (const double angle : {-30.0, 30.0}) {
        world = GraspWorld();
        world.table_turn_deg = angle;
        const auto step = approach({.reach_mm = 230});
        EXPECT_EQ(step.outcome, Outcome::Done) << angle << ": " << step.reason;
        EXPECT_NEAR(world.heading_deg, angle, 10) << angle;
    }
}

TEST_F(TableApproachTest, WithoutATableOrWithSomethingInTheWayItFails) {
    world.table = false;
    EXPECT_THAT(approach({.distance_mm = 500}).reason, HasSubstr("no table within 500 mm"));
    EXPECT_NEAR(world.x, 500, 20);
    world = GraspWorld();
    world.wall_ahead = 100;
    EXPECT_THAT(approach().reason, HasSubstr("threshold"));
    world = GraspWorld();
    world.robot.front_bumpers = 1;
    EXPECT_THAT(approach().reason, HasSubstr("bumper"));
    EXPECT_THAT(TableApproach::objection({.reach_mm = 900}), HasSubstr("Reach"));
}

}  // namespace
}  // namespace axon::peoplebot
