// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/motion.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace axon::peoplebot {
namespace {

using arcos::RobotState;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kConeOfTravel_deg = 45;
constexpr Duration kSonarSilence = std::chrono::seconds{1};  // three rounds of an array
constexpr Duration kSettlingPatience = std::chrono::seconds{3};

// Braking follows v^2 = 2 a s with less than the robot's own deceleration, so that it can keep up. What the
// robot says is as old as the latency when the answer reaches the motors, and that answer holds for a cycle.
constexpr double kBraking_mm_s2 = 250;
constexpr double kTurnBraking_deg_s2 = 60;
constexpr double kCycle_s = 0.1;
constexpr double kCrawl_mm_s = 40;
constexpr double kTurnCrawl_deg_s = 5;
constexpr double kArrived_mm = 4;
constexpr double kArrived_deg = 0.6;
constexpr double kResting_mm_s = 5;

/// The speed from which the rest of the way is enough to brake, within [crawl, wished].
double brakingSpeed(double rest, double speed_now, double latency_s, double wished, double braking,
                    double crawl) {
    const double usable = std::max(0.0, rest - speed_now * (latency_s + kCycle_s));
    return std::clamp(std::sqrt(2 * braking * usable), std::min(crawl, wished), wished);
}

/// What a robot that said this speed has reached meanwhile, on its way to the speed that was ordered.
double speedByNow(double said, double ordered, double acceleration, double latency_s) {
    return std::max(said, std::min(said + acceleration * latency_s, ordered));
}

std::string bumperName(unsigned bumpers) {
    std::string names;
    for (int i = 0; i < 5; ++i) {
        if ((bumpers >> static_cast<unsigned>(i) & 1U) != 0)
            names += (names.empty() ? "" : ", ") + std::to_string(i + 1);
    }
    return names;
}

std::optional<std::string> stall(const RobotState& robot) {
    if (!robot.left_stall && !robot.right_stall) return std::nullopt;
    return fmt::format("the {} stalled: something blocks the robot", robot.left_stall && robot.right_stall
                                                                         ? "motors"
                                                                     : robot.left_stall ? "left motor"
                                                                                        : "right motor");
}

std::optional<std::string> absence(const RobotState& robot) {
    if (robot.online) return std::nullopt;
    return "the connection to the robot is gone";
}

}  // namespace

std::optional<double> sonarDirection_deg(int number) {
    static constexpr std::array<double, 8> kFront{90, 50, 30, 10, -10, -30, -50, -90};
    static constexpr std::array<double, 8> kRear{-90, -130, -150, -170, 170, 150, 130, 90};
    if (number < 0 || number >= 32) return std::nullopt;
    const auto in_ring = static_cast<std::size_t>(number % 8);
    return number / 8 % 2 == 0 ? kFront[in_ring] : kRear[in_ring];
}

bool StandstillWatch::stuck(double way, TimePoint now) {
    if (std::abs(way - way_) >= least_way_) {
        way_ = way;
        since_ = now;
    }
    return now - since_ >= kPatience;
}

void LatencyWatch::seen(double speed, TimePoint now) {
    if (!measures_) return;
    if (!ordered_) {
        ordered_ = now;
    } else if (speed > 0) {
        // Longer than the latency where the robot has its speed already or friction held it; never shorter.
        const double passed = std::chrono::duration<double>(now - *ordered_).count();
        seconds_ = std::clamp(passed - speed / acceleration_, 0.0, seconds_.value_or(kMost_s));
    }
}

std::string Driving::objection(const Request& r) {
    if (!(r.distance_mm > 0) || !std::isfinite(r.distance_mm)) {
        return fmt::format(
            "Distance is {} mm: give a distance above 0; the sign of Velocity is the direction",
            r.distance_mm);
    }
    if (!(std::abs(r.velocity_mm_s) >= kSlowest_mm_s && std::abs(r.velocity_mm_s) <= kFastest_mm_s)) {
        return fmt::format("Velocity is {} mm/s: give {} to {} mm/s, negative for backwards", r.velocity_mm_s,
                           kSlowest_mm_s, kFastest_mm_s);
    }
    if (!(r.range_threshold_mm >= 0 && r.range_threshold_mm < arcos::kNoEcho_mm)) {
        return fmt::format("Range Threshold is {} mm: give 0 to {} mm, which is as far as the sonars see",
                           r.range_threshold_mm, arcos::kNoEcho_mm - 1);
    }
    return {};
}

Driving::Driving(const Request& request, const RobotState& start, TimePoint now)
    : request_(request),
      direction_(request.velocity_mm_s < 0 ? -1 : 1),
      start_x_(start.x_mm),
      start_y_(start.y_mm),
      start_heading_rad_(start.heading_deg * kDegree),
      front_bumpers_at_start_(start.front_bumpers),
      rear_bumpers_at_start_(start.rear_bumpers),
      begun_(now),
      standstill_(10, now),
      latency_(kAcceleration_mm_s2, !start.moving) {}

double Driving::progress() const {
    return std::clamp(travelled_ / request_.distance_mm, 0.0, 1.0);
}

MotionStep Driving::fail(std::string reason) const {
    return {.outcome = MotionStep::Outcome::Failed, .progress = progress(), .reason = std::move(reason)};
}

std::optional<std::string> Driving::obstacle(const RobotState& robot, TimePoint now) {
    const unsigned ahead = direction_ > 0 ? robot.front_bumpers : robot.rear_bumpers;
    // A bumper behind may be the reason for this very motion; it only counts when it is hit on the way.
    const unsigned behind = direction_ > 0 ? robot.rear_bumpers & ~rear_bumpers_at_start_
                                           : robot.front_bumpers & ~front_bumpers_at_start_;
    if (ahead != 0)
        return fmt::format("{} bumper {} is pressed", direction_ > 0 ? "front" : "rear", bumperName(ahead));
    if (behind != 0)
        return fmt::format("{} bumper {} was pressed", direction_ > 0 ? "rear" : "front", bumperName(behind));
    if (request_.range_threshold_mm <= 0) return std::nullopt;

    bool heard = false;
    for (int i = 0; i < RobotState::kSonars; ++i) {
        const auto& sonar = robot.sonars[static_cast<std::size_t>(i)];
        const double off = std::remainder(*sonarDirection_deg(i) - (direction_ > 0 ? 0 : 180), 360.0);
        if (std::abs(off) > kConeOfTravel_deg || sonar.heard == TimePoint{} ||
            now - sonar.heard > kSonarSilence)
            continue;
        heard = true;
        if (sonar.range_mm < request_.range_threshold_mm) {
            return fmt::format("sonar {} at {} mm is nearer than the threshold {} mm", i, sonar.range_mm,
                               request_.range_threshold_mm);
        }
    }
    if (direction_ > 0 && robot.laser && now - robot.laser->taken <= kSonarSilence && robot.laser->sees()) {
        heard = true;
        for (std::size_t i = 0; i < robot.laser->ranges_mm.size(); ++i) {
            const double angle = robot.laser->start_deg + static_cast<double>(i) * robot.laser->step_deg;
            const int range = robot.laser->ranges_mm[i];
            if (std::abs(angle) <= kConeOfTravel_deg && range > 0 && range < request_.range_threshold_mm) {
                return fmt::format("the laser's {} mm at {:.0f} deg are nearer than the threshold {} mm",
                                   range, angle, request_.range_threshold_mm);
            }
        }
    }
    sensed_ = sensed_ || heard;
    if (!heard && (sensed_ || now - begun_ > kSonarSilence))
        return "no sonar in the direction of travel was heard for a second: are the sonars switched on?";
    return std::nullopt;
}

MotionStep Driving::step(const RobotState& robot, TimePoint now) {
    if (auto gone = absence(robot)) return fail(std::move(*gone));
    const double dx = robot.x_mm - start_x_;
    const double dy = robot.y_mm - start_y_;
    travelled_ = direction_ * (dx * std::cos(start_heading_rad_) + dy * std::sin(start_heading_rad_));
    const double speed = direction_ * robot.speed_mm_s();

    if (!settling_) {
        if (auto reason = obstacle(robot, now)) return fail(std::move(*reason));
    }
    if (auto reason = stall(robot)) return fail(std::move(*reason));
    if (request_.range_threshold_mm > 0 && !sensed_) {  // as just after the connection
        standstill_.restart(now);
        return {.progress = progress()};
    }

    latency_.seen(speed, now);
    const double rest = request_.distance_mm - travelled_;
    if (!settling_ && rest - speed * latency_.seconds() <= kArrived_mm) {
        settling_ = true;
        settling_since_ = now;
    }
    if (settling_) {
        if (std::abs(robot.speed_mm_s()) < kResting_mm_s)
            return {.outcome = MotionStep::Outcome::Done, .progress = 1};
        if (now - settling_since_ > kSettlingPatience) return fail("the robot does not come to rest");
        return {.progress = progress()};
    }
    if (standstill_.stuck(travelled_, now))
        return fail("the robot does not move: are its motors enabled, is it free?");
    ordered_ = brakingSpeed(
        rest, speedByNow(speed, ordered_, kAcceleration_mm_s2, latency_.seconds()), latency_.seconds(),
        std::min(std::abs(request_.velocity_mm_s), request_.speed_limit_mm_s), kBraking_mm_s2, kCrawl_mm_s);
    return {.forward_mm_s = direction_ * ordered_, .progress = progress()};
}

std::string Turning::objection(const Request& r) {
    if (r.angle_deg == 0 || !std::isfinite(r.angle_deg) || std::abs(r.angle_deg) > 3600) {
        return fmt::format("Angle is {} deg: give -3600 to 3600 deg but not 0; positive is to the left",
                           r.angle_deg);
    }
    if (!(r.velocity_deg_s >= kSlowest_deg_s && r.velocity_deg_s <= kFastest_deg_s)) {
        return fmt::format("Velocity is {} deg/s: give {} to {} deg/s; the sign of Angle is the direction",
                           r.velocity_deg_s, kSlowest_deg_s, kFastest_deg_s);
    }
    return {};
}

Turning::Turning(const Request& request, const RobotState& start, TimePoint now)
    : request_(request),
      start_heading_deg_(start.heading_deg),
      bumpers_at_start_(start.front_bumpers | start.rear_bumpers << 8U),
      standstill_(1, now),
      latency_(kTurnAcceleration_deg_s2, !start.moving) {}

double Turning::progress() const {
    return std::clamp(turned_ / request_.angle_deg, 0.0, 1.0);
}

MotionStep Turning::fail(std::string reason) const {
    return {.outcome = MotionStep::Outcome::Failed, .progress = progress(), .reason = std::move(reason)};
}

MotionStep Turning::step(const RobotState& robot, TimePoint now) {
    if (auto gone = absence(robot)) return fail(std::move(*gone));
    turned_ = robot.heading_deg - start_heading_deg_;
    if (robot.table_left || robot.table_right) {
        return fail(fmt::format("the {} table sensor sees a surface", robot.table_left && robot.table_right
                                                                          ? "left and the right"
                                                                      : robot.table_left ? "left"
                                                                                         : "right"));
    }
    if (((robot.front_bumpers | robot.rear_bumpers << 8U) & ~bumpers_at_start_) != 0)
        return fail("a bumper was pressed");
    if (auto reason = stall(robot)) return fail(std::move(*reason));

    const double direction = request_.angle_deg < 0 ? -1 : 1;
    const double rest = direction * (request_.angle_deg - turned_);
    const double speed = direction * robot.rotation_deg_s;
    latency_.seen(speed, now);
    if (!settling_ && rest - speed * latency_.seconds() <= kArrived_deg) {
        settling_ = true;
        settling_since_ = now;
    }
    if (settling_) {
        if (std::abs(robot.rotation_deg_s) < 1 && !robot.moving)
            return {.outcome = MotionStep::Outcome::Done, .progress = 1};
        if (now - settling_since_ > kSettlingPatience) return fail("the robot does not come to rest");
        return {.progress = progress()};
    }
    if (standstill_.stuck(turned_, now))
        return fail("the robot does not turn: are its motors enabled, is it free?");
    ordered_ = brakingSpeed(rest, speedByNow(speed, ordered_, kTurnAcceleration_deg_s2, latency_.seconds()),
                            latency_.seconds(), std::min(request_.velocity_deg_s, request_.speed_limit_deg_s),
                            kTurnBraking_deg_s2, kTurnCrawl_deg_s);
    return {.left_deg_s = direction * ordered_, .progress = progress()};
}

}  // namespace axon::peoplebot
