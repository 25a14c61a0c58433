// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <numbers>

/// The Cyton Alpha 7D1G in numbers: metres, radians, kilograms, microseconds. Geometry, masses and joint
/// directions are those of the URDF of LCAD-UFES, limits those of its MoveIt configuration, pulses and rates
/// those of the vendor's servo file cytonAlphaConfig.xml; what none tells is marked as assumed.
///
/// Frame of the arm: origin on the surface it stands on, in the axis of the shoulder roll; z up. At zero the
/// arm points straight up. In this frame, with the arm at zero, a joint is the point kChain[i].offset_m
/// further than the joint before it, and turns about kChain[i].axis by the right-hand rule: a positive pitch
/// leans towards +x, a positive roll is clockwise seen from above.
namespace axon::lab::cyton {

inline constexpr int kJoints = 7;
inline constexpr int kChannels = 8;  // 0 to 6 the joints, 7 the gripper

struct Joint {
    const char* name;
    std::array<double, 3> offset_m;  ///< from the joint before it, the first from the origin
    std::array<double, 3> axis;
    double limit_rad;  ///< to both sides
    double torque_nm;  ///< of its servo; the vendor's file, its unit taken as 10 N m
    double mass_kg;    ///< of the link that it moves
};
inline constexpr std::array<Joint, kJoints> kChain{{
    {"shoulder_base", {0, 0, 0.0845}, {0, 0, -1}, 1.5708, 2.42, 0.17897},
    {"shoulder_pitch", {0, 0, 0.0355}, {0, 1, 0}, 1.4835, 2.35, 0.17025},
    {"shoulder_yaw", {0, 0.008, 0.1065}, {0, 0, -1}, 1.5708, 2.42, 0.074076},
    {"elbow_pitch", {0, 0, 0.06745}, {0, 1, 0}, 1.4835, 2.35, 0.067267},
    {"wrist_roll", {0, 0.0015, 0.0875}, {0, 0, -1}, 1.5708, 0.54, 0.051376},
    {"wrist_yaw", {0, 0, 0.06995}, {0, 1, 0}, 1.1345, 0.54, 0.045233},
    {"wrist_pitch", {0, -0.00775, 0.06645}, {-1, 0, 0}, 1.1781, 0.54, 0.04349},
}};
inline constexpr double kBaseMass_kg = 0.40583;
inline constexpr double kClawMass_kg = 0.0052092;

/// From the last joint to the claws' axis, and on to the middle of what the claws hold. The claws move along
/// x (arm at zero), one to each side; between closed claws there is 2 * kClawInner_m.
inline constexpr std::array<double, 3> kClaws_m{-0.0091826, 0, 0.0555};
inline constexpr double kGraspPoint_m = 0.0095;  // beyond the claws' axis: the middle of their inner faces
inline constexpr double kClawInner_m = 0.00083;
inline constexpr double kClawTravel_m = 0.017;  // of each claw
inline constexpr double kClawForce_n = 12;      // of both together, assumed

/// A servo: value = (pulse - offset) * scale, in rad, for the gripper in metres that each claw is open.
struct Servo {
    int least_us;
    int most_us;
    int offset_us;
    double scale;          ///< rad or m per microsecond
    int home_us;           ///< the vendor's home position
    int fastest_us_per_s;  ///< the vendor's highest rate
    double value(double pulse_us) const { return (pulse_us - offset_us) * scale; }
    double pulse_us(double value) const { return offset_us + value / scale; }
};
inline constexpr double kLarge = std::numbers::pi / 180 / 9;   // rad per microsecond: 3.88 rad/s at 2000 us/s
inline constexpr double kSmall = std::numbers::pi / 180 / 10;  // HS-475HB: 3.49 rad/s at 2000 us/s
/// The vendor's ranges tell the direction of joints 0 to 3 and 5; that of 4 and 6 is assumed. The vendor
/// counts the gripper from the middle of its way, -8.1 to +8.1 mm; here 0 is closed: offset 1400 + 8.5 mm.
inline constexpr std::array<Servo, kChannels> kServos{{
    {500, 2500, 1515, -kLarge, 1109, 2000},
    {500, 2500, 1425, kLarge, 1344, 2000},
    {500, 2500, 1545, -kLarge, 1836, 2000},
    {500, 2500, 1545, kLarge, 1335, 2000},
    {500, 2500, 1500, kSmall, 1555, 2000},
    {500, 2250, 1245, kSmall, 795, 2000},
    {500, 2500, 1500, kSmall, 1500, 2000},
    {600, 2200, 2238, -kSmall / 172, 1055, 2000},
}};

}  // namespace axon::lab::cyton
