// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/gripper_operation.hpp"

#include <algorithm>
#include <cctype>
#include <utility>

namespace axon::peoplebot {

using arcos::GripperOrder;
using arcos::GripperState;
using Outcome = MotionStep::Outcome;

std::optional<GripperOperation::Direction> GripperOperation::parseDirection(std::string_view text) {
    std::string lower(text);
    std::transform(lower.begin(), lower.end(), lower.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    if (lower == "up" || lower == "false") return Direction::Up;
    if (lower == "down" || lower == "true") return Direction::Down;
    if (lower == "none" || lower.empty()) return Direction::None;
    return std::nullopt;
}

std::string GripperOperation::objection(const Request& request, const arcos::RobotState& robot) {
    if (request.direction == Direction::None && !request.open)
        return "nothing to do: give Direction up or down, or Open/Close true or false";
    if (robot.gripper.known && !robot.gripper.fitted) return "the robot says that it has no gripper";
    return {};
}

GripperOperation::GripperOperation(const Request& request) {
    if (request.direction == Direction::Down) parts_.push_back(Part::Down);
    if (request.open) parts_.push_back(*request.open ? Part::Open : Part::Close);
    if (request.direction == Direction::Up) parts_.push_back(Part::Up);
}

GripperOperation::Verdict GripperOperation::judge(Part part, const GripperState& gripper, bool rested) {
    switch (part) {
        case Part::Open:
            if (gripper.open && !gripper.paddles_moving) return Verdict::Done;
            return rested ? Verdict::Stuck : Verdict::Moving;
        case Part::Close:
            // "Closed" is no switch but the absence of the others, so the order is given time to show.
            return rested ? gripper.open ? Verdict::Stuck : Verdict::Done : Verdict::Moving;
        case Part::Up:
            if (gripper.lift_up && !gripper.lift_moving) return Verdict::Done;
            if (rested && gripper.lift_at_limit && !gripper.lift_down) return Verdict::Done;
            return rested ? Verdict::Stuck : Verdict::Moving;
        case Part::Down:
            if (gripper.lift_down && !gripper.lift_moving) return Verdict::Done;
            if (rested && gripper.lift_at_limit && !gripper.lift_up) return Verdict::Done;
            // What it holds stands on something.
            if (rested && !gripper.lift_up && holding(gripper)) return Verdict::Done;
            return rested ? Verdict::Stuck : Verdict::Moving;
        case Part::Relieve:
            return rested ? Verdict::Done : Verdict::Moving;
    }
    return Verdict::Stuck;
}

GripperOperation::Step GripperOperation::step(const arcos::RobotState& robot, TimePoint now) {
    const auto fail = [](std::string reason) {
        return Step{
            .outcome = Outcome::Failed, .commands = {{GripperOrder::Halt}}, .reason = std::move(reason)};
    };
    if (!robot.online)
        return Step{.outcome = Outcome::Failed, .reason = "the connection to the robot is gone"};
    const auto& gripper = robot.gripper;
    Step step;
    while (current_ < parts_.size()) {
        const auto part = parts_[current_];
        const bool paddles = part == Part::Open || part == Part::Close;
        step.progress = static_cast<double>(current_) / static_cast<double>(parts_.size());
        if (!std::exchange(ordered_, true)) {
            since_ = moving_ = now;
            if (part == Part::Relieve) {
                step.commands.push_back({GripperOrder::LiftCarry, kRelief});
                return step;
            }
            step.commands.push_back({part == Part::Open    ? GripperOrder::Open
                                     : part == Part::Close ? GripperOrder::Close
                                     : part == Part::Up    ? GripperOrder::LiftUp
                                                           : GripperOrder::LiftDown});
            return step;
        }
        if (paddles ? gripper.paddles_moving : gripper.lift_moving) moving_ = now;
        const bool rested = now - moving_ >= kReaction;
        auto verdict = judge(part, gripper, rested);
        if (verdict == Verdict::Moving && now - since_ < kTimeLimit) return step;
        if (verdict != Verdict::Done && part == Part::Down && holding(gripper) && !gripper.lift_up) {
            // A lift that pushes for as long as this has set its load down as well.
            step.commands.push_back({GripperOrder::LiftStop});
            verdict = Verdict::Done;
        }
        if (verdict != Verdict::Done) {
            const char* what = paddles ? "the paddles" : "the lift";
            const bool error = paddles ? gripper.paddle_error : gripper.lift_error;
            return fail(std::string(what) +
                        (error                       ? " report an error"
                         : verdict == Verdict::Stuck ? " stopped before the end of their way"
                                                     : " are still moving after 15 s") +
                        ": is something in the gripper's way?");
        }
        ++current_;
        ordered_ = false;
        if (part == Part::Down && !gripper.lift_down && !gripper.lift_at_limit)
            parts_.insert(parts_.begin() + static_cast<std::ptrdiff_t>(current_), Part::Relieve);
    }
    step.outcome = Outcome::Done;
    step.progress = 1;
    return step;
}

}  // namespace axon::peoplebot
