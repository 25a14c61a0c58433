// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/tracking.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

namespace axon::peoplebot {
namespace {

using arcos::GripperOrder;
using arcos::RobotState;
using Outcome = MotionStep::Outcome;
using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr double kDegree = std::numbers::pi / 180;

// Looking. Each look overlaps with the next by a quarter of the view.
struct Direction {
    double pan_deg, tilt_deg;
};
constexpr std::array<Direction, 12> kLooks{{{0, -18},
                                            {33, -18},
                                            {-33, -18},
                                            {-66, -18},
                                            {-98, -18},
                                            {98, -18},
                                            {66, -18},
                                            {66, -30},
                                            {33, -30},
                                            {0, -30},
                                            {-33, -30},
                                            {-66, -30}}};
constexpr Duration kCameraPause = milliseconds{350};  // it may have to be sent a command only every 300 ms
constexpr Duration kFirstLook = milliseconds{2500};   // from wherever it looked before
constexpr Duration kCameraDelay = milliseconds{50};   // from the exposure to the last byte
constexpr Duration kCameraSilence = seconds{5};
constexpr double kSmallObject_mm = 40;  // above the table: the middle of one
constexpr double kHorizon_mm = 4000;    // what seems to be farther is taken to be so far

// Driving.
constexpr double kTurning_deg_s = 30;
constexpr double kAhead_deg = 2.5;
constexpr double kSlowest_mm_s = 60;
constexpr double kFastest_mm_s = 400;
constexpr double kFarthestBack_mm = 3000;
constexpr double kFarthestThreshold_mm = 1000;
constexpr double kReaching_mm_s = 40;
constexpr double kClearing_mm_s = 120;
constexpr double kClearing_mm = 350;
constexpr double kBackingOff_mm_s = 150;
constexpr double kBraking_per_s = 0.6;  // speed over the way that is left
constexpr double kReach_mm = 120;       // this near to its place the object is crept up to, table seen or not
constexpr double kLongestReach_mm = 330;
constexpr double kBeyond_mm = 110;  // the estimate may be wrong by so much, not more
constexpr double kDeeper_mm = 35;   // from the outer beam to where even a thin object is held well
constexpr Duration kBlink = milliseconds{700};  // out of sight for longer, the robot waits
constexpr Duration kOutOfSight = milliseconds{2500};
constexpr double kNearEnoughToTrust_mm =
    300;  // the rest of the way is driven by memory when it is out of sight
constexpr double kSonarCone_deg = 35;
constexpr Duration kSonarSilence = seconds{1};
constexpr int kTries = 3;

// The gripper.
constexpr double kPaddlesAboveTable_mm = 40;  // their middle: half their height, and two centimetres of room
constexpr int kPress = 20;    // units of 20 ms: about a kilogram, so that it is still held after it turned
constexpr int kSqueezes = 2;  // what is grasped at its corners turns until its faces lie on the paddles
constexpr Duration kTremor = milliseconds{400};
constexpr Duration kLiftTime = seconds{13};
constexpr Duration kPaddleTime = seconds{10};
constexpr Duration kRested = milliseconds{600};

double turned(double from_deg, double to_deg) {
    return std::remainder(to_deg - from_deg, 360.0);
}

}  // namespace

const char* Tracking::toString(Phase phase) {
    switch (phase) {
        case Phase::Looking:
            return "looking about";
        case Phase::Centring:
            return "looking at the object";
        case Phase::Clearing:
            return "backing away for room";
        case Phase::Turning:
            return "turning towards the object";
        case Phase::Approaching:
            return "approaching";
        case Phase::Reaching:
            return "reaching for the object";
        case Phase::Closing:
            return "closing the gripper";
        case Phase::Lifting:
            return "lifting";
        case Phase::BackingOff:
            return "backing off";
        case Phase::GivingUp:
            return "giving up";
    }
    return "";
}

std::string Tracking::objection(const Request& r, const GraspGeometry& geometry, const RobotState& robot) {
    const double lowest = geometry.lift_top_mm - geometry.lift_travel_mm - kPaddlesAboveTable_mm;
    const double highest = geometry.lift_top_mm - kPaddlesAboveTable_mm;
    if (!(r.table_height_mm >= lowest && r.table_height_mm <= highest))
        return fmt::format("Table Height is {} mm: this gripper reaches from {} to {} mm", r.table_height_mm,
                           lowest, highest);
    if (!(r.back_off_mm >= 0 && r.back_off_mm <= kFarthestBack_mm))
        return fmt::format("Back Off is {} mm: give 0 to {} mm", r.back_off_mm, kFarthestBack_mm);
    if (!(r.velocity_mm_s >= kSlowest_mm_s && r.velocity_mm_s <= kFastest_mm_s))
        return fmt::format("Velocity is {} mm/s: give {} to {} mm/s", r.velocity_mm_s, kSlowest_mm_s,
                           kFastest_mm_s);
    if (!(r.range_threshold_mm >= 0 && r.range_threshold_mm <= kFarthestThreshold_mm))
        return fmt::format("Range Threshold is {} mm: give 0 to {} mm", r.range_threshold_mm,
                           kFarthestThreshold_mm);
    if (robot.gripper.known && !robot.gripper.fitted) return "the robot says that it has no gripper";
    return {};
}

Tracking::Tracking(const Request& request, const GraspGeometry& geometry, TimePoint now)
    : request_(request),
      geometry_(geometry),
      started_(now),
      since_(now),
      standstill_(8, now),
      seen_(now),
      prepared_since_(now),
      moving_(now) {}

void Tracking::reconfigure(double velocity_mm_s, double range_threshold_mm, double back_off_mm) {
    request_.velocity_mm_s = std::clamp(velocity_mm_s, kSlowest_mm_s, kFastest_mm_s);
    request_.range_threshold_mm = std::clamp(range_threshold_mm, 0.0, kFarthestThreshold_mm);
    request_.back_off_mm = std::clamp(back_off_mm, 0.0, kFarthestBack_mm);
}

void Tracking::resume(TimePoint now) {
    since_ = seen_ = prepared_since_ = moving_ = now;
    standstill_.restart(now);
}

void Tracking::enter(Phase phase, TimePoint now) {
    phase_ = phase;
    since_ = moving_ = now;
    entered_ = true;
    ordered_ = false;
    standstill_ = StandstillWatch(phase == Phase::Turning ? 1 : 8, now);
}

void Tracking::giveUp(std::string reason, TimePoint now) {
    reason_ = std::move(reason);
    enter(Phase::GivingUp, now);
}

void Tracking::tryAgain(const std::string& reason, bool clear, TimePoint now) {
    if (++tries_ >= kTries) {
        giveUp(reason, now);
        return;
    }
    next_look_ = 0;
    rounds_ = std::min(rounds_, 1);
    centrings_ = 0;
    enter(clear ? Phase::Clearing : Phase::Looking, now);
}

Tracking::PoseThen Tracking::poseAt(TimePoint then) const {
    const PoseThen* before = &history_.front();
    for (const auto& pose : history_) {
        if (pose.at > then) {
            const double span = std::chrono::duration<double>(pose.at - before->at).count();
            if (span <= 0) return pose;
            const double part = std::chrono::duration<double>(then - before->at).count() / span;
            if (part <= 0) return *before;
            return {then, before->x + part * (pose.x - before->x), before->y + part * (pose.y - before->y),
                    before->heading_deg + part * (pose.heading_deg - before->heading_deg)};
        }
        before = &pose;
    }
    return *before;
}

Tracking::Point Tracking::seenFrom(const RobotState& robot) const {
    if (!target_) return {};
    const double a = robot.heading_deg * kDegree;
    const double dx = target_->x - robot.x_mm;
    const double dy = target_->y - robot.y_mm;
    return {std::cos(a) * dx + std::sin(a) * dy, -std::sin(a) * dx + std::cos(a) * dy};
}

double Tracking::way(const RobotState& robot) const {
    return std::hypot(robot.x_mm - entry_.x, robot.y_mm - entry_.y);
}

void Tracking::look(double pan_deg, double tilt_deg, TimePoint now, Step& step) {
    namespace vcc4 = arcos::vcc4;
    const vcc4::PanTilt to{std::clamp(pan_deg, -vcc4::kMaximumPan_deg, vcc4::kMaximumPan_deg),
                           std::clamp(tilt_deg, vcc4::kMinimumTilt_deg, vcc4::kMaximumTilt_deg)};
    Duration travel = kFirstLook;
    if (looking_) {
        const double time_s =
            std::max(std::abs(to.pan_left_deg - looking_->pan_left_deg) / vcc4::kMaximumPanRate_deg_s,
                     std::abs(to.tilt_up_deg - looking_->tilt_up_deg) / vcc4::kMaximumTiltRate_deg_s);
        travel = std::chrono::duration_cast<Duration>(std::chrono::duration<double>(time_s)) + kCameraPause;
    }
    looking_ = to;
    settled_ = std::max(now, settled_) + travel;
    step.look = to;
}

void Tracking::lookAtTarget(const RobotState& robot, TimePoint now, Step& step) {
    const auto at = seenFrom(robot);
    const double dx = at.x - geometry_.camera_x_mm - geometry_.camera_lens_mm;
    const double down = geometry_.camera_height_mm - request_.table_height_mm - kSmallObject_mm;
    look(std::atan2(at.y, dx) / kDegree, -std::atan2(down, std::hypot(dx, at.y)) / kDegree, now, step);
}

bool Tracking::fresh(const CameraView* view, TimePoint now) {
    if (view == nullptr || !looking_ || now < settled_ || view->taken < settled_ ||
        view->sequence == used_picture_)
        return false;
    used_picture_ = view->sequence;
    return true;
}

bool Tracking::measure(const CameraView& view) {
    const double focal = view.width / 2.0 / std::tan(geometry_.view_deg / 2 * kDegree);
    const auto pose = poseAt(view.taken - kCameraDelay);
    const double pan = looking_->pan_left_deg * kDegree;
    const double tilt = looking_->tilt_up_deg * kDegree;
    std::optional<Point> best;
    double best_error = 0;
    for (const auto& blob : view.blobs) {
        const bool cut = blob.bottom >= view.height - 2;
        // What stands on the table touches it with its lower edge.
        const double left = -((blob.left + blob.right + 1) / 2.0 - view.width / 2.0) / focal;
        const double up = -(blob.bottom + 1 - view.height / 2.0) / focal;
        const double forward = std::cos(tilt) - std::sin(tilt) * up;
        const double z = std::sin(tilt) + std::cos(tilt) * up;
        const double bearing = pan + std::atan2(left, forward);
        const double flat = std::hypot(forward, left);
        const double lens = geometry_.camera_lens_mm * std::cos(tilt);
        const double lens_x = geometry_.camera_x_mm + lens * std::cos(pan);
        const double lens_y = lens * std::sin(pan);
        const double height = geometry_.camera_height_mm + geometry_.camera_lens_mm * std::sin(tilt);
        double range = z < 0 ? flat * (height - request_.table_height_mm) / -z : kHorizon_mm;
        // To its middle, if it is as deep as it is wide.
        range = std::min(range * (1 + blob.width() / focal / 2), kHorizon_mm);
        if (cut && target_) {
            // Its foot is below the picture: only the direction is new.
            range = std::min(range, std::hypot(target_->x - pose.x, target_->y - pose.y) - lens_x);
        }
        const double rx = lens_x + range * std::cos(bearing);
        const double ry = lens_y + range * std::sin(bearing);
        const double a = pose.heading_deg * kDegree;
        const Point at{pose.x + std::cos(a) * rx - std::sin(a) * ry,
                       pose.y + std::sin(a) * rx + std::cos(a) * ry};
        if (!target_) {
            best = at;
            break;  // the largest
        }
        // Of several the one that was followed so far; in angles, as ranges are the less certain.
        const double error = std::abs(turned(std::atan2(at.y - pose.y, at.x - pose.x) / kDegree,
                                             std::atan2(target_->y - pose.y, target_->x - pose.x) / kDegree));
        if (!best || error < best_error) {
            best = at;
            best_error = error;
        }
    }
    if (!best || best_error > 15) return false;
    if (target_) {
        constexpr double kNew = 0.5;
        target_->x += kNew * (best->x - target_->x);
        target_->y += kNew * (best->y - target_->y);
    } else {
        target_ = best;
    }
    return true;
}

void Tracking::prepareGripper(const arcos::GripperState& gripper, TimePoint now, Step& step) {
    switch (preparation_) {
        case Preparation::NotBegun:
            step.gripper.push_back({GripperOrder::Open});
            step.gripper.push_back({GripperOrder::LiftUp});
            preparation_ = Preparation::Raising;
            prepared_since_ = now;
            return;
        case Preparation::Raising: {
            const bool up = gripper.lift_up || (gripper.lift_at_limit && !gripper.lift_down);
            if (now - prepared_since_ > kLiftTime) {
                giveUp(up ? "the paddles do not open" : "the lift does not reach its upper end", now);
                return;
            }
            if (!gripper.open || gripper.paddles_moving || !up || gripper.lift_moving) return;
            // There is no height to be read; the time that the lift moves is all there is.
            const double down = geometry_.lift_top_mm - request_.table_height_mm - kPaddlesAboveTable_mm;
            const auto units = static_cast<int>(std::lround(down / geometry_.lift_mm_s / 0.02));
            if (units > 0) step.gripper.push_back({GripperOrder::LiftCarry, -units});
            lowered_at_ = now + units * milliseconds{20} + milliseconds{300};
            preparation_ = Preparation::Lowering;
            return;
        }
        case Preparation::Lowering:
            if (now >= lowered_at_ && !gripper.lift_moving) preparation_ = Preparation::Ready;
            return;
        case Preparation::Ready:
            return;
    }
}

bool Tracking::stillHolding(const arcos::GripperState& gripper, TimePoint now) {
    if (GripperOperation::holding(gripper)) held_ = now;
    return now - held_ < kTremor;
}

std::optional<std::string> Tracking::danger(const RobotState& robot, double forward, TimePoint now) const {
    if (robot.left_stall || robot.right_stall) return "the motors stalled: something blocks the robot";
    if (forward > 0 && robot.front_bumpers != 0) return "a front bumper is pressed";
    if (forward < 0 && robot.rear_bumpers != 0) return "a rear bumper is pressed";
    if (forward == 0 || request_.range_threshold_mm <= 0) return std::nullopt;
    for (int i = 0; i < RobotState::kSonars; ++i) {
        const auto& sonar = robot.sonars[static_cast<std::size_t>(i)];
        if (sonar.heard == TimePoint{} || now - sonar.heard > kSonarSilence) continue;
        const double off = std::remainder(*sonarDirection_deg(i) - (forward > 0 ? 0 : 180), 360.0);
        if (std::abs(off) > kSonarCone_deg || sonar.range_mm >= request_.range_threshold_mm) continue;
        return fmt::format("sonar {} at {} mm is nearer than the threshold {} mm", i, sonar.range_mm,
                           request_.range_threshold_mm);
    }
    return std::nullopt;
}

Tracking::Step Tracking::step(const RobotState& robot, const CameraView* view, TimePoint now) {
    Step step;
    if (!robot.online) {
        step.outcome = Outcome::Failed;
        step.reason = "the connection to the robot is gone";
        return step;
    }
    if (history_.empty() || history_.back().at < robot.taken) {
        history_.push_back({robot.taken, robot.x_mm, robot.y_mm, robot.heading_deg});
        if (history_.size() > 20) history_.pop_front();
    }
    if (std::exchange(entered_, false)) entry_ = history_.back();
    if (robot.speed_mm_s() != 0 || robot.rotation_deg_s != 0) moving_ = now;
    const bool late = phase_ >= Phase::Closing;
    if (!late && now - started_ > kTimeLimit)
        giveUp(std::string("it took too long; the robot was ") + toString(phase_), now);
    const bool sees = view != nullptr && now - view->taken < kCameraSilence;
    if (!late && !sees && now - started_ > kCameraSilence) giveUp("the camera sends no pictures", now);
    if (phase_ < Phase::Closing) prepareGripper(robot.gripper, now, step);

    switch (phase_) {
        case Phase::Looking:
            stepLooking(robot, view, now, step);
            break;
        case Phase::Centring:
            stepCentring(robot, view, now, step);
            break;
        case Phase::Clearing:
            stepClearing(robot, now, step);
            break;
        case Phase::Turning:
            stepTurning(robot, now, step);
            break;
        case Phase::Approaching:
            stepApproaching(robot, view, now, step);
            break;
        case Phase::Reaching:
            stepReaching(robot, view, now, step);
            break;
        case Phase::Closing:
            stepClosing(robot, now, step);
            break;
        case Phase::Lifting:
            stepLifting(robot, now, step);
            break;
        case Phase::BackingOff:
            stepBackingOff(robot, now, step);
            break;
        case Phase::GivingUp:
            stepGivingUp(robot, now, step);
            break;
    }
    static constexpr std::array<double, 10> kProgress{0.05, 0.1, 0.1, 0.15, 0.2, 0.6, 0.7, 0.8, 0.9, 0.9};
    step.progress = step.outcome == Outcome::Done ? 1 : kProgress[static_cast<std::size_t>(phase_)];
    // Nothing drives in the moment in which the phase changes.
    if (step.outcome != Outcome::Running || entered_) step.forward_mm_s = step.left_deg_s = 0;
    return step;
}

void Tracking::stepLooking(const RobotState& robot, const CameraView* view, TimePoint now, Step& step) {
    if (turn_to_deg_) {
        const double rest = turned(robot.heading_deg, *turn_to_deg_);
        if (robot.table_left || robot.table_right || std::abs(rest) < 4 ||
            standstill_.stuck(turned(entry_.heading_deg, robot.heading_deg), now)) {
            turn_to_deg_.reset();  // as far as it goes
        } else {
            step.left_deg_s = std::clamp(1.5 * rest, -kTurning_deg_s, kTurning_deg_s);
            if (std::abs(step.left_deg_s) < 6) step.left_deg_s = std::copysign(6, rest);
            looking_.reset();
            return;
        }
    }
    if (now - moving_ < kRested) return;
    if (!looking_ || next_look_ == 0) {
        target_.reset();
        next_look_ = 0;
        look(kLooks[0].pan_deg, kLooks[0].tilt_deg, now, step);
        next_look_ = 1;
        return;
    }
    if (!fresh(view, now)) return;
    target_.reset();
    if (measure(*view)) {
        seen_ = now;
        centrings_ = 0;
        enter(Phase::Centring, now);
        return;
    }
    if (next_look_ < kLooks.size()) {
        look(kLooks[next_look_].pan_deg, kLooks[next_look_].tilt_deg, now, step);
        ++next_look_;
        return;
    }
    if (++rounds_ >= 2) {
        giveUp(
            fmt::format("not found: no {} object in sight all around", peoplebot::toString(request_.colour)),
            now);
        return;
    }
    next_look_ = 0;
    turn_to_deg_ = robot.heading_deg + 180;
    standstill_ = StandstillWatch(1, now);
    entry_ = history_.back();
}

void Tracking::stepCentring(const RobotState& robot, const CameraView* view, TimePoint now, Step& step) {
    if (now - moving_ < kRested && centrings_ == 0) return;  // the picture would be of a moving robot
    if (!ordered_) {
        ordered_ = true;
        lookAtTarget(robot, now, step);
        return;
    }
    if (fresh(view, now)) {
        if (measure(*view)) {
            seen_ = now;
            const auto at = seenFrom(robot);
            const double bearing = std::atan2(at.y, at.x) / kDegree;
            if (++centrings_ < 2) {  // the first look from afar may have cut it
                ordered_ = false;
                return;
            }
            enter(std::abs(bearing) > kAhead_deg * 2 ? Phase::Turning : Phase::Approaching, now);
            return;
        }
    }
    if (now - since_ > seconds{6}) tryAgain("lost: the object was seen, but not again", false, now);
}

void Tracking::stepClearing(const RobotState& robot, TimePoint now, Step& step) {
    if (!robot.gripper.open) {
        if (!std::exchange(ordered_, true)) step.gripper.push_back({GripperOrder::Open});
        if (now - since_ > kPaddleTime) giveUp("the paddles do not open", now);
        standstill_.restart(now);
        return;
    }
    // Behind the robot is where it came from.
    if (way(robot) >= kClearing_mm || danger(robot, -1, now) || standstill_.stuck(way(robot), now)) {
        next_look_ = 0;
        enter(Phase::Looking, now);
        return;
    }
    step.forward_mm_s = -kClearing_mm_s;
}

void Tracking::stepTurning(const RobotState& robot, TimePoint now, Step& step) {
    const auto at = seenFrom(robot);
    const double bearing = std::atan2(at.y, at.x) / kDegree;
    if (std::abs(bearing) <= kAhead_deg) {
        centrings_ = 0;
        enter(Phase::Centring, now);
        return;
    }
    if (robot.table_left || robot.table_right) {
        tryAgain("out of reach: the table is too near for turning towards the object", true, now);
        return;
    }
    if (auto why = danger(robot, 0, now)) {
        giveUp(std::move(*why), now);
        return;
    }
    if (robot.front_bumpers != 0 || robot.rear_bumpers != 0) {
        giveUp("a bumper was pressed", now);
        return;
    }
    if (standstill_.stuck(turned(entry_.heading_deg, robot.heading_deg), now)) {
        giveUp("the robot does not turn: are its motors enabled, is it free?", now);
        return;
    }
    step.left_deg_s = std::copysign(std::clamp(1.2 * std::abs(bearing), 6.0, kTurning_deg_s), bearing);
}

void Tracking::stepApproaching(const RobotState& robot, const CameraView* view, TimePoint now, Step& step) {
    if (fresh(view, now) && measure(*view)) seen_ = now;
    const auto at = seenFrom(robot);
    const double bearing = std::atan2(at.y, at.x) / kDegree;
    const double rest = at.x - geometry_.paddles_mm;
    if (now < settled_)
        seen_ = std::max(seen_, now - milliseconds{500});  // not blind, only looking elsewhere
    if (now - seen_ > kOutOfSight && rest > kNearEnoughToTrust_mm) {
        tryAgain("lost: the object went out of sight", false, now);
        return;
    }
    if (preparation_ !=
        Preparation::Ready) {  // nothing is driven into a table with the gripper below its top
        seen_ = now;
        since_ = now;
        standstill_.restart(now);
        return;
    }
    if (auto why = danger(robot, 1, now)) {
        giveUp("out of reach: " + *why, now);
        return;
    }
    if (robot.table_left || robot.table_right || rest <= kReach_mm) {
        enter(Phase::Reaching, now);
        return;
    }
    if (now >= settled_) {
        const double dx = at.x - geometry_.camera_x_mm - geometry_.camera_lens_mm;
        const double down = geometry_.camera_height_mm - request_.table_height_mm - kSmallObject_mm;
        const double tilt = std::max(-std::atan2(down, dx) / kDegree, arcos::vcc4::kMinimumTilt_deg);
        if (std::abs(looking_->tilt_up_deg - tilt) > 6 || std::abs(looking_->pan_left_deg) > 12)
            look(0, tilt, now, step);
    }
    if (now - seen_ > kBlink && rest > kNearEnoughToTrust_mm) {
        standstill_.restart(now);
        return;
    }
    if (std::abs(bearing) > 12) {
        step.left_deg_s = std::clamp(1.2 * bearing, -15.0, 15.0);
        standstill_.restart(now);
        return;
    }
    if (standstill_.stuck(way(robot), now)) {
        giveUp("the robot does not move: are its motors enabled, is it free?", now);
        return;
    }
    step.forward_mm_s = std::clamp(kBraking_per_s * (rest - kReach_mm) + kSlowest_mm_s, kSlowest_mm_s,
                                   request_.velocity_mm_s);
    step.left_deg_s = std::clamp(1.5 * bearing, -12.0, 12.0);
}

void Tracking::stepReaching(const RobotState& robot, const CameraView* view, TimePoint now, Step& step) {
    const auto& gripper = robot.gripper;
    if (fresh(view, now) && measure(*view)) seen_ = now;
    const auto at = seenFrom(robot);
    const double rest = at.x - geometry_.paddles_mm;
    if (gripper.outer_beam && !outer_beam_at_) outer_beam_at_ = way(robot);
    if (!gripper.outer_beam && !gripper.inner_beam) outer_beam_at_.reset();
    if (gripper.inner_beam || (outer_beam_at_ && way(robot) - *outer_beam_at_ >= kDeeper_mm)) {
        enter(Phase::Closing, now);
        return;
    }
    const auto why = danger(robot, 1, now);
    const bool far = way(robot) > kLongestReach_mm || rest < -kBeyond_mm;
    if (why || far || standstill_.stuck(way(robot), now)) {
        if (gripper.outer_beam) {  // as deep as it goes
            enter(Phase::Closing, now);
        } else if (why) {
            giveUp("out of reach: " + *why, now);
        } else {
            tryAgain(far ? "out of reach: nothing came between the paddles where the object was seen"
                         : "out of reach: the robot does not get any nearer",
                     true, now);
        }
        return;
    }
    step.forward_mm_s = kReaching_mm_s;
    const double bearing = std::atan2(at.y, at.x) / kDegree;
    if (!gripper.outer_beam && rest > 20) step.left_deg_s = std::clamp(bearing, -4.0, 4.0);
}

void Tracking::stepClosing(const RobotState& robot, TimePoint now, Step& step) {
    const auto& gripper = robot.gripper;
    if (!ordered_) {
        if (now - moving_ < milliseconds{250}) return;  // what is grabbed is not to be pulled
        ordered_ = true;
        since_ = now;
        if (squeezes_ == 0)
            step.gripper.push_back({GripperOrder::Press, kPress});
        else
            step.gripper.push_back({GripperOrder::Close});
        return;
    }
    const bool done = !gripper.paddles_moving && now - since_ > GripperOperation::kReaction;
    if (!done && now - since_ < kPaddleTime) return;
    if (done && ++squeezes_ < kSqueezes) {
        ordered_ = false;
        return;
    }
    squeezes_ = 0;
    outer_beam_at_.reset();
    if (!done) {
        step.gripper.push_back({GripperOrder::Stop});
        tryAgain("the paddles do not close: is something in the gripper's way?", true, now);
    } else if (!GripperOperation::holding(gripper)) {
        tryAgain("the grip is empty: the paddles closed on nothing", true, now);
    } else {
        holding_ = true;
        held_ = now;
        enter(Phase::Lifting, now);
    }
}

void Tracking::stepLifting(const RobotState& robot, TimePoint now, Step& step) {
    const auto& gripper = robot.gripper;
    if (!std::exchange(ordered_, true)) {
        step.gripper.push_back({GripperOrder::LiftUp});
        return;
    }
    if (!stillHolding(gripper, now)) {
        holding_ = false;
        giveUp("the object slipped out of the grip", now);
        return;
    }
    const bool up =
        (gripper.lift_up || (gripper.lift_at_limit && !gripper.lift_down)) && !gripper.lift_moving;
    if (up && now - since_ > GripperOperation::kReaction) {
        enter(Phase::BackingOff, now);
    } else if (now - since_ > kLiftTime) {
        giveUp("the lift does not reach its upper end", now);
    }
}

void Tracking::stepBackingOff(const RobotState& robot, TimePoint now, Step& step) {
    if (!stillHolding(robot.gripper, now)) {
        holding_ = false;
        giveUp("the object slipped out of the grip", now);
        return;
    }
    const double rest = request_.back_off_mm - way(robot);
    if (rest <= 5) {
        if (now - moving_ < milliseconds{250}) return;
        step.outcome = Outcome::Done;
        return;
    }
    if (auto why = danger(robot, -1, now)) {
        giveUp("holds the object, but cannot back off: " + *why, now);
        return;
    }
    if (standstill_.stuck(way(robot), now)) {
        giveUp("holds the object, but cannot back off: the robot does not move", now);
        return;
    }
    step.forward_mm_s = -std::clamp(1.2 * rest, 40.0, kBackingOff_mm_s);
}

void Tracking::stepGivingUp(const RobotState& robot, TimePoint now, Step& step) {
    const auto& gripper = robot.gripper;
    if (!holding_ && !std::exchange(ordered_, true)) {
        step.gripper.push_back({GripperOrder::LiftStop});
        step.gripper.push_back({GripperOrder::Open});
        return;
    }
    const bool rests = now - moving_ >= milliseconds{250};
    const bool opened = holding_ || gripper.open || now - since_ > kPaddleTime;
    if (!rests && now - since_ < seconds{3}) return;
    if (!opened) return;
    step.outcome = Outcome::Failed;
    step.reason = reason_;
    if (holding_ && !GripperOperation::holding(gripper)) step.reason += "; and the grip is empty";
}

}  // namespace axon::peoplebot
