// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>

/// The PeopleBot in numbers: millimetres and degrees in the robot's frame, x forward, y left, origin on the
/// floor midway between the wheels. Sources are the vendor's parameter file peoplebot-sh.p and the models of
/// MobileSim; what neither tells is marked as assumed.
namespace axon::lab::peoplebot {

/// What moves, joints and motors of the same names, and the geoms that the physics looks at.
inline constexpr std::array kMotors{"left", "right", "leftpaddle", "rightpaddle", "lift", "pan", "tilt"};
inline constexpr std::array kGeoms{"leftwheel", "rightwheel", "leftpaddle", "rightpaddle"};

inline constexpr double kWheelRadius_mm = 95.5;
inline constexpr double kHalfLength_mm = 256.5;  // with bumpers
inline constexpr double kCentre_mm = -44.65;     // of the outline, behind the axle
inline constexpr double kSwingRadius_mm = 340;
inline constexpr double kHeight_mm = 1115;
inline constexpr double kMass_kg = 19;        // commonly quoted, no source found
inline constexpr double kMotorTorque_nm = 5;  // assumed: pushes hard, stalls before the tyres slip
/// The servo of one wheel: torque for each rad/s that the wheel is too slow, and for each rad that it is
/// behind. The vendor's gains are in units of its motor controller; these are assumed, and heavily damped.
inline constexpr double kWheelDamping_nm_s = 8;
inline constexpr double kWheelStiffness_nm = 32;
inline constexpr double kWheelInertia_kg_m2 = 0.145;  // half of the robot, as one motor feels it
inline constexpr int kBumperSegments = 5;  // front and rear; segment 1 is on the robot's left in front, and
                                           // the numbers go on clockwise, as those of the sonars do
inline constexpr double kBumperPitch_deg = 36;  // assumed: the five segments cover half a circle

struct SonarPose {
    double x_mm, y_mm, direction_deg;
};
inline constexpr double kSonarMinimum_mm = 100;
inline constexpr double kSonarMaximum_mm = 5000;
inline constexpr double kSonarHalfCone_deg = 15;
inline constexpr double kBaseSonarHeight_mm = 250;  // assumed
inline constexpr double kTopSonarHeight_mm = 1000;  // assumed
/// 0 to 7 base front, 8 to 15 base rear, 16 to 23 top front. Each array of eight fires one sonar per
/// kSonarPeriod.
inline constexpr std::array<SonarPose, 24> kSonars{{
    {69, 136, 90},     {114, 119, 50},    {148, 78, 30},   {166, 27, 10},     {166, -27, -10},
    {148, -78, -30},   {114, -119, -50},  {69, -136, -90}, {-157, -136, -90}, {-203, -119, -130},
    {-237, -78, -150}, {-255, -27, -170}, {-255, 27, 170}, {-237, 78, 150},   {-203, 119, 130},
    {-157, 136, 90},   {-20, 136, 90},    {24, 119, 50},   {58, 78, 30},      {77, 27, 10},
    {77, -27, -10},    {58, -78, -30},    {24, -119, -50}, {-20, -136, -90},
}};
inline constexpr int kSonarPeriod_ms = 40;

/// The table sensors look upwards from here.
inline constexpr double kTableSensorX_mm = 333;
inline constexpr double kTableSensorY_mm = 233;
inline constexpr double kTableSensorHeight_mm = 300;  // assumed
inline constexpr double kTableSensorRange_mm = 600;   // assumed

/// The laser range finder LMS-200, on the base in front of the column.
inline constexpr double kLaserX_mm = 21;
inline constexpr double kLaserHeight_mm = 330;     // assumed
inline constexpr double kLaserMaximum_mm = 32000;  // millimetre mode, one reflector bit
inline constexpr int kLaserPeriod_ms = 100;  // MobileSim's; the real one over 38400 baud needs twice that
/// Standard deviations of normal noise. MobileSim's laser noise is uniform over 5 mm to both sides.
inline constexpr double kLaserNoise_mm = 3;
inline constexpr double kSonarNoise_mm = 10;  // assumed

/// The two-finger gripper, in front of the column and over the base, so that nothing reaches beyond the
/// bumpers: the robot drives under a table until what it is to grasp is between the paddles. The paddles are
/// upright plates from kPaddleRear_mm to kPaddleTip_mm that move sideways; heights are those of their middle.
/// Opening and lift are commonly quoted for the vendor's gripper, where it sits is assumed.
inline constexpr double kPaddleRear_mm = 60;
inline constexpr double kPaddleTip_mm = 205;
inline constexpr double kPaddleHalfHeight_mm = 20;
inline constexpr double kPaddleHalfThickness_mm = 6;
inline constexpr double kPaddleLowest_mm = 600;
inline constexpr double kInnerBeam_mm =
    157;  // ahead of the axle; between the beams a 28 mm object cannot hide
inline constexpr double kOuterBeam_mm = 183;
inline constexpr double kPaddleStiffness_n_m = 1250;  // 5 N after 200 ms at 20 mm/s: the manual's 0.5 kg
inline constexpr double kPaddleForce_n = 20;          // the manual's 2 kg
inline constexpr double kPaddlePressed_n = 2;         // the manual's 0.2 kg
inline constexpr double kLiftStiffness_n_m = 6000;
inline constexpr double kLiftForce_n = 40;  // assumed; above what it carries itself

/// The camera hangs in front of the column under the top deck, upright; its pan axis.
inline constexpr double kCameraX_mm = 60;
inline constexpr double kCameraHeight_mm = 950;
inline constexpr double kCameraLens_mm = 35;  // ahead of the axes of pan and tilt

inline constexpr double kBatteryFull_v = 12.9;
inline constexpr double kBatteryEmpty_v = 11.0;
inline constexpr double kBatteryIdle_v_per_h = 0.3;     // assumed
inline constexpr double kBatteryDriving_v_per_h = 0.4;  // assumed, more at 750 mm/s

}  // namespace axon::lab::peoplebot
