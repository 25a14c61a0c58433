// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "robots/peoplebot/motion.hpp"

namespace axon::peoplebot {

/// The service Approach Table: drives up to a table's edge and squares up to it, so that what the gripper
/// holds is above the table and can be put down.
///
/// Straight on until a table sensor sees the table, turning towards the side that does not see it yet until
/// both do, then the reach further. Fails with the reason when no table is seen within the distance, and on
/// what the other motions fail on: a near reading of a sonar ahead, a front bumper, a stall, no motion.
/// I/O-free, not thread-safe.
class TableApproach {
  public:
    struct Request {
        double distance_mm = 1500;  ///< at most so far until a table is seen
        double velocity_mm_s = 150;
        double reach_mm =
            230;  ///< further on, under the table, after both sensors saw it: the gripper is over the base
        double range_threshold_mm = 150;  ///< zero: ranges are not looked at
    };
    static constexpr double kFastest_mm_s = 300;
    static constexpr double kSlowest_mm_s = 20;
    static constexpr double kFarthestThreshold_mm = 1000;

    static std::string objection(const Request& request);

    TableApproach(const Request& request, const arcos::RobotState& start, TimePoint now);
    /// On the way too; within what objection() lets pass.
    void reconfigure(double velocity_mm_s, double range_threshold_mm);
    MotionStep step(const arcos::RobotState& robot, TimePoint now);
    void resume(TimePoint now) { standstill_.restart(now); }

    double travelled_mm() const { return travelled_; }

  private:
    enum class Phase { Driving, Squaring, Reaching, Settling };
    MotionStep fail(std::string reason) const;
    void enter(Phase phase, const arcos::RobotState& robot, TimePoint now);

    Request request_;
    Phase phase_ = Phase::Driving;
    double start_x_;
    double start_y_;
    double phase_x_;
    double phase_y_;
    double phase_heading_;
    TimePoint since_;
    StandstillWatch standstill_;
    double travelled_ = 0;
};

}  // namespace axon::peoplebot
