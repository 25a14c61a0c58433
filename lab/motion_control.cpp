// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/motion_control.hpp"

#include <algorithm>
#include <cmath>

namespace axon::lab {
namespace {

constexpr double kMoveTolerance_mm = 2;
constexpr double kHeadingTolerance_deg = 0.5;
constexpr double kEmergencyFactor = 4;  // the drive brakes this much harder than its working deceleration

double approach(double from, double to, double step) {
    return from < to ? std::min(from + step, to) : std::max(from - step, to);
}

}  // namespace

MotionControl::MotionControl() {
    translation_.limits = {.top = 2200, .speed = 750, .acceleration = 300, .deceleration = 600};
    rotation_.limits = {.top = 500, .speed = 100, .acceleration = 100, .deceleration = 100};
}

void MotionControl::Axis::setSpeed(double speed) {
    goal.reset();
    pending.reset();
    emergency = false;
    const double limit = std::min(limits.speed, limits.top);
    target = std::clamp(speed, -limit, limit);
}

double MotionControl::Axis::step(double seconds, double position, double tolerance) {
    if (pending) goal = position + *pending;
    pending.reset();
    if (goal) {
        const double rest = *goal - position;
        const double fastest =
            std::min({limits.speed, limits.top, std::sqrt(2 * limits.deceleration * std::abs(rest))});
        target = std::abs(rest) < tolerance ? 0 : std::copysign(fastest, rest);
        if (std::abs(rest) < tolerance && now == 0) goal.reset();
    }
    // Through zero first, with the deceleration, when the direction changes.
    const bool shrinking = std::abs(target) < std::abs(now) || target * now < 0;
    const double rate =
        shrinking ? limits.deceleration * (emergency ? kEmergencyFactor : 1) : limits.acceleration;
    now = approach(now, target * now < 0 ? 0 : target, rate * seconds);
    if (emergency && now == 0) emergency = false;
    return now;
}

void MotionControl::setVelocity(double forward_mm_s) {
    translation_.setSpeed(forward_mm_s);
}

void MotionControl::setRotation(double left_deg_s) {
    heading_goal_.reset();
    rotation_.setSpeed(left_deg_s);
}

void MotionControl::move(double forward_mm) {
    translation_.setSpeed(0);
    translation_.pending = forward_mm;
}

void MotionControl::turnBy(double left_deg) {
    setRotation(0);
    rotation_.pending = left_deg;
}

void MotionControl::turnTo(double heading_deg) {
    setRotation(0);
    heading_goal_ = heading_deg;
}

void MotionControl::stop() {
    const bool translation = translation_.emergency;
    const bool rotation = rotation_.emergency;
    setVelocity(0);
    setRotation(0);
    translation_.emergency = translation;
    rotation_.emergency = rotation;
}

void MotionControl::emergencyStop() {
    stop();
    translation_.emergency = rotation_.emergency = true;
}

void MotionControl::halt() {
    stop();
    translation_.now = rotation_.now = 0;
}

BodySpeed MotionControl::step(Duration period, double distance_mm, double heading_deg) {
    const double seconds = std::chrono::duration<double>(period).count();
    if (heading_goal_) {
        rotation_.pending = std::remainder(*heading_goal_ - heading_deg, 360.0);
        heading_goal_.reset();
    }
    return {translation_.step(seconds, distance_mm, kMoveTolerance_mm),
            rotation_.step(seconds, heading_deg, kHeadingTolerance_deg)};
}

int MotionControl::direction() const {
    const double wanted = translation_.pending ? *translation_.pending : translation_.target;
    const double sign = wanted != 0 ? wanted : translation_.now;
    return sign > 0 ? 1 : sign < 0 ? -1 : 0;
}

bool MotionControl::resting() const {
    return translation_.now == 0 && rotation_.now == 0 && translation_.target == 0 && rotation_.target == 0 &&
           !translation_.pending && !translation_.goal && !rotation_.pending && !rotation_.goal &&
           !heading_goal_;
}

}  // namespace axon::lab
