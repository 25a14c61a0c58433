// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "robots/cyton/pick_and_place.hpp"
#include "robots/cyton/reach_demo.hpp"
#include "robots/cyton/servo_gate.hpp"
#include "robots/cyton/trajectory.hpp"

namespace axon::cyton {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

Posture atHome() {
    Posture home;
    home.joints = kHome;
    return home;
}

class Gate : public ::testing::Test {
  protected:
    static std::vector<int> homePulses() {
        std::vector<int> told;
        for (const double pulse : pulsesOf(atHome())) told.push_back(static_cast<int>(pulse / 10) * 10);
        return told;
    }
    bool take() {
        return gate_.take([] { return false; });
    }

    ManualClock clock_;
    bool reachable_ = true;
    std::vector<std::string> sent_;
    ServoGate gate_{[this](const std::string& lines) {
        if (reachable_) sent_.push_back(lines);
        return reachable_;
    }};
};

TEST_F(Gate, KnowsWhereTheArmIsFromTheCommandsAlone) {
    EXPECT_FALSE(gate_.present(clock_.now()));
    gate_.told(homePulses(), clock_.now());
    ASSERT_TRUE(gate_.present(clock_.now()));
    EXPECT_LT(largestDifference(gate_.present(clock_.now())->joints, kHome), 0.011);
    ASSERT_TRUE(take());
    Posture upright;
    ASSERT_TRUE(gate_.command(upright, milliseconds{400}, clock_.now()));
    clock_.advance(milliseconds{200});
    EXPECT_NEAR(gate_.present(clock_.now())->joints[0], kHome[0] / 2, 0.01);
    clock_.advance(milliseconds{200});
    EXPECT_NEAR(gate_.present(clock_.now())->joints[0], 0, 0.001);
}

TEST_F(Gate, AStopCommandsThePulsesOfThatMomentAndNothingFollows) {
    gate_.told(homePulses(), clock_.now());
    ASSERT_TRUE(take());
    Posture upright;
    gate_.command(upright, milliseconds{400}, clock_.now());
    clock_.advance(milliseconds{100});
    const auto there = *gate_.present(clock_.now());
    EXPECT_TRUE(gate_.stop(clock_.now()));
    const auto roll = std::lround(pulseOf(kChain[0], there.joints[0]));
    EXPECT_THAT(sent_.back(), HasSubstr("\x1b#0P" + std::to_string(roll) + "#1P"));
    EXPECT_THAT(sent_.back(), ::testing::Not(HasSubstr("T")));
    clock_.advance(milliseconds{500});
    EXPECT_EQ(gate_.present(clock_.now())->joints, there.joints);
    EXPECT_FALSE(gate_.command(upright, milliseconds{40}, clock_.now()));
    EXPECT_FALSE(take()) << "before the stopped task has given it back";
    gate_.giveBack(clock_.now());
    EXPECT_TRUE(take());
}

TEST_F(Gate, ATaskThatWasToldToStopDoesNotTakeTheArm) {
    EXPECT_FALSE(gate_.take([] { return true; }));
    EXPECT_TRUE(take());
    EXPECT_FALSE(take());
}

TEST_F(Gate, AfterPowerUpThePositionIsKnownWhenTheFirstMoveIsOver) {
    gate_.told(std::vector<int>(kChannels, 0), clock_.now());
    EXPECT_FALSE(gate_.present(clock_.now()));
    EXPECT_TRUE(sent_.empty()) << "connecting moves nothing";
    ASSERT_TRUE(take());
    gate_.command(atHome(), std::chrono::seconds{5}, clock_.now());
    clock_.advance(std::chrono::seconds{4});
    EXPECT_FALSE(gate_.present(clock_.now()));
    clock_.advance(std::chrono::seconds{1});
    EXPECT_TRUE(gate_.present(clock_.now()));
}

TEST_F(Gate, AStopOnTheWayFromNobodyKnowsWhereEndsTheMoveAndAsks) {
    gate_.told(std::vector<int>(kChannels, 0), clock_.now());
    ASSERT_TRUE(take());
    gate_.command(atHome(), std::chrono::seconds{5}, clock_.now());
    clock_.advance(std::chrono::seconds{1});
    EXPECT_TRUE(gate_.stop(clock_.now()));
    EXPECT_EQ(sent_.back(), "\x1b");
    clock_.advance(std::chrono::seconds{9});
    EXPECT_FALSE(gate_.present(clock_.now()));
    gate_.told(homePulses(), clock_.now());
    EXPECT_TRUE(gate_.present(clock_.now()));
}

TEST_F(Gate, WhatTheControllerTellsRoundedDoesNotBlurWhatIsKnown) {
    gate_.told(homePulses(), clock_.now());
    ASSERT_TRUE(take());
    Posture posture;
    posture.joints[2] = 0.1234;
    gate_.command(posture, milliseconds{40}, clock_.now());
    clock_.advance(milliseconds{50});
    const auto before = *gate_.present(clock_.now());
    std::vector<int> told;
    for (const double pulse : pulsesOf(posture)) told.push_back(static_cast<int>(pulse / 10) * 10);
    gate_.told(told, clock_.now());
    EXPECT_EQ(gate_.present(clock_.now())->joints, before.joints);
}

TEST_F(Gate, ALostControllerClosesIt) {
    gate_.told(homePulses(), clock_.now());
    ASSERT_TRUE(take());
    reachable_ = false;
    EXPECT_FALSE(gate_.command(atHome(), milliseconds{40}, clock_.now()));
    gate_.lost();
    reachable_ = true;
    EXPECT_FALSE(gate_.command(atHome(), milliseconds{40}, clock_.now())) << "its task ends first";
}

/// The greatest speed of any joint as part of its highest, and the greatest acceleration, by differences.
std::pair<double, double> extremes(const Trajectory& trajectory) {
    constexpr double kStep = 0.004;
    double speed = 0;
    double acceleration = 0;
    for (double t = kStep; t < trajectory.duration_s(); t += kStep) {
        const auto a = trajectory.at(t - kStep).joints;
        const auto b = trajectory.at(t).joints;
        const auto c = trajectory.at(t + kStep).joints;
        for (std::size_t i = 0; i < kJoints; ++i) {
            speed = std::max(speed, std::abs(c[i] - a[i]) / (2 * kStep) / fastest_rad_s(kChain[i]));
            acceleration = std::max(acceleration, std::abs(c[i] - 2 * b[i] + a[i]) / (kStep * kStep));
        }
    }
    return {speed, acceleration};
}

TEST(CytonTrajectory, NoJointIsFasterThanItsPartOfItsRate) {
    Kinematics random(5);
    for (int i = 0; i < 50; ++i) {
        const double part = 0.05 + 0.95 * i / 49;
        const Trajectory trajectory({{random.randomJoints(), 3}, {random.randomJoints(), 30}}, part);
        const auto [speed, acceleration] = extremes(trajectory);
        EXPECT_LE(speed, part * 1.001);
        EXPECT_LE(acceleration, Trajectory::kAcceleration_rad_s2 * 1.01);
    }
}

TEST(CytonTrajectory, AllJointsBeginAndEndTogetherAndSoftly) {
    const Trajectory trajectory({Posture{}, atHome()}, 0.5);
    const double t = trajectory.duration_s();
    EXPECT_EQ(trajectory.at(0).joints, Joints{});
    EXPECT_EQ(trajectory.at(t).joints, kHome);
    for (std::size_t i = 0; i < kJoints; ++i) {
        EXPECT_NEAR(trajectory.at(t / 2).joints[i], kHome[i] / 2, 1e-9) << i;
        EXPECT_LT(std::abs(trajectory.at(0.01 * t).joints[i]), 0.0001) << i;
    }
}

TEST(CytonTrajectory, NoWayTakesNoTimeAndNonsenseIsRefused) {
    EXPECT_EQ(Trajectory({atHome(), atHome()}, 0.5).duration_s(), 0);
    EXPECT_EQ(Trajectory({atHome()}, 0.5).at(1).joints, kHome);
    EXPECT_THROW(Trajectory({}, 0.5), std::invalid_argument);
    EXPECT_THROW(Trajectory({atHome()}, 0), std::invalid_argument);
    EXPECT_THROW(Trajectory({atHome()}, 1.5), std::invalid_argument);
}

TEST(CytonPlayback, APauseRunsOutAlongTheWayAndResumeFinishesIt) {
    Playback playback({{"there", Trajectory({Posture{}, atHome()}, 0.2), 0}});
    Playback::Step step;
    for (int i = 0; i < 20; ++i) step = playback.advance(0.04, false);
    auto last = step.posture.joints;
    double largest_step = 0;
    int moved = 0;
    for (int i = 0; i < 50; ++i) {
        step = playback.advance(0.04, true);
        const double way = largestDifference(step.posture.joints, last);
        largest_step = std::max(largest_step, way);
        moved += way > 0;
        last = step.posture.joints;
    }
    EXPECT_TRUE(step.resting);
    EXPECT_FALSE(step.done);
    EXPECT_LE(moved, 6);
    EXPECT_LE(largest_step, 0.04 * 0.2 * fastest_rad_s(kChain[0]) * 1.01);
    for (int i = 0; i < 200 && !step.done; ++i) step = playback.advance(0.04, false);
    EXPECT_TRUE(step.done);
    EXPECT_EQ(step.posture.joints, kHome);
    EXPECT_EQ(step.progress, 1);
}

TEST(CytonPlayback, LegsFollowEachOtherWithTheirRests) {
    Playback playback({{"a", Trajectory({Posture{}, atHome()}, 0.5), 0.5},
                       {"b", Trajectory({atHome(), Posture{}}, 0.5), 0}});
    double time = 0;
    double at_home = 0;
    double progress = 0;
    for (Playback::Step step; !step.done; time += 0.01) {
        step = playback.advance(0.01, false);
        EXPECT_GE(step.progress, progress);
        progress = step.progress;
        if (step.posture.joints == kHome) at_home += 0.01;
        ASSERT_LT(time, 60);
    }
    EXPECT_NEAR(time, playback.duration_s(), 0.05);
    EXPECT_GT(at_home, 0.45);
}

TEST(CytonPlayback, AnotherSpeedIsTakenUpSoftlyWithinTheServosRatesAndRestsStay) {
    const std::vector<Leg> legs{{"a", Trajectory({Posture{}, atHome()}, 0.1), 0.5},
                                {"b", Trajectory({atHome(), Posture{}}, 0.1), 0.5}};
    constexpr double kStep_s = 0.01;
    /// Seconds until the end, at these times of the planned speed.
    const auto play = [&](const std::function<double(double)>& times) {
        Playback playback(legs);
        Posture last;
        double time = 0;
        double pace = 0;
        double resting = 0;
        for (Playback::Step step; !step.done && time < 1000; time += kStep_s) {
            step = playback.advance(kStep_s, false, times(time));
            EXPECT_LE(leastTime_s(last, step.posture), kStep_s * 1.01) << "at " << time;
            const double now = largestDifference(step.posture.joints, last.joints) / kStep_s;
            EXPECT_LE(std::abs(now - pace), 0.4) << "a jerk at " << time;
            if (step.posture.joints == kHome) resting += kStep_s;
            pace = now;
            last = step.posture;
        }
        EXPECT_NEAR(resting, 0.5, 0.06);
        EXPECT_EQ(last.joints, Posture{}.joints);
        return time;
    };
    const double planned = play([](double) { return 1; });
    EXPECT_NEAR(planned, Playback(legs).duration_s(), 0.05);
    EXPECT_NEAR(play([](double) { return 0.5; }), 2 * (planned - 1) + 1, 0.5);
    const double fastest = play([](double) { return 10; });
    EXPECT_NEAR(fastest, 2 * Trajectory({Posture{}, atHome()}, 1).duration_s() + 1, 0.5);
    EXPECT_NEAR(play([](double) { return 1000; }), fastest, 0.5) << "no faster than the servos";
    const double changed = play([](double time) { return time < 2 ? 1 : time < 3 ? 6 : 0.2; });
    EXPECT_GT(changed, fastest);
}

TEST(ReachDemo, TurnsOneJointAfterTheOtherToBothEnds) {
    Playback playback(reachDemo(atHome(), 0.5));
    std::vector<std::size_t> order;
    Joints lowest{};
    Joints highest{};
    Posture last = atHome();
    for (Playback::Step step; !step.done;) {
        step = playback.advance(0.02, false);
        EXPECT_TRUE(withinLimits(step.posture.joints));
        EXPECT_LE(leastTime_s(last, step.posture), 0.02 * 0.5 * 1.01);
        last = step.posture;
        if (step.leg == 0 || step.leg + 1 == playback.legs().size()) continue;
        for (std::size_t i = 0; i < kJoints; ++i) {
            lowest[i] = std::min(lowest[i], step.posture.joints[i]);
            highest[i] = std::max(highest[i], step.posture.joints[i]);
            if (step.posture.joints[i] != 0 && (order.empty() || order.back() != i)) order.push_back(i);
        }
    }
    EXPECT_THAT(order, ::testing::ElementsAre(0, 1, 2, 3, 4, 5, 6)) << "one at a time";
    for (std::size_t i = 0; i < kJoints; ++i) {
        EXPECT_EQ(lowest[i], kChain[i].minimum);
        EXPECT_EQ(highest[i], kChain[i].maximum);
    }
    EXPECT_EQ(last.joints, kHome);
}

/// Plays a plan at the pace of the application and looks at every posture on the way.
void expectSound(const PickAndPlacePlan& plan, const PickAndPlaceRequest& request, const Posture& start) {
    const Kinematics kinematics;
    Playback playback(plan.legs);
    Posture last = start;
    for (Playback::Step step; !step.done;) {
        step = playback.advance(0.04, false);
        EXPECT_TRUE(withinLimits(step.posture.joints)) << plan.legs[step.leg].name;
        EXPECT_LE(leastTime_s(last, step.posture), 0.04 * 1.01)
            << "faster than a servo in " << plan.legs[step.leg].name;
        last = step.posture;
        const auto tool = kinematics.forward(step.posture.joints);
        if (step.leg >= plan.grasped && step.leg < plan.released) {
            // Half the object's width leans over its lower edge before it falls.
            EXPECT_LT(std::abs(tool.closing[2]), 0.35) << plan.legs[step.leg].name;
            EXPECT_GE(tool.position[2] - plan.grip_height, -0.001);
        }
    }
    EXPECT_LT(largestDifference(last.joints, kHome), 1e-9);
    const auto grasp = kinematics.forward(plan.legs[plan.grasped - 1].way.end().joints);
    EXPECT_NEAR(grasp.position[0], request.pick[0], 0.0005);
    EXPECT_NEAR(grasp.position[1], request.pick[1], 0.0005);
    EXPECT_NEAR(grasp.position[2], request.pick[2] + plan.grip_height, 0.0005);
    EXPECT_NEAR(grasp.closing[2], 0, 0.003) << "claws close on upright sides";
    const auto release = kinematics.forward(plan.legs[plan.released].way.end().joints);
    EXPECT_NEAR(release.position[0], request.place[0], 0.0005);
    EXPECT_NEAR(release.position[2], request.place[2] + plan.grip_height + 0.002, 0.0005);
    EXPECT_NEAR(release.approach[2], grasp.approach[2], 0.005) << "the object stands as upright as it stood";
}

TEST(PickAndPlace, TheDefaultsCanBeDoneFromHomeAndFromElsewhere) {
    Kinematics kinematics;
    const PickAndPlaceRequest request;
    for (const auto& start : {atHome(), Posture{}}) {
        const auto plan = planPickAndPlace(kinematics, request, start);
        ASSERT_TRUE(plan) << plan.refusal().message;
        expectSound(plan.value(), request, start);
    }
}

TEST(PickAndPlace, WithRandomOffsetsWithinReachItIsAlwaysPlanned) {
    std::mt19937 random(3);
    const auto offset = [&random](double most) {
        return most * (static_cast<double>(random()) / 2147483648.0 - 1);
    };
    for (int i = 0; i < 12; ++i) {
        Kinematics kinematics;
        PickAndPlaceRequest request;
        request.pick[0] += offset(0.015);
        request.pick[1] += offset(0.015);
        request.place[1] += offset(0.05);
        const auto plan = planPickAndPlace(kinematics, request, atHome());
        ASSERT_TRUE(plan) << i << ": " << plan.refusal().message;
        expectSound(plan.value(), request, atHome());
    }
}

TEST(PickAndPlace, ABoxIsGrippedByItsSidesAndTurnedAsWanted) {
    Kinematics kinematics;
    PickAndPlaceRequest request;
    request.pick_yaw = radians(10);
    request.place_yaw = radians(0);
    const auto plan = planPickAndPlace(kinematics, request, atHome());
    ASSERT_TRUE(plan) << plan.refusal().message;
    const auto yaw = [&](std::size_t leg) {
        const auto closing = kinematics.forward(plan->legs[leg].way.end().joints).closing;
        return std::remainder(std::atan2(closing[1], closing[0]), std::numbers::pi / 2);
    };
    EXPECT_NEAR(yaw(plan->grasped - 1), radians(10), 0.005);
    EXPECT_NEAR(yaw(plan->released), 0, 0.005);
}

TEST(PickAndPlace, WhatCannotBeReachedIsRefusedWithTheReason) {
    Kinematics kinematics;
    const auto refused = [&](auto change) {
        PickAndPlaceRequest request;
        change(request);
        const auto plan = planPickAndPlace(kinematics, request, atHome());
        return plan ? std::string("planned") : plan.refusal().message;
    };
    EXPECT_THAT(refused([](auto& r) { r.pick = {0.5, 0.4, 0.1}; }), HasSubstr("the arm is 469 mm long"));
    EXPECT_THAT(refused([](auto& r) { r.pick = {0.05, 0.05, 0.1}; }), HasSubstr("keep it 120 mm away"));
    EXPECT_THAT(refused([](auto& r) { r.place[2] = -0.1; }), HasSubstr("give a Z of 0 or more"));
    EXPECT_THAT(refused([](auto& r) { r.width = 0.05; }), HasSubstr("does not fit between the claws"));
    EXPECT_THAT(refused([](auto& r) { r.place = r.pick; }), HasSubstr("less than 60 mm apart"));
    EXPECT_THAT(refused([](auto& r) { r.pick = {0.2, 0.15, 0.1}; }), HasSubstr("cannot grip"));
    EXPECT_THAT(refused([](auto& r) {
                    r.place = {0.25, 0, 0};
                }),
                HasSubstr("not put it down at (250, 0, 0) mm"));
}

/// Over the arm's top an object would be upside down on the way, and what is round turns between the claws.
TEST(PickAndPlace, WhatIsCarriedIsHeldLevelWhereverTheArmReaches) {
    std::mt19937 random(5);
    const auto among = [&random](double a, double b) {
        return a + (b - a) * static_cast<double>(random()) / 4294967296.0;
    };
    for (int i = 0; i < 15; ++i) {
        Kinematics kinematics;
        PickAndPlaceRequest request;
        const double far = among(0.362, 0.412);
        const double round = radians(among(72, 98));
        request.pick = {far * std::cos(round), far * std::sin(round), 0.1};
        request.place = {among(0.375, 0.4), among(-0.06, 0.06), 0};
        const auto plan = planPickAndPlace(kinematics, request, atHome());
        ASSERT_TRUE(plan) << i << ": " << plan.refusal().message;
        EXPECT_LT(degrees(plan->carried_tilt), 45) << i << ": " << far << " m, " << degrees(round) << " deg";
        // Not only by its own word.
        const auto& carry = plan->legs[plan->grasped + 1];
        ASSERT_EQ(carry.name, "carrying it");
        const double before = kinematics.forward(carry.way.at(0).joints).approach[2];
        for (double t = 0; t < carry.way.duration_s(); t += 0.05)
            EXPECT_NEAR(std::acos(kinematics.forward(carry.way.at(t).joints).approach[2]), std::acos(before),
                        radians(46));
    }
}

TEST(PickAndPlace, AnotherSpeedOnTheWayLeavesTheClawsTheirOwn) {
    Kinematics kinematics;
    const auto plan = planPickAndPlace(kinematics, {}, atHome());
    ASSERT_TRUE(plan) << plan.refusal().message;
    constexpr double kStep_s = 0.004;
    /// The seconds of each leg, and the greatest speed of the claws in those in which the arm stands, mm/s.
    const auto play = [&](double times) {
        Playback playback(plan->legs);
        std::pair<std::vector<double>, double> seen{std::vector<double>(plan->legs.size()), 0};
        Posture last = atHome();
        for (Playback::Step step; !step.done; last = step.posture) {
            step = playback.advance(kStep_s, false, times);
            seen.first[step.leg] += kStep_s;
            if (step.posture.joints == last.joints)
                seen.second =
                    std::max(seen.second, std::abs(step.posture.opening_mm - last.opening_mm) / kStep_s);
        }
        return seen;
    };
    const auto planned = play(1);
    EXPECT_GT(planned.second, 10) << "the claws do move";
    for (const double times : {0.2, 4.0}) {
        const auto changed = play(times);
        for (const auto claws : {plan->grasped - 1, plan->released})
            EXPECT_NEAR(changed.first[claws], planned.first[claws], 0.05)
                << plan->legs[claws].name << " at " << times << " times the speed";
        EXPECT_NEAR(changed.second, planned.second, 0.5) << times;
        const auto carrying = plan->grasped + 1;
        if (times < 1)
            EXPECT_GT(changed.first[carrying], 2 * planned.first[carrying]);
        else
            EXPECT_LT(changed.first[carrying], planned.first[carrying] / 2);
    }
}

TEST(PickAndPlace, PlanningEndsWhenTheTaskIsStopped) {
    Kinematics kinematics;
    const auto plan = planPickAndPlace(kinematics, {}, atHome(), [] { return true; });
    ASSERT_FALSE(plan);
    EXPECT_THAT(plan.refusal().message, HasSubstr("stopped"));
}

}  // namespace
}  // namespace axon::cyton
