// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>

#include "common/clock.hpp"

namespace axon::lab {

/// Speeds the wheels are to have (set points) or do have (measured): forward and to the left are positive.
struct BodySpeed {
    double forward_mm_s = 0;
    double left_deg_s = 0;

    bool operator==(const BodySpeed&) const = default;
};

/// The limits of one kind of motion. Accelerations count for growing, decelerations for shrinking speed.
struct MotionLimits {
    double top = 0;  // the hardware's; the session cannot raise it
    double speed = 0;
    double acceleration = 0;
    double deceleration = 0;
};

/// What ARCOS's motion commands do to the speeds of a differential drive: ramps within the limits, moves over
/// a distance and to a heading by the odometry, stops. Translation and rotation are independent of each
/// other. I/O-free and without physics: each step() takes what the encoders say and gives the speeds that the
/// wheels are to have now. Not thread-safe.
class MotionControl {
  public:
    /// The PeopleBot's: top speeds of the vendor's parameter file peoplebot-sh.p, working limits of
    /// MobileSim's model of the robot.
    MotionControl();

    MotionLimits& translation() { return translation_.limits; }
    MotionLimits& rotation() { return rotation_.limits; }
    const MotionLimits& translation() const { return translation_.limits; }
    const MotionLimits& rotation() const { return rotation_.limits; }

    void setVelocity(double forward_mm_s);
    void setRotation(double left_deg_s);
    /// Relative to where the odometry is at the next step.
    void move(double forward_mm);
    void turnBy(double left_deg);
    /// Absolute heading in the odometry's frame, by the shorter way.
    void turnTo(double heading_deg);
    /// Ramps both to zero with the set decelerations; an emergency stop that is under way goes on as one.
    void stop();
    /// Ramps both to zero as fast as the drive can.
    void emergencyStop();
    /// At once to zero: motors off, or a stall.
    void halt();

    /// Distance is the signed path so far, heading the accumulated rotation; both by the encoders.
    BodySpeed step(Duration period, double distance_mm, double heading_deg);
    /// The speeds of the last step.
    BodySpeed setPoint() const { return {translation_.now, rotation_.now}; }
    /// What translation is asked for, by its sign: +1 forward, -1 backward, 0 nothing.
    int direction() const;
    bool resting() const;

  private:
    struct Axis {
        MotionLimits limits;
        double now = 0;
        double target = 0;              // speed; unused while a goal is set
        std::optional<double> goal;     // position
        std::optional<double> pending;  // position relative to that of the next step
        bool emergency = false;

        void setSpeed(double speed);
        double step(double seconds, double position, double tolerance);
    };

    Axis translation_;
    Axis rotation_;
    std::optional<double> heading_goal_;  // absolute, resolved at the next step
};

}  // namespace axon::lab
