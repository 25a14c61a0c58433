// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/kinematics.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdio>

namespace axon::cyton {
namespace {

double apart(const Point& a, const Point& b) {
    return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

TEST(CytonKinematics, UprightItHasTheLengthsOfTheUrdf) {
    const Kinematics kinematics;
    const auto tool = kinematics.forward({});
    EXPECT_NEAR(tool.position[2], 0.0845 + 0.0355 + 0.1065 + 0.06745 + 0.0875 + 0.06995 + 0.06645 + 0.071,
                1e-9);
    EXPECT_NEAR(tool.approach[2], 1, 1e-9);
    const auto points = kinematics.skeleton({});
    EXPECT_NEAR(points[1][2], 0.120, 1e-9);
    EXPECT_NEAR(points[3][2], 0.294, 0.0005);
    EXPECT_NEAR(points[6][2], 0.518, 0.0005);
}

TEST(CytonKinematics, APositivePitchLeansForwardsAndAPositiveRollTurnsClockwise) {
    const Kinematics kinematics;
    EXPECT_GT(kinematics.forward({0, 1, 0, 0, 0, 0, 0}).position[0], 0.3);
    EXPECT_GT(kinematics.forward({0, 0, 0, 1, 0, 0, 0}).position[0], 0.2);
    EXPECT_LT(kinematics.forward({1.5, 1, 0, 0, 0, 0, 0}).position[1], -0.3);
}

TEST(CytonKinematics, FindsJointsWithinLimitsForRandomReachablePoses) {
    Kinematics kinematics;
    Kinematics random(99);
    int solved = 0;
    const auto began = std::chrono::steady_clock::now();
    for (int i = 0; i < 500; ++i) {
        const auto pose = kinematics.forward(random.randomJoints());
        const auto found = kinematics.solve(pose, {}, {.starts = 200, .solutions = 1});
        if (!found) continue;
        ++solved;
        EXPECT_TRUE(withinLimits(*found, Kinematics::kMargin_rad * 0.99));
        const auto reached = kinematics.forward(*found);
        EXPECT_LT(apart(reached.position, pose.position), 2e-4);
        EXPECT_LT(apart(reached.approach, pose.approach), 3e-3);
        const double along = reached.closing[0] * pose.closing[0] + reached.closing[1] * pose.closing[1] +
                             reached.closing[2] * pose.closing[2];
        EXPECT_GT(std::abs(along), 0.9999) << "either way, since the claws are alike";
    }
    const auto took =
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - began).count();
    std::printf("solved %d of 500, %.2f ms each\n", solved, took / 500);
    EXPECT_GE(solved, 495);
}

TEST(CytonKinematics, TheSameCallsGiveTheSameJoints) {
    Kinematics first;
    Kinematics second;
    const ToolPose pose{{0.2, 0.25, 0.15}, {std::sqrt(0.5), 0, -std::sqrt(0.5)}, {0, 1, 0}};
    for (int i = 0; i < 3; ++i)
        EXPECT_EQ(first.solve(pose, {}, {.starts = 40}), second.solve(pose, {}, {.starts = 40}));
}

TEST(CytonKinematics, WhatIsOutOfReachHasNoSolution) {
    Kinematics kinematics;
    EXPECT_FALSE(kinematics.solve({{0.6, 0, 0.1}, {0, 0, -1}, {0, 1, 0}}, {}, {.starts = 20}));
    EXPECT_FALSE(kinematics.solve({{0.255, 0, 0.3}, {0, 0, -1}, {0, 1, 0}}, {}, {.starts = 20}));
}

TEST(CytonKinematics, ALineIsFollowedWithoutChangingTheConfiguration) {
    Kinematics kinematics;
    ToolPose pose{{0.38, 0, 0.16}, {0.5, 0, -std::sqrt(0.75)}, {0, 1, 0}};
    auto joints = kinematics.solve(pose, {0, 0.7, 0, 0.9, 1.4, 0, 0.4}, {});
    ASSERT_TRUE(joints);
    for (int i = 0; i < 8; ++i) {
        pose.position[2] -= 0.01;
        const auto next = kinematics.follow(pose, *joints);
        ASSERT_TRUE(next) << i;
        EXPECT_LT(largestDifference(*next, *joints), 0.2) << i;
        joints = next;
    }
}

}  // namespace
}  // namespace axon::cyton
