// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <optional>
#include <string>

#include "robots/arcos/client_session.hpp"

/// The PeopleBot's application: its services (thesis 4.1.2) and what connects them to the Entity Interfacer.
namespace axon::peoplebot {

/// What a motion wants at this moment.
struct MotionStep {
    enum class Outcome { Running, Done, Failed };
    Outcome outcome = Outcome::Running;
    double forward_mm_s = 0;  ///< zero with every outcome but Running
    double left_deg_s = 0;
    double progress = 0;  ///< 0 to 1
    std::string reason;   ///< Failed: for the person who asked
    bool halt = false;    ///< Running: as fast as the motors can, instead of by the ramp of a velocity
};

/// Notices when a robot that was told to move does not: switched off motors, a wheel in the air, a blocked
/// path that no sensor sees. I/O-free; the owner feeds it the way made so far.
class StandstillWatch {
  public:
    static constexpr Duration kPatience = std::chrono::seconds{3};

    StandstillWatch(double least_way, TimePoint now) : least_way_(least_way), since_(now) {}
    /// True when the way has grown by less than least_way for kPatience.
    bool stuck(double way, TimePoint now);
    void restart(TimePoint now) { since_ = now; }

  private:
    double least_way_;
    double way_ = 0;
    TimePoint since_;
};

/// What the application sets in the robot when it connects.
inline constexpr int kAcceleration_mm_s2 = 300;
inline constexpr int kDeceleration_mm_s2 = 600;
inline constexpr int kTurnAcceleration_deg_s2 = 100;

/// Measures how long it takes from an order until the robot's answer shows what it did, while the robot
/// speeds up from rest: an answer with a speed was made no earlier than that speed is reached. I/O-free.
class LatencyWatch {
  public:
    /// Of the virtual robot on the same machine; what it is taken to be before anything is seen.
    static constexpr double kUsual_s = 0.02;
    static constexpr double kMost_s = 0.5;

    /// `acceleration`: the robot's, in the unit of the speeds per second. Nothing is measured of a robot that
    /// moves already.
    LatencyWatch(double acceleration, bool resting) : acceleration_(acceleration), measures_(resting) {}
    /// Of each answer: its speed in the direction that was ordered, and when it arrived. The first call is
    /// when the first order goes out.
    void seen(double speed, TimePoint now);
    double seconds() const { return seconds_.value_or(kUsual_s); }

  private:
    double acceleration_;
    bool measures_;
    std::optional<TimePoint> ordered_;
    std::optional<double> seconds_;
};

/// The service Driving: straight for a distance, at a velocity whose sign is the direction, while every sonar
/// that looks within 45 degrees of the direction of travel, and the laser there, reads at least the range
/// threshold.
///
/// States: driving → settling (the way is made, the robot comes to rest) → done; from both of the first →
/// failed. Fails with the reason on a near reading, a bumper on the side of travel (or one newly pressed on
/// the other), a stall of the motors, sonars that are silent for a second, and a robot that does not move.
/// It stands until the first sonar is heard.
/// Whoever calls sends the robot to a full stop on every end. I/O-free, not thread-safe: what the robot says
/// comes in, a velocity comes out.
class Driving {
  public:
    struct Request {
        double distance_mm = 0;           ///< above zero
        double velocity_mm_s = 200;       ///< negative: backwards
        double range_threshold_mm = 500;  ///< zero: ranges are not looked at
        double speed_limit_mm_s = 800;    ///< kSlowest or more; velocities above it are this one
    };
    static constexpr double kFastest_mm_s = 800;
    static constexpr double kSlowest_mm_s = 20;

    /// Why this cannot be driven, empty if it can.
    static std::string objection(const Request& request);

    Driving(const Request& request, const arcos::RobotState& start, TimePoint now);
    /// On the way too.
    void limitSpeed(double limit_mm_s) { request_.speed_limit_mm_s = std::max(limit_mm_s, kSlowest_mm_s); }
    MotionStep step(const arcos::RobotState& robot, TimePoint now);
    /// After a pause, in which step() is not called.
    void resume(TimePoint now) { standstill_.restart(now); }

    /// In the direction of travel.
    double travelled_mm() const { return travelled_; }
    double remaining_mm() const { return std::max(0.0, request_.distance_mm - travelled_); }

  private:
    std::optional<std::string> obstacle(const arcos::RobotState& robot, TimePoint now);
    MotionStep fail(std::string reason) const;
    double progress() const;

    Request request_;
    const int direction_;
    const double start_x_;
    const double start_y_;
    const double start_heading_rad_;
    const unsigned front_bumpers_at_start_;
    const unsigned rear_bumpers_at_start_;
    const TimePoint begun_;
    bool sensed_ = false;  // by a sonar or the laser that looks ahead, since it began
    StandstillWatch standstill_;
    LatencyWatch latency_;
    double ordered_ = 0;
    double travelled_ = 0;
    bool settling_ = false;
    TimePoint settling_since_{};
};

/// The service Turning: on the spot by an angle, positive to the left. A table sensor that sees a surface
/// cancels it, as do a newly pressed bumper, a stall and a robot that does not turn. States, threads: as
/// Driving.
class Turning {
  public:
    struct Request {
        double angle_deg = 0;            ///< not zero; positive: to the left
        double velocity_deg_s = 30;      ///< above zero
        double speed_limit_deg_s = 100;  ///< kSlowest or more; velocities above it are this one
    };
    static constexpr double kFastest_deg_s = 100;
    static constexpr double kSlowest_deg_s = 5;

    static std::string objection(const Request& request);

    Turning(const Request& request, const arcos::RobotState& start, TimePoint now);
    /// On the way too.
    void limitSpeed(double limit_deg_s) {
        request_.speed_limit_deg_s = std::max(limit_deg_s, kSlowest_deg_s);
    }
    MotionStep step(const arcos::RobotState& robot, TimePoint now);
    void resume(TimePoint now) { standstill_.restart(now); }

    /// Signed as the angle asked for.
    double turned_deg() const { return turned_; }
    double remaining_deg() const { return request_.angle_deg - turned_; }

  private:
    MotionStep fail(std::string reason) const;
    double progress() const;

    Request request_;
    const double start_heading_deg_;
    const unsigned bumpers_at_start_;
    StandstillWatch standstill_;
    LatencyWatch latency_;
    double ordered_ = 0;
    double turned_ = 0;
    bool settling_ = false;
    TimePoint settling_since_{};
};

/// The direction in which a sonar of the PeopleBot looks, in degrees to the left of straight ahead; nothing
/// for numbers that it has not (0 to 7 base front, 8 to 15 base rear, 16 to 23 top front, 24 to 31 top rear).
std::optional<double> sonarDirection_deg(int number);

}  // namespace axon::peoplebot
