// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <string>

#include "lab/cyton_geometry.hpp"

// MuJoCo's own names; its header stays out of ours.
using mjModel = struct mjModel_;
using mjData = struct mjData_;

namespace axon::lab {

/// A Cyton Alpha as whole sections of MJCF (<worldbody>, <actuator>, <equality>), to be put directly below
/// <mujoco>, any number of times with different prefixes; the compiler must count in degrees. The origin
/// (metres) is on the surface that the arm is screwed to, in the axis of its shoulder roll; theta (degrees)
/// is where a positive shoulder pitch leans. Joints are called prefix + cyton::kChain[i].name and prefix +
/// "claw_right" / "claw_left"; the body that moves with the last joint is prefix + "hand", the middle of the
/// claws the site prefix + "tcp". All geoms are in group 1, touch the world, and neither each other nor other
/// arms.
std::string cytonMjcf(const std::string& prefix, double x, double y, double z, double theta);

/// The servos of one arm: takes it to the angles it is told, with no more torque than the servos have.
/// Gravity does not make them sag: MuJoCo 2.2.2 cannot compensate it, so that the bias forces of the arm's
/// own joints are cancelled here. Threads: none; used by whoever steps the data. Keeps both pointers, owns
/// neither.
class CytonBody {
  public:
    /// What the arm is told and where it is: seven joints in rad, and how far each claw is open, in metres.
    using Positions = std::array<double, cyton::kChannels>;

    /// Throws std::invalid_argument if the model has no arm with this prefix.
    CytonBody(const mjModel* model, mjData* data, const std::string& prefix);

    /// Call it before each mj_step, also when the targets stay; values beyond the limits are clamped.
    void setTargets(const Positions& targets);
    /// Where the arm really is: for tests and pictures, the real one does not tell.
    Positions positions() const;
    /// Of the middle of the claws, in the world, in metres.
    std::array<double, 3> graspPoint() const;
    /// Puts the arm there at once, at rest; for the start of a world. mj_forward is the caller's.
    void place(const Positions& positions);

    /// Where the vendor's software parks the arm.
    static Positions home();

  private:
    const mjModel* model_;
    mjData* data_;
    std::array<int, cyton::kChannels + 1> joints_{};  // the seven, claw_right, claw_left
    std::array<int, cyton::kChannels> actuators_{};
    int site_ = -1;
    Positions last_{};
    bool moved_before_ = false;
};

}  // namespace axon::lab
