// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/servo_gate.hpp"

#include <cmath>

#include "robots/ssc32/protocol.hpp"

namespace axon::cyton {
namespace {

std::array<ssc32::ServoMove, kChannels> moves(const Pulses& pulses) {
    std::array<ssc32::ServoMove, kChannels> out;
    for (std::size_t i = 0; i < kChannels; ++i) out[i] = {i, static_cast<int>(std::lround(pulses[i]))};
    return out;
}

}  // namespace

Pulses pulsesOf(const Posture& posture) {
    Pulses pulses{};
    for (std::size_t i = 0; i < kJoints; ++i) pulses[i] = pulseOf(kChain[i], posture.joints[i]);
    pulses[kGripperChannel] = gripperPulseOf(posture.opening_mm);
    return pulses;
}

Posture postureOf(const Pulses& pulses) {
    Posture posture;
    for (std::size_t i = 0; i < kJoints; ++i) posture.joints[i] = angleOf(kChain[i], pulses[i]);
    posture.opening_mm = gripper::openingAt_mm(pulses[kGripperChannel]);
    return posture;
}

void ServoGate::told(const std::vector<int>& pulses_us, TimePoint now) {
    const std::lock_guard lock(mutex_);
    const auto own = presentPulses(now);
    Move move;
    move.begin = now;
    bool known = pulses_us.size() == kChannels;
    for (std::size_t i = 0; known && i < kChannels; ++i) {
        const double told = pulses_us[i];
        known = told > 0;
        const bool agrees = own && std::abs((*own)[i] - told) <= 2 * ssc32::kPulseStep_us;
        move.to[i] = agrees ? (*own)[i] : told + ssc32::kPulseStep_us / 2.0;
    }
    move.from = move.to;
    known_ = known;
    if (known)
        move_ = move;
    else
        move_.reset();
}

bool ServoGate::take(const std::function<bool()>& stop_requested) {
    const std::lock_guard lock(mutex_);
    // The task's flag is raised before stop() is called: either it is seen here, or stop() closes.
    if (taken_ || stop_requested()) return false;
    taken_ = open_ = true;
    return true;
}

bool ServoGate::command(const Posture& posture, Duration time, TimePoint now) {
    const std::lock_guard lock(mutex_);
    if (!open_) return false;
    const auto pulses = moves(pulsesOf(posture));
    if (!send_(ssc32::encodeMove(pulses, time))) return false;
    Move move;
    if (const auto from = presentPulses(now)) {
        move.from = *from;
        known_ = true;
    } else {
        known_ = false;  // on the way from nobody knows where
    }
    for (std::size_t i = 0; i < kChannels; ++i) move.to[i] = pulses[i].pulse_us;
    move.begin = now;
    move.time = time;
    move_ = move;
    return true;
}

bool ServoGate::freeze(TimePoint now) {
    const auto pulses = presentPulses(now);
    // ESC also ends a move that began nobody knows where.
    std::string lines(1, ssc32::kEscape);
    if (pulses) lines += ssc32::encodeMove(moves(*pulses));
    const bool told = send_(lines);
    if (pulses)
        move_ = Move{*pulses, *pulses, now, {}};
    else
        move_.reset();
    return told;
}

bool ServoGate::stop(TimePoint now) {
    const std::lock_guard lock(mutex_);
    open_ = false;
    return freeze(now);
}

void ServoGate::lost() {
    const std::lock_guard lock(mutex_);
    open_ = false;
}

void ServoGate::giveBack(TimePoint now) {
    const std::lock_guard lock(mutex_);
    if (open_) freeze(now);
    taken_ = open_ = false;
}

std::optional<Posture> ServoGate::present(TimePoint now) const {
    const std::lock_guard lock(mutex_);
    const auto pulses = presentPulses(now);
    return pulses ? std::optional(postureOf(*pulses)) : std::nullopt;
}

std::optional<Pulses> ServoGate::presentPulses(TimePoint now) const {
    if (!move_) return std::nullopt;
    if (now >= move_->begin + move_->time) return move_->to;
    if (!known_) return std::nullopt;
    const double part =
        std::chrono::duration<double>(now - move_->begin) / std::chrono::duration<double>(move_->time);
    Pulses pulses{};
    for (std::size_t i = 0; i < kChannels; ++i) pulses[i] = std::lerp(move_->from[i], move_->to[i], part);
    return pulses;
}

}  // namespace axon::cyton
