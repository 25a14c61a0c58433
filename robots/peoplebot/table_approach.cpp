// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/table_approach.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace axon::peoplebot {
namespace {

using Outcome = MotionStep::Outcome;

constexpr double kSonarCone_deg = 35;
constexpr Duration kSonarSilence = std::chrono::seconds{1};
constexpr double kSquaring_mm_s = 30;
constexpr double kSquaring_deg_s = 6;
constexpr double kMostSquaring_deg = 40;
constexpr double kReaching_mm_s = 50;
constexpr double kSlow_mm_s = 100;  // a table sensor is believed within a packet: a centimetre at this speed
constexpr Duration kSettling = std::chrono::milliseconds{300};

}  // namespace

std::string TableApproach::objection(const Request& r) {
    if (!(r.distance_mm > 0 && r.distance_mm <= 5000))
        return fmt::format("Distance is {} mm: give 1 to 5000 mm", r.distance_mm);
    if (!(r.velocity_mm_s >= kSlowest_mm_s && r.velocity_mm_s <= kFastest_mm_s))
        return fmt::format("Velocity is {} mm/s: give {} to {} mm/s", r.velocity_mm_s, kSlowest_mm_s,
                           kFastest_mm_s);
    if (!(r.reach_mm >= 0 && r.reach_mm <= 320))
        return fmt::format("Reach is {} mm: give 0 to 320 mm", r.reach_mm);
    if (!(r.range_threshold_mm >= 0 && r.range_threshold_mm <= kFarthestThreshold_mm))
        return fmt::format("Range Threshold is {} mm: give 0 to {} mm", r.range_threshold_mm,
                           kFarthestThreshold_mm);
    return {};
}

TableApproach::TableApproach(const Request& request, const arcos::RobotState& start, TimePoint now)
    : request_(request),
      start_x_(start.x_mm),
      start_y_(start.y_mm),
      phase_x_(start.x_mm),
      phase_y_(start.y_mm),
      phase_heading_(start.heading_deg),
      since_(now),
      standstill_(6, now) {}

void TableApproach::reconfigure(double velocity_mm_s, double range_threshold_mm) {
    request_.velocity_mm_s = std::clamp(velocity_mm_s, kSlowest_mm_s, kFastest_mm_s);
    request_.range_threshold_mm = std::clamp(range_threshold_mm, 0.0, kFarthestThreshold_mm);
}

void TableApproach::enter(Phase phase, const arcos::RobotState& robot, TimePoint now) {
    phase_ = phase;
    phase_x_ = robot.x_mm;
    phase_y_ = robot.y_mm;
    phase_heading_ = robot.heading_deg;
    since_ = now;
    standstill_ = StandstillWatch(phase == Phase::Squaring ? 1 : 6, now);
}

MotionStep TableApproach::fail(std::string reason) const {
    return {.outcome = Outcome::Failed, .reason = std::move(reason)};
}

MotionStep TableApproach::step(const arcos::RobotState& robot, TimePoint now) {
    if (!robot.online) return fail("the connection to the robot is gone");
    travelled_ = std::hypot(robot.x_mm - start_x_, robot.y_mm - start_y_);
    const double way = std::hypot(robot.x_mm - phase_x_, robot.y_mm - phase_y_);
    if (robot.front_bumpers != 0) return fail("a front bumper is pressed");
    if (robot.left_stall || robot.right_stall) return fail("the motors stalled: something blocks the robot");
    if (request_.range_threshold_mm > 0 && phase_ != Phase::Settling) {
        for (int i = 0; i < arcos::RobotState::kSonars; ++i) {
            const auto& sonar = robot.sonars[static_cast<std::size_t>(i)];
            if (sonar.heard == TimePoint{} || now - sonar.heard > kSonarSilence) continue;
            if (std::abs(*sonarDirection_deg(i)) > kSonarCone_deg ||
                sonar.range_mm >= request_.range_threshold_mm)
                continue;
            return fail(fmt::format("sonar {} at {} mm is nearer than the threshold {} mm", i, sonar.range_mm,
                                    request_.range_threshold_mm));
        }
    }
    const bool both = robot.table_left && robot.table_right;
    MotionStep step;
    switch (phase_) {
        case Phase::Driving:
            step.progress = std::min(0.7, 0.7 * way / request_.distance_mm);
            if (robot.table_left || robot.table_right) {
                enter(Phase::Squaring, robot, now);
                return step;
            }
            if (way >= request_.distance_mm)
                return fail(fmt::format("no table within {} mm", request_.distance_mm));
            if (standstill_.stuck(way, now))
                return fail("the robot does not move: are its motors enabled, is it free?");
            step.forward_mm_s = std::min(request_.velocity_mm_s, kSlow_mm_s);
            if (way < request_.distance_mm / 3) step.forward_mm_s = request_.velocity_mm_s;
            return step;
        case Phase::Squaring: {
            step.progress = 0.8;
            if (both) {
                enter(Phase::Reaching, robot, now);
                return step;
            }
            const double turned = robot.heading_deg - phase_heading_;
            if (std::abs(turned) > kMostSquaring_deg || way > 300)
                return fail("this is no straight edge: only one table sensor sees it");
            if (standstill_.stuck(way * 0.2 + std::abs(turned), now))
                return fail("the robot does not move: are its motors enabled, is it free?");
            // The side that sees the table stays where it is, roughly, and the other one comes up.
            if (robot.table_left) step.left_deg_s = kSquaring_deg_s;
            if (robot.table_right) step.left_deg_s = -kSquaring_deg_s;
            step.forward_mm_s = kSquaring_mm_s;
            return step;
        }
        case Phase::Reaching:
            step.progress = 0.9;
            if (way >= request_.reach_mm - 4) {
                enter(Phase::Settling, robot, now);
                return step;
            }
            if (standstill_.stuck(way, now)) return fail("the robot does not get far enough over the table");
            step.forward_mm_s = kReaching_mm_s;
            return step;
        case Phase::Settling:
            step.progress = 1;
            if (std::abs(robot.speed_mm_s()) > 3) since_ = now;
            if (now - since_ >= kSettling) step.outcome = Outcome::Done;
            return step;
    }
    return step;
}

}  // namespace axon::peoplebot
