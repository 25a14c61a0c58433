// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>

/// The PeopleBot's shape and where its range sensors sit, as its services reckon with them: millimetres and
/// degrees, x forward, y left, origin midway between the wheels. From the vendor's parameter file
/// peoplebot-sh.p; a robot that is built otherwise needs other numbers here.
namespace axon::peoplebot::body {

/// The outline is taken as all that is within kRadius_mm of the line from (0, 0) to (kRear_mm, 0): half the
/// length of 513 mm around the turning axis in front, and as much behind it.
inline constexpr double kRadius_mm = 215;
inline constexpr double kRear_mm = -89;
/// What a turn on the spot sweeps.
inline constexpr double kSwing_mm = kRadius_mm - kRear_mm;

inline constexpr double kTableSensorX_mm = 333;
inline constexpr double kTableSensorY_mm = 233;
inline constexpr double kLaserX_mm = 21;

struct SonarPose {
    double x_mm, y_mm, direction_deg;
};
inline constexpr double kSonarHalfCone_deg = 15;
/// 0 to 7 base front, 8 to 15 base rear, 16 to 23 top front.
inline constexpr std::array<SonarPose, 24> kSonars{{
    {69, 136, 90},     {114, 119, 50},    {148, 78, 30},   {166, 27, 10},     {166, -27, -10},
    {148, -78, -30},   {114, -119, -50},  {69, -136, -90}, {-157, -136, -90}, {-203, -119, -130},
    {-237, -78, -150}, {-255, -27, -170}, {-255, 27, 170}, {-237, 78, 150},   {-203, 119, 130},
    {-157, 136, 90},   {-20, 136, 90},    {24, 119, 50},   {58, 78, 30},      {77, 27, 10},
    {77, -27, -10},    {58, -78, -30},    {24, -119, -50}, {-20, -136, -90},
}};

}  // namespace axon::peoplebot::body
