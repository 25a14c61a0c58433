// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/geometry.hpp"

#include <gtest/gtest.h>

#include "lab/cyton/geometry.hpp"

namespace axon::cyton {
namespace {

TEST(CytonGeometry, PulseAndAngleAreEachOthersInverse) {
    for (const auto& joint : kChain) {
        for (double angle = joint.minimum; angle <= joint.maximum; angle += 0.1)
            EXPECT_NEAR(angleOf(joint, pulseOf(joint, angle)), angle, 1e-9) << joint.name;
    }
    for (double opening = gripper::kClosed_mm; opening <= gripper::kOpen_mm; opening += 1)
        EXPECT_NEAR(gripper::openingAt_mm(gripperPulseOf(opening)), opening, 1e-9);
}

TEST(CytonGeometry, TheVendorsNumbersComeOut) {
    EXPECT_NEAR(angleOf(kChain[0], 500), 1.968, 0.001);
    EXPECT_NEAR(angleOf(kChain[0], 2500), -1.910, 0.001);
    EXPECT_NEAR(angleOf(kChain[1], 500), -1.794, 0.001);
    EXPECT_NEAR(angleOf(kChain[1], 2500), 2.085, 0.001);
    EXPECT_NEAR(angleOf(kChain[2], 2500), -1.852, 0.001);
    EXPECT_NEAR(angleOf(kChain[3], 2500), 1.852, 0.001);
    EXPECT_NEAR(std::abs(angleOf(kChain[4], 2500)), 1.745, 0.001);
    EXPECT_NEAR(angleOf(kChain[5], 2250), 1.754, 0.001);
    EXPECT_NEAR(angleOf(kChain[5], 500), -1.300, 0.001);
    EXPECT_NEAR(fastest_rad_s(kChain[0]), 3.88, 0.005);
    EXPECT_NEAR(fastest_rad_s(kChain[6]), 3.49, 0.005);
    // Each claw moves 8.1 mm to both sides of its middle.
    EXPECT_NEAR((gripper::kOpen_mm - gripper::kClosed_mm) / 4, 8.1, 0.05);
}

TEST(CytonGeometry, EveryJointsLimitsAreWithinItsServosRange) {
    for (const auto& joint : kChain) {
        for (const double limit : {joint.minimum, joint.maximum, joint.home}) {
            EXPECT_NEAR(angleOf(joint, pulseOf(joint, limit)), limit, 1e-9) << joint.name << " is clamped";
        }
        EXPECT_GE(joint.home, joint.minimum);
        EXPECT_LE(joint.home, joint.maximum);
    }
}

TEST(CytonGeometry, WhatNoServoCanGiveIsThePulseAtItsEnd) {
    EXPECT_EQ(pulseOf(kChain[0], 10), 500);
    EXPECT_EQ(pulseOf(kChain[0], -10), 2500);
    EXPECT_EQ(pulseOf(kChain[5], 10), 2250);
    EXPECT_EQ(gripperPulseOf(100), 600);
    EXPECT_EQ(gripperPulseOf(-100), 2200);
}

TEST(CytonGeometry, TheVirtualArmIsTheSameArm) {
    for (std::size_t i = 0; i < kJoints; ++i) {
        const auto& own = kChain[i];
        const auto& virtual_joint = lab::cyton::kChain[i];
        const auto& servo = lab::cyton::kServos[i];
        EXPECT_EQ(own.axis, virtual_joint.axis) << own.name;
        for (std::size_t k = 0; k < 3; ++k)
            EXPECT_NEAR(own.offset[k], virtual_joint.offset_m[k], 1e-6) << own.name;
        EXPECT_NEAR(own.maximum, virtual_joint.limit_rad, 1e-6) << own.name;
        EXPECT_EQ(own.shortest_us, servo.least_us) << own.name;
        EXPECT_EQ(own.longest_us, servo.most_us) << own.name;
        for (const double pulse : {600.0, 1500.0, 2200.0})
            EXPECT_NEAR(angleOf(own, pulse), servo.value(pulse), 0.001) << own.name;
    }
    for (const double pulse : {700.0, 1400.0, 2100.0}) {
        const double claw_m = lab::cyton::kServos[kGripperChannel].value(pulse);
        EXPECT_NEAR(gripper::openingAt_mm(pulse), 2000 * (claw_m + lab::cyton::kClawInner_m), 0.05);
    }
}

}  // namespace
}  // namespace axon::cyton
