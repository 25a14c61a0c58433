// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>

/// The Cyton Alpha 7D1G in numbers: links, joint limits, servos. The application plans with them, and the
/// virtual arm may be built from them; nothing here does I/O or allocates.
///
/// Base frame: the origin lies below the axis of the first joint, in the plane that the base stands on; x
/// forward, y to the left, z up; metres and radians. With all joints at zero the arm points straight up, the
/// claws close along x.
///
/// Sources: link offsets and axes from the URDF cyton_alpha of LCAD-UFES, limits from its MoveIt
/// configuration (narrower than the servos'), pulses, rates and home from the vendor's cytonAlphaConfig.xml.
/// The vendor's own Actin model has an upper arm that is 21 mm shorter (0.153 m, here 0.174 m). "assumed": no
/// source tells.
namespace axon::cyton {

inline constexpr std::size_t kJoints = 7;
inline constexpr std::size_t kGripperChannel = 7;  // of the controller; joint i has channel i
inline constexpr std::size_t kChannels = 8;

using Joints = std::array<double, kJoints>;  ///< rad

struct Joint {
    const char* name;              ///< as users see it
    std::array<double, 3> offset;  ///< from the joint before it (the base) to this one, all joints at zero; m
    std::array<double, 3> axis;    ///< right-handed rotation, all joints at zero
    double minimum, maximum;       ///< rad
    double home;                   ///< rad
    double center_us;              ///< pulse at zero
    double rad_per_us;             ///< signed
    double shortest_us, longest_us;  ///< what the servo takes
};

inline constexpr double kNinthOfDegree = std::numbers::pi / 180 / 9;
inline constexpr double kTenthOfDegree = std::numbers::pi / 180 / 10;

/// The signs of the wrist's roll and yaw are assumed; their servos' ranges are symmetrical.
inline constexpr std::array<Joint, kJoints> kChain{{
    {"Shoulder Roll", {0, 0, 0.0845}, {0, 0, -1}, -1.5708, 1.5708, 0.787, 1515, -kNinthOfDegree, 500, 2500},
    {"Shoulder Pitch", {0, 0, 0.0355}, {0, 1, 0}, -1.4835, 1.4835, -0.157, 1425, kNinthOfDegree, 500, 2500},
    {"Elbow Roll", {0, 0.008, 0.1065}, {0, 0, -1}, -1.5708, 1.5708, -0.564, 1545, -kNinthOfDegree, 500, 2500},
    {"Elbow Pitch", {0, 0, 0.06745}, {0, 1, 0}, -1.4835, 1.4835, -0.407, 1545, kNinthOfDegree, 500, 2500},
    {"Wrist Roll", {0, 0.0015, 0.0875}, {0, 0, -1}, -1.5708, 1.5708, 0.096, 1500, kTenthOfDegree, 500, 2500},
    {"Wrist Pitch", {0, 0, 0.06995}, {0, 1, 0}, -1.1345, 1.1345, -0.785, 1245, kTenthOfDegree, 500, 2250},
    {"Wrist Yaw", {0, -0.00775, 0.06645}, {-1, 0, 0}, -1.1781, 1.1781, 0, 1500, kTenthOfDegree, 500, 2500},
}};

/// From the last joint to the point that is brought to what is gripped: between the pads of the claws, 10 mm
/// from their tips, so that there is room for half of it before the palm.
inline constexpr std::array<double, 3> kToolOffset{-0.00918, 0, 0.0555 + 0.0155};
/// Along the tool, from that point to the tips and back to the palm, and half of what pads and palm are
/// thick. m
inline constexpr double kTipBeyondTool = 0.010;
inline constexpr double kPalmBehindTool = 0.022;
inline constexpr double kPadHalfWidth = 0.010;
inline constexpr double kPalmHalfWidth = 0.024;

/// Every servo's fastest change of its pulse, from the vendor's file.
inline constexpr double kFastest_us_s = 2000;
/// The fastest that a joint turns; 3.88 or 3.49.
constexpr double fastest_rad_s(const Joint& joint) {
    return kFastest_us_s * (joint.rad_per_us < 0 ? -joint.rad_per_us : joint.rad_per_us);
}

inline constexpr Joints kHome{kChain[0].home, kChain[1].home, kChain[2].home, kChain[3].home,
                              kChain[4].home, kChain[5].home, kChain[6].home};

/// The gripper: one servo, both claws move alike. The vendor counts a claw from the middle of its 17 mm, here
/// 0 is closed; that a longer pulse closes follows from the sign in the vendor's file. Told in millimetres
/// between the pads.
namespace gripper {
inline constexpr double kMiddle_us = 1400;
inline constexpr double kShortest_us = 600;
inline constexpr double kLongest_us = 2200;
inline constexpr double kClaw_mm_per_us = -kTenthOfDegree / 172 * 1000;
inline constexpr double kClawMiddle_mm = 8.5 + 0.83;  ///< with what the pad stands back from the middle
constexpr double openingAt_mm(double pulse_us) {
    return 2 * (kClawMiddle_mm + (pulse_us - kMiddle_us) * kClaw_mm_per_us);
}
inline constexpr double kClosed_mm = openingAt_mm(kLongest_us);  ///< 2.4
inline constexpr double kOpen_mm = openingAt_mm(kShortest_us);   ///< 34.9
inline constexpr double kHome_mm = 2 * (kClawMiddle_mm + 3.5);
inline constexpr double kFastest_mm_s = -2 * kClaw_mm_per_us * kFastest_us_s;  ///< of the opening
}  // namespace gripper

/// Angle ↔ pulse. An angle beyond the servo's range gives the pulse at its end.
inline double pulseOf(const Joint& joint, double angle_rad) {
    return std::clamp(joint.center_us + angle_rad / joint.rad_per_us, joint.shortest_us, joint.longest_us);
}
inline double angleOf(const Joint& joint, double pulse_us) {
    return (pulse_us - joint.center_us) * joint.rad_per_us;
}
inline double gripperPulseOf(double opening_mm) {
    return std::clamp(
        gripper::kMiddle_us + (opening_mm / 2 - gripper::kClawMiddle_mm) / gripper::kClaw_mm_per_us,
        gripper::kShortest_us, gripper::kLongest_us);
}

constexpr double radians(double degrees) {
    return degrees * std::numbers::pi / 180;
}
constexpr double degrees(double radians) {
    return radians * 180 / std::numbers::pi;
}

}  // namespace axon::cyton
