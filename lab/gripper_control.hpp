// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>

#include "common/clock.hpp"
#include "robots/arcos/gripper.hpp"

namespace axon::lab {

/// What the gripper's body senses.
struct GripperReadings {
    double left_paddle_mm = 0;  ///< of its inner face from the middle
    double right_paddle_mm = 0;
    double lift_mm = 0;  ///< above its lower limit
    bool left_pressed = false;
    bool right_pressed = false;
    bool outer_beam_broken = false;
    bool inner_beam_broken = false;
    bool lift_blocked = false;  ///< the motor pushes with all it has
};

/// What its motors are to do now.
struct GripperSpeeds {
    double paddles_mm_s = 0;  ///< of each paddle; positive opens
    double lift_mm_s = 0;     ///< positive is up

    bool operator==(const GripperSpeeds&) const = default;
};

/// What the controller does with GRIPPER commands: paddles and lift at a constant speed until a limit switch,
/// until both paddles press on something and the grasp time after that is over, until they are stopped, or
/// for the time of a carry. A lift that is blocked stops and reports an error until its next order. I/O-free,
/// not thread-safe.
class GripperControl {
  public:
    static constexpr double kOpening_mm = 107.5;  ///< of each paddle from the middle
    static constexpr double kLift_mm = 190;
    static constexpr double kSpeed_mm_s = 20;
    static constexpr Duration kTimeUnit = std::chrono::milliseconds{20};
    static constexpr int kGraspTime = 10;  ///< in kTimeUnit, when no Press has changed it

    /// Unknown orders are refused.
    bool order(int number);
    /// GRIPPERVAL: taken only right after Press or LiftCarry, otherwise refused.
    bool value(int value);
    bool awaitsValue() const { return awaits_value_; }
    /// Anything else was ordered: a value that comes now is not this gripper's.
    void forgetValue() { awaits_value_ = false; }
    void halt();

    GripperSpeeds step(Duration period, const GripperReadings& readings);

    arcos::GripperSwitches switches() const { return switches_; }
    arcos::GripState state() const { return state_; }
    int graspTime() const { return grasp_time_; }

  private:
    void close();

    int paddles_ = 0;  // +1 opening, -1 closing
    int lift_ = 0;
    std::optional<Duration> pressing_;    // the rest of the grasp time
    std::optional<Duration> lift_limit_;  // the rest of a carry
    int grasp_time_ = kGraspTime;
    bool awaits_value_ = false;
    bool value_is_carry_ = false;
    bool lift_error_ = false;
    arcos::GripperSwitches switches_;
    arcos::GripState state_;
};

}  // namespace axon::lab
