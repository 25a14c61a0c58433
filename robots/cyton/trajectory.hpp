// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "robots/cyton/servo_gate.hpp"

namespace axon::cyton {

/// A way through postures from rest to rest: all joints move together, begin and end softly (the fifth-order
/// polynomial of least jerk), none faster than its part of its highest rate nor with more than kAcceleration.
class Trajectory {
  public:
    static constexpr double kAcceleration_rad_s2 =
        6;  // assumed; a third of what the weakest servo does unloaded

    /// `path`: at least one posture, straight lines between them. `speed`: part of each joint's highest rate,
    /// above 0, at most 1. A way of no length takes no time.
    Trajectory(std::vector<Posture> path, double speed);

    double duration_s() const { return duration_s_; }
    /// How fast its time must pass for the way to be played `times` as fast as it was planned: less than
    /// `times` where a joint would be faster than its highest rate, or gain speed faster than kAcceleration.
    double paceAt(double times) const;
    /// At that time from the start; before it the first posture, after the end the last.
    Posture at(double time_s) const;
    const Posture& end() const { return path_.back(); }

  private:
    double durationAt(double speed) const;

    std::vector<Posture> path_;
    std::vector<double> reached_;  // for each posture, the part of the whole way, 0 to 1
    double speed_;
    double way_s_ = 0;  // at highest rates
    double duration_s_ = 0;
};

/// One part of a motion, and what a person is told about it.
struct Leg {
    std::string name;
    Trajectory way;
    double rest_s = 0;         ///< afterwards: servos lag behind their pulses
    bool keeps_speed = false;  ///< played as it was planned, whatever speed the others are played at
};

/// Plays legs one after the other. I/O-free: time comes in, postures come out. A pause lets the motion run
/// out and start again within kRamp, along its way, and so another speed is taken up; rests stay as long as
/// they are.
class Playback {
  public:
    static constexpr double kRamp_s = 0.2;

    explicit Playback(std::vector<Leg> legs);

    struct Step {
        Posture posture;      ///< where to be after this time
        std::size_t leg = 0;  ///< of those given
        double progress = 0;  ///< 0 to 1, by time
        bool done = false;
        bool resting = false;  ///< paused, and run out
    };
    /// `times`: that many times as fast as the legs were planned, above 0; not for legs that keep their
    /// speed.
    Step advance(double time_s, bool paused, double times = 1);

    const std::vector<Leg>& legs() const { return legs_; }
    double duration_s() const { return total_s_; }

  private:
    const std::vector<Leg> legs_;
    double total_s_ = 0;
    double before_s_ = 0;  // of the legs that are done
    double gone_s_ = 0;    // of the present one
    double going_ = 1;     // 0 while paused
    double pace_ = 1;      // of the present leg
    std::size_t leg_ = 0;
};

/// The longest time, in seconds, that one of the servos needs from one posture to the other at its highest
/// rate.
double leastTime_s(const Posture& from, const Posture& to);

}  // namespace axon::cyton
