// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <string>

#include "lab/cyton/geometry.hpp"
#include "lab/device.hpp"

namespace axon::lab {

/// A Cyton Alpha for a model, any number of times with different prefixes. Its origin is on the surface that
/// the arm is screwed to, in the axis of its shoulder roll; theta is where a positive shoulder pitch leans.
/// Joints are those of cyton::kChain, then the right and the left claw; actuators the same without the left
/// claw; the site is the middle of the claws. All geoms are in group 1, touch the world, and neither each
/// other nor other arms.
DeviceModel cytonModel(const std::string& prefix, const DevicePlacement& at);

/// The servos of one arm: takes it to the angles it is told, with no more torque than the servos have.
/// Gravity does not make them sag: MuJoCo 2.2.2 cannot compensate it, so that the bias forces of the arm's
/// own joints are cancelled here. Threads: none; used by whoever steps the data.
class CytonBody {
  public:
    /// What the arm is told and where it is: seven joints in rad, and how far each claw is open, in metres.
    using Positions = std::array<double, cyton::kChannels>;

    /// The parts of a cytonModel().
    explicit CytonBody(const DeviceParts& parts);

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
    const DeviceParts parts_;
    Positions last_{};
    bool moved_before_ = false;
};

}  // namespace axon::lab
