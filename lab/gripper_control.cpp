// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/gripper_control.hpp"

#include <algorithm>
#include <cstdlib>

namespace axon::lab {
namespace {

using arcos::GripperOrder;

constexpr double kSwitch_mm = 1.5;  // this near to its limit a paddle or the lift presses the switch

}  // namespace

void GripperControl::close() {
    paddles_ = -1;
    pressing_.reset();
}

void GripperControl::halt() {
    paddles_ = lift_ = 0;
    lift_limit_.reset();
    awaits_value_ = false;
}

bool GripperControl::order(int number) {
    awaits_value_ = false;
    const auto move = [this](int direction) {
        lift_ = direction;
        lift_limit_.reset();
        lift_error_ = false;
    };
    switch (static_cast<GripperOrder>(number)) {
        case GripperOrder::Open:
            paddles_ = 1;
            return true;
        case GripperOrder::Close:
            close();
            return true;
        case GripperOrder::Stop:
            paddles_ = 0;
            return true;
        case GripperOrder::LiftUp:
            move(1);
            return true;
        case GripperOrder::LiftDown:
            move(-1);
            return true;
        case GripperOrder::LiftStop:
            move(0);
            return true;
        case GripperOrder::Store:
            close();
            move(1);
            return true;
        case GripperOrder::Deploy:
            paddles_ = 1;
            move(-1);
            return true;
        case GripperOrder::Halt:
            halt();
            return true;
        case GripperOrder::Press:
        case GripperOrder::LiftCarry:
            awaits_value_ = true;
            value_is_carry_ = number == static_cast<int>(GripperOrder::LiftCarry);
            return true;
    }
    return false;
}

bool GripperControl::value(int value) {
    if (!awaits_value_) return false;
    awaits_value_ = false;
    if (value_is_carry_) {
        lift_ = value > 0 ? 1 : value < 0 ? -1 : 0;
        lift_limit_ = std::abs(value) * kTimeUnit;
        lift_error_ = false;
    } else {
        grasp_time_ = std::clamp(value, 0, 255);
        close();
    }
    return true;
}

GripperSpeeds GripperControl::step(Duration period, const GripperReadings& r) {
    const bool open = std::min(r.left_paddle_mm, r.right_paddle_mm) > kOpening_mm - kSwitch_mm;
    const bool up = r.lift_mm > kLift_mm - kSwitch_mm;
    const bool down = r.lift_mm < kSwitch_mm;
    const bool both = r.left_pressed && r.right_pressed;

    if (paddles_ > 0 && open) paddles_ = 0;
    if (paddles_ < 0) {
        // Once both have felt it the time runs on, even if one loses touch for a moment.
        if (both && !pressing_) pressing_ = grasp_time_ * kTimeUnit;
        if (pressing_) {
            *pressing_ -= period;
            if (*pressing_ <= Duration::zero()) paddles_ = 0;
        }
    }
    if ((lift_ > 0 && up) || (lift_ < 0 && down)) lift_ = 0;
    if (lift_ != 0 && r.lift_blocked) {
        lift_ = 0;
        lift_error_ = true;
    }
    if (lift_ != 0 && lift_limit_) {
        *lift_limit_ -= period;
        if (*lift_limit_ <= Duration::zero()) lift_ = 0;
    }

    switches_ = {open,           up || down,      r.outer_beam_broken, r.inner_beam_broken,
                 r.left_pressed, r.right_pressed, lift_ != 0,          paddles_ != 0};
    state_ = {open, both && paddles_ <= 0, paddles_ != 0, false, up, down, lift_ != 0, lift_error_};
    return {paddles_ * kSpeed_mm_s, lift_ * kSpeed_mm_s};
}

}  // namespace axon::lab
