// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/wander.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace axon::peoplebot {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr double kFree_mm = 500;
constexpr Duration kPatience = seconds{10};
constexpr Duration kSilence = seconds{1};
constexpr double kFavourFrom_mm = 1000;
constexpr double kFavourUntil_mm = 1300;
constexpr double kEqual_mm = 100;
constexpr double kDrift_deg_s = 8;
constexpr double kBacking_mm = 250;
constexpr double kBacking_mm_s = 120;
constexpr double kTurning_deg_s = 40;
constexpr double kTurnCrawl_deg_s = 15;
constexpr Duration kStallPause =
    milliseconds{700};  // the robot itself drops commands for 500 ms after a stall
constexpr double kRearMargin_mm = 120;

double secondsOf(Duration time) {
    return std::chrono::duration<double>(time).count();
}

}  // namespace

std::shared_ptr<const fuzzy::Engine> loadWanderRules(const std::filesystem::path& file) {
    auto rules = std::make_shared<fuzzy::Engine>(fuzzy::Engine::load(file));
    rules->require({"left", "front", "right", "favour"}, {"speed", "turn"});
    return rules;
}

double speedThatStopsWithin(double clearance_mm) {
    // v^2 = 2 a s with less than the robot's deceleration of 600 mm/s2, after 0.35 s in which nothing
    // happens: a round of the sonars.
    constexpr double kBraking_mm_s2 = 450;
    constexpr double kBlind_s = 0.35;
    constexpr double kMargin_mm = 60;
    const double room = std::max(0.0, clearance_mm - kMargin_mm);
    const double blind = kBraking_mm_s2 * kBlind_s;
    return std::sqrt(blind * blind + 2 * kBraking_mm_s2 * room) - blind;
}

std::string Wander::objection(const Request& r) {
    if (!(r.velocity_mm_s >= kSlowest_mm_s && r.velocity_mm_s <= kFastest_mm_s))
        return fmt::format("Velocity is {} mm/s: give {} to {} mm/s", r.velocity_mm_s, kSlowest_mm_s,
                           kFastest_mm_s);
    if (!(r.duration_s >= 0 && r.duration_s <= 86400))
        return fmt::format("Duration is {} s: give up to 86400 s, or 0 to wander until it is stopped",
                           r.duration_s);
    return {};
}

Wander::Wander(const Request& request, std::shared_ptr<const fuzzy::Engine> rules,
               const arcos::RobotState& start, TimePoint now)
    : request_(request),
      rules_(std::move(rules)),
      chance_(request.seed),
      started_(now),
      state_since_(now),
      silent_since_(now),
      last_x_(start.x_mm),
      last_y_(start.y_mm),
      anchor_x_(start.x_mm),
      anchor_y_(start.y_mm),
      anchored_(now),
      next_drift_(now) {}

void Wander::resume(TimePoint now) {
    anchored_ = state_since_ = silent_since_ = now;
}

double Wander::random(double least, double most) {
    // Not std::uniform_real_distribution, whose numbers differ between libraries.
    return least + (most - least) * static_cast<double>(chance_() - std::mt19937::min()) /
                       static_cast<double>(std::mt19937::max() - std::mt19937::min());
}

double Wander::progress(TimePoint now) const {
    return request_.duration_s > 0 ? std::clamp(secondsOf(now - started_) / request_.duration_s, 0.0, 1.0)
                                   : 0;
}

MotionStep Wander::fail(std::string reason) const {
    return {.outcome = MotionStep::Outcome::Failed, .reason = std::move(reason)};
}

MotionStep Wander::step(const arcos::RobotState& robot, TimePoint now) {
    if (!robot.online) return fail("the connection to the robot is gone");
    surroundings_.update(robot);
    const auto room = surroundings_.clearance();
    travelled_ += std::hypot(robot.x_mm - last_x_, robot.y_mm - last_y_);
    last_x_ = robot.x_mm;
    last_y_ = robot.y_mm;
    if (room.heard) silent_since_ = now;
    if (now - silent_since_ > kSilence)
        return fail("neither sonars nor laser were heard for a second: are they switched on?");
    if (std::hypot(robot.x_mm - anchor_x_, robot.y_mm - anchor_y_) > kFree_mm) {
        anchor_x_ = robot.x_mm;
        anchor_y_ = robot.y_mm;
        anchored_ = now;
        tries_ = 0;
    }
    if (request_.duration_s > 0 && secondsOf(now - started_) >= request_.duration_s &&
        state_ != State::Settling) {
        state_ = State::Settling;
        state_since_ = now;
    }
    switch (state_) {
        case State::Wandering:
            return wander(robot, room, now);
        case State::Waiting:
            if (now - state_since_ < kStallPause) return {.progress = progress(now), .halt = robot.moving};
            state_ = State::Backing;
            state_since_ = now;
            return {.progress = progress(now)};
        case State::Backing:
            return back(robot, room, now);
        case State::Turning:
            return turn(robot, room, now);
        case State::Settling:
            break;
    }
    if (!robot.moving || now - state_since_ > seconds{2})
        return {.outcome = MotionStep::Outcome::Done, .progress = 1};
    return {.progress = progress(now)};
}

MotionStep Wander::recover(const arcos::RobotState& robot, const Clearance& room, State first,
                           TimePoint now) {
    ++recoveries_;
    if (++tries_ > kTries) {
        return fail(fmt::format(
            "the robot cannot get free: {} attempts to back off and turn away brought it nowhere", kTries));
    }
    bumpers_ = robot.front_bumpers | robot.rear_bumpers << 8U;
    escape_direction_ = robot.rear_bumpers != 0 && robot.front_bumpers == 0 ? 1 : -1;
    anchored_ = now;
    state_ = first;
    state_since_ = now;
    if (first == State::Turning) beginTurn(robot, room, now);
    // At once, not with the ramp of a velocity: what is touched or overhead is near.
    return {.progress = progress(now), .halt = first == State::Waiting};
}

void Wander::chooseFavour(const Clearance& room) {
    if (room.front > kFavourUntil_mm) favour_ = 0;
    if (room.front > kFavourFrom_mm || favour_ != 0) return;
    const double difference = room.left - room.right;
    favour_ = std::abs(difference) < kEqual_mm ? (random(0, 1) < 0.5 ? -1 : 1) : (difference > 0 ? 1 : -1);
}

MotionStep Wander::wander(const arcos::RobotState& robot, const Clearance& room, TimePoint now) {
    if (robot.front_bumpers != 0 || robot.rear_bumpers != 0 || robot.left_stall || robot.right_stall ||
        robot.table_left || robot.table_right)
        return recover(robot, room, State::Waiting, now);
    if (now - anchored_ > kPatience)
        return recover(robot, room, room.swing > 0 ? State::Turning : State::Backing, now);
    chooseFavour(room);
    const auto wish = rules_->evaluate(std::array{room.left, room.front, room.right, favour_});
    double speed = request_.velocity_mm_s * std::clamp(wish[0], 0.0, 100.0) / 100;
    double turn = wish[1];
    if (favour_ == 0 && std::min(room.left, room.right) > 500) {
        if (now >= next_drift_) {
            drift_deg_s_ = random(-kDrift_deg_s, kDrift_deg_s);
            next_drift_ = now + milliseconds{static_cast<int>(random(3000, 8000))};
        }
        turn += drift_deg_s_;
    }
    speed = std::min(speed, speedThatStopsWithin(room.front));
    // Where a turn on the spot would touch, the robot first goes where there is room: on, else back.
    if (room.swing < 15 && speed < 60 && room.rear > kBacking_mm)
        return recover(robot, room, State::Backing, now);
    return {.forward_mm_s = speed, .left_deg_s = turn, .progress = progress(now)};
}

MotionStep Wander::back(const arcos::RobotState& robot, const Clearance& room, TimePoint now) {
    const double way = std::hypot(robot.x_mm - anchor_x_, robot.y_mm - anchor_y_);
    const unsigned behind = escape_direction_ < 0 ? robot.rear_bumpers : robot.front_bumpers;
    const double ahead = escape_direction_ < 0 ? room.rear : room.front;
    const double made = secondsOf(now - state_since_) * kBacking_mm_s;
    const bool again = (robot.left_stall || robot.right_stall) && made > 60;
    if (behind != 0 || again || ahead < kRearMargin_mm || made >= kBacking_mm || way > kFree_mm) {
        state_ = State::Turning;
        state_since_ = now;
        beginTurn(robot, room, now);
        return {.progress = progress(now)};
    }
    return {.forward_mm_s =
                escape_direction_ * std::min(kBacking_mm_s, std::max(40.0, speedThatStopsWithin(ahead))),
            .progress = progress(now)};
}

void Wander::beginTurn(const arcos::RobotState& robot, const Clearance& room, TimePoint /*now*/) {
    turned_from_deg_ = robot.heading_deg;
    double side = favour_;
    if (side == 0 || tries_ > 1) {
        side = std::abs(room.left - room.right) < kEqual_mm || tries_ > 2 ? (random(0, 1) < 0.5 ? -1 : 1)
                                                                          : (room.left > room.right ? 1 : -1);
    }
    turn_by_deg_ = side * random(80, 170);
    favour_ = 0;
}

MotionStep Wander::turn(const arcos::RobotState& robot, const Clearance& room, TimePoint now) {
    const double rest = turn_by_deg_ - (robot.heading_deg - turned_from_deg_);
    const unsigned fresh = (robot.front_bumpers | robot.rear_bumpers << 8U) & ~bumpers_;
    const bool blocked =
        fresh != 0 || ((robot.left_stall || robot.right_stall) && now - state_since_ > seconds{1});
    if (blocked) return recover(robot, room, State::Waiting, now);
    if (rest * turn_by_deg_ <= 0 || std::abs(rest) < 5 || now - state_since_ > kPatience) {
        state_ = State::Wandering;
        state_since_ = anchored_ = now;
        bumpers_ = 0;
        return {.progress = progress(now)};
    }
    return {.left_deg_s = std::copysign(std::clamp(std::abs(rest), kTurnCrawl_deg_s, kTurning_deg_s), rest),
            .progress = progress(now)};
}

}  // namespace axon::peoplebot
