// SPDX-License-Identifier: GPL-2.0-or-later
// The Cyton as the laboratory sees it: through Device and DeviceKind alone.
#include "lab/device.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

#include "lab/laboratory.hpp"

namespace axon::lab {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr std::size_t kGripper = 7;
constexpr double kHomeClaw_mm = 12;

WorldDescription twoArms() {
    WorldDescription world;
    world.devices = {{.kind = "cyton", .name = "Left", .x = 2, .y = 3},
                     {.kind = "cyton", .name = "Right", .x = 5, .y = 3}};
    return world;
}

class CytonDevice : public ::testing::Test {
  protected:
    static std::string tell(Device& device, std::string_view text) {
        const auto answers = device.receive(std::vector<std::uint8_t>(text.begin(), text.end()));
        return {answers.begin(), answers.end()};
    }
    void pass(Duration time) {
        for (const auto until = lab_.age() + time; lab_.age() < until;) lab_.step();
    }
    static const Measure& measure(const std::vector<Measure>& truth, std::string_view name) {
        for (const auto& one : truth) {
            if (one.name == name) return one;
        }
        throw std::invalid_argument("the arm tells no " + std::string(name));
    }
    static double claw_mm(const Device& device) {
        const auto truth = device.truth();
        return std::get<double>(measure(truth, "claw_mm").value);
    }
    static std::vector<double> joints_deg(const Device& device) {
        const auto truth = device.truth();
        return std::get<std::vector<double>>(measure(truth, "joints_deg").value);
    }
    static std::string refusalOf(Device& device, std::string_view fault, std::size_t which) {
        try {
            device.setFault(fault, which, true);
        } catch (const std::invalid_argument& error) {
            return error.what();
        }
        return {};
    }

    Laboratory lab_{twoArms(), [](std::size_t, const arcos::Bytes&) {}};
    Device& left_ = lab_.device(0);
    Device& right_ = lab_.device(1);
};

TEST_F(CytonDevice, IsAnArmThatSpeaksSsc32) {
    const auto* kind = deviceKind("cyton");
    ASSERT_NE(kind, nullptr);
    EXPECT_EQ(kind->noun, "arm");
    EXPECT_EQ(kind->protocol, "SSC-32");
    EXPECT_EQ(tell(left_, "VER\r"), "SSC32-V2.01XE\r");
    EXPECT_EQ(left_.baud(), 0) << "any speed of a serial line will do";
}

TEST_F(CytonDevice, TellsSevenJointsAndItsClawAndStandsAtHome) {
    EXPECT_EQ(left_.truth().size(), 2U);
    const auto joints = joints_deg(left_);
    ASSERT_EQ(joints.size(), 7U);
    EXPECT_NEAR(joints[0], 45.1, 0.1);
    EXPECT_NEAR(joints[5], -45, 0.1);
    EXPECT_NEAR(claw_mm(left_), kHomeClaw_mm, 0.1);
    for (const auto& one : left_.truth())
        EXPECT_GT(one.least_move, 0) << one.name << ": the noise of the physics is no move";
}

TEST_F(CytonDevice, StandsStillWhileNobodySpeaksToIt) {
    const auto before = joints_deg(left_);
    pass(seconds{2});
    const auto after = joints_deg(left_);
    for (std::size_t i = 0; i < before.size(); ++i) EXPECT_NEAR(after[i], before[i], 0.2) << i;
}

TEST_F(CytonDevice, MovesByTheBytesOfItsClientWhileTimePasses) {
    left_.clientConnected();
    EXPECT_THAT(tell(left_, "#7P1238T400\r"), IsEmpty());
    EXPECT_NEAR(claw_mm(left_), kHomeClaw_mm, 0.1) << "no time has passed";
    EXPECT_EQ(tell(left_, "Q\r"), "+");
    pass(seconds{1});
    EXPECT_EQ(tell(left_, "Q\r"), ".");
    EXPECT_NEAR(claw_mm(left_), 10.1, 0.3);
}

TEST_F(CytonDevice, TakesALineThatArrivesInPieces) {
    for (const char one : std::string("#7P1238\r")) tell(left_, std::string_view(&one, 1));
    pass(seconds{1});
    EXPECT_NEAR(claw_mm(left_), 10.1, 0.3);
}

TEST_F(CytonDevice, MovesAloneWhereThereAreTwo) {
    tell(left_, "#7P600\r#0P1500\r");
    const auto before = joints_deg(right_);
    pass(seconds{1});
    EXPECT_NEAR(claw_mm(left_), 16.6, 0.3);
    EXPECT_NEAR(claw_mm(right_), kHomeClaw_mm, 0.1);
    EXPECT_NEAR(joints_deg(right_)[0], before[0], 0.2);
    EXPECT_EQ(tell(right_, "QP7\r"), std::string(1, char(105)));
}

TEST_F(CytonDevice, GoesOnWithItsMoveWhenItsClientIsLost) {
    left_.clientConnected();
    tell(left_, "#7P1238T1000\r");
    left_.clientLost();
    pass(seconds{2});
    EXPECT_NEAR(claw_mm(left_), 10.1, 0.3);
}

TEST_F(CytonDevice, GivesANewClientNoHalfLineOfTheOneBefore) {
    left_.clientConnected();
    tell(left_, "#7P600T1000");
    left_.clientLost();
    left_.clientConnected();
    EXPECT_EQ(tell(left_, "\rQ\r"), ".") << "the line was finished by the wrong client";
}

TEST_F(CytonDevice, ReadsOnAfterBytesThatAreNoLine) {
    std::vector<std::uint8_t> noise;
    for (int i = 0; i < 2000; ++i) noise.push_back(static_cast<std::uint8_t>(i * 37));
    left_.receive(noise);
    EXPECT_EQ(tell(left_, "\r#99P1500\r#7P\rVER\r"), "SSC32-V2.01XE\r");
    pass(milliseconds{400});
    EXPECT_NEAR(claw_mm(left_), kHomeClaw_mm, 0.1);
}

TEST_F(CytonDevice, AStuckServoStaysWhereItIsUntilItIsMended) {
    left_.setFault("stuck-servo", 0, true);
    left_.setFault("stuck-gripper", 0, true);
    const auto before = joints_deg(left_);
    tell(left_, "#0P1500#2P1500#7P1238\r");
    pass(seconds{2});
    EXPECT_NEAR(joints_deg(left_)[0], before[0], 0.5);
    EXPECT_NEAR(claw_mm(left_), kHomeClaw_mm, 0.3);
    EXPECT_NEAR(joints_deg(left_)[2], 5, 0.5) << "the others move";
    EXPECT_NEAR(joints_deg(right_)[0], before[0], 0.5);
    left_.setFault("stuck-servo", 0, false);
    left_.setFault("stuck-gripper", 0, false);
    pass(seconds{2});
    EXPECT_NEAR(joints_deg(left_)[0], 1.67, 0.5);
    EXPECT_NEAR(claw_mm(left_), 10.1, 0.3);
}

TEST_F(CytonDevice, RefusesFaultsThatItDoesNotHave) {
    EXPECT_THAT(refusalOf(left_, "dead-sonar", 0), HasSubstr("expected stuck-servo or stuck-gripper"));
    EXPECT_THAT(refusalOf(left_, "", 0), HasSubstr("expected stuck-servo or stuck-gripper"));
    EXPECT_THAT(refusalOf(left_, "stuck-servo", kGripper + 1), HasSubstr("expected a servo from 0 to 7"));
    EXPECT_THAT(refusalOf(left_, "stuck-servo", kGripper), IsEmpty()) << "the gripper's servo is one";
}

TEST_F(CytonDevice, AResetBringsItHomeAtRestWithAControllerThatForgotEverything) {
    const auto home = joints_deg(left_);
    left_.setFault("stuck-gripper", 0, true);
    tell(left_, "#0P1500#7P600T3000\r#1P1500T3000");
    pass(seconds{1});
    lab_.reset();
    EXPECT_EQ(tell(left_, "\rQ\r"), ".") << "the move or the half line is still there";
    pass(seconds{1});
    const auto now = joints_deg(left_);
    for (std::size_t i = 0; i < home.size(); ++i) EXPECT_NEAR(now[i], home[i], 0.2) << i;
    tell(left_, "#7P1238\r");
    pass(seconds{1});
    EXPECT_NEAR(claw_mm(left_), 10.1, 0.3) << "the gripper is still stuck";
}

TEST_F(CytonDevice, TellsTheSameNumbersForTheSameCalls) {
    const auto run = [this] {
        lab_.reset();
        tell(left_, "#0P1500#1P1500#7P1238T700\r");
        pass(seconds{1});
        return joints_deg(left_);
    };
    const auto first = run();
    EXPECT_EQ(run(), first);
}

}  // namespace
}  // namespace axon::lab
