// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "robots/peoplebot/grasp_world_test.hpp"
#include "robots/peoplebot/gripper_operation.hpp"

namespace axon::peoplebot {
namespace {

using Direction = GripperOperation::Direction;
using Outcome = MotionStep::Outcome;
using test::GraspWorld;
using ::testing::HasSubstr;

GripperOperation::Step operate(GraspWorld& world, const GripperOperation::Request& request,
                               std::vector<arcos::GripperOrder>* orders = nullptr) {
    GripperOperation operation(request);
    GripperOperation::Step step;
    for (int i = 0; i < 600 && step.outcome == Outcome::Running; ++i) {
        step = operation.step(world.robot, world.clock.now());
        if (orders != nullptr)
            for (const auto& command : step.commands) orders->push_back(command.order);
        world.apply(0, 0, step.commands, {});
        world.pass();
    }
    return step;
}

TEST(GripperOperation, OpensAndClosesAndSaysSo) {
    GraspWorld world;
    EXPECT_EQ(operate(world, {.open = true}).outcome, Outcome::Done);
    EXPECT_TRUE(world.robot.gripper.open);
    EXPECT_EQ(operate(world, {.open = false}).outcome, Outcome::Done);
    EXPECT_TRUE(world.robot.gripper.closed);
    EXPECT_FALSE(GripperOperation::holding(world.robot.gripper)) << "the paddles feel each other only";
}

TEST(GripperOperation, UpMovesThePaddlesFirstDownTheLift) {
    GraspWorld world;
    std::vector<arcos::GripperOrder> orders;
    EXPECT_EQ(operate(world, {Direction::Up, true}, &orders).outcome, Outcome::Done);
    EXPECT_TRUE(world.robot.gripper.lift_up);
    EXPECT_EQ(orders, (std::vector{arcos::GripperOrder::Open, arcos::GripperOrder::LiftUp}));
    orders.clear();
    EXPECT_EQ(operate(world, {Direction::Down, false}, &orders).outcome, Outcome::Done);
    EXPECT_TRUE(world.robot.gripper.lift_down);
    EXPECT_EQ(orders, (std::vector{arcos::GripperOrder::LiftDown, arcos::GripperOrder::Close}));
}

TEST(GripperOperation, WhatIsHeldIsSetDownOnTheTableAndThenLetGo) {
    GraspWorld world;
    world.table_x = 100;
    world.object_x = 170;
    operate(world, {Direction::None, true});
    world.lift = 100;
    world.pass();
    operate(world, {Direction::Up, false});
    ASSERT_TRUE(world.holding);
    ASSERT_TRUE(GripperOperation::holding(world.robot.gripper));
    const auto step = operate(world, {Direction::Down, true});
    EXPECT_EQ(step.outcome, Outcome::Done) << step.reason;
    EXPECT_FALSE(world.holding);
    EXPECT_NEAR(world.lift, 108, 1) << "relieved, so that the paddles do not press on the table";
    EXPECT_TRUE(world.robot.gripper.open);
}

TEST(GripperOperation, APartThatDoesNotMoveFailsAndIsHalted) {
    GraspWorld world;
    world.stuck_paddles = true;
    const auto step = operate(world, {.open = true});
    EXPECT_EQ(step.outcome, Outcome::Failed);
    EXPECT_THAT(step.reason, HasSubstr("the paddles stopped"));
    ASSERT_EQ(step.commands.size(), 1U);
    EXPECT_EQ(step.commands[0].order, arcos::GripperOrder::Halt);
}

TEST(GripperOperation, AMovementWithoutEndFailsAfterTheTimeLimit) {
    GraspWorld world;
    world.robot.gripper.lift_moving = true;
    GripperOperation operation({.direction = Direction::Up});
    operation.step(world.robot, world.clock.now());
    world.clock.advance(GripperOperation::kTimeLimit - std::chrono::milliseconds{1});
    EXPECT_EQ(operation.step(world.robot, world.clock.now()).outcome, Outcome::Running);
    world.clock.advance(std::chrono::milliseconds{1});
    const auto step = operation.step(world.robot, world.clock.now());
    EXPECT_EQ(step.outcome, Outcome::Failed);
    EXPECT_THAT(step.reason, HasSubstr("still moving"));
}

TEST(GripperOperation, WhatCannotBeDoneIsSaidBefore) {
    arcos::RobotState robot;
    robot.gripper.known = robot.gripper.fitted = true;
    EXPECT_THAT(GripperOperation::objection({}, robot), HasSubstr("nothing to do"));
    EXPECT_EQ(GripperOperation::objection({.open = false}, robot), "");
    robot.gripper.fitted = false;
    EXPECT_THAT(GripperOperation::objection({.open = false}, robot), HasSubstr("no gripper"));
    EXPECT_EQ(GripperOperation::parseDirection("Up"), Direction::Up);
    EXPECT_EQ(GripperOperation::parseDirection("NONE"), Direction::None);
    EXPECT_EQ(GripperOperation::parseDirection("true"), Direction::Down) << "figure A.1 of the thesis";
    EXPECT_EQ(GripperOperation::parseDirection("false"), Direction::Up);
    EXPECT_FALSE(GripperOperation::parseDirection("sideways"));
    robot.online = false;
    EXPECT_EQ(GripperOperation({.open = true}).step(robot, TimePoint{}).outcome, Outcome::Failed);
}

}  // namespace
}  // namespace axon::peoplebot
