// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/client_session.hpp"

#include <chrono>
#include <cmath>
#include <numbers>
#include <string>

namespace axon::arcos {
namespace {

constexpr double kDegreesPerAngleUnit = kRadiansPerAngleUnit * 180 / std::numbers::pi;
// A full turn in angle units; the vendor's rounded constant makes it 4095.9.
constexpr int kAngleUnitsPerTurn = 4096;

/// The shortest way from one value to another on a ring.
int ringDifference(int from, int to, int ring) {
    int difference = (to - from) % ring;
    if (difference >= ring / 2) difference -= ring;
    if (difference < -ring / 2) difference += ring;
    return difference;
}

/// Table sensors and the column's beams are active low.
void readInfrared(unsigned digital_in, RobotState& robot) {
    robot.table_right = (digital_in & 1U) == 0;
    robot.table_left = (digital_in & 2U) == 0;
    robot.column_right = (digital_in & 4U) == 0;
    robot.column_left = (digital_in & 8U) == 0;
}

}  // namespace

void ClientSession::begin(TimePoint now) {
    state_ = State::Synchronising;
    reader_.reset();
    identity_ = {};
    robot_ = {};
    laser_ = {};
    gripper_type_ = GripperPacket::kNone;
    gripper_known_ = false;
    previous_.reset();
    table_sensors_by_io_ = false;
    sync_ = tries_ = rounds_ = 0;
    sendSync(now);
}

void ClientSession::end(const std::string& reason) {
    if (state_ == State::Closed) return;
    state_ = State::Closed;
    robot_.online = false;
    port_.onLost(reason);
}

void ClientSession::send(const Bytes& bytes, TimePoint now) {
    last_sent_ = now;
    port_.send(bytes);
}

void ClientSession::sendSync(TimePoint now) {
    ++tries_;
    send(encodeCommand(static_cast<Command>(sync_)), now);
}

void ClientSession::receive(std::span<const std::uint8_t> bytes, TimePoint now) {
    for (const auto& packet : reader_.feed(bytes, now)) {
        if (state_ == State::Closed) return;
        onPacket(packet, now);
    }
}

void ClientSession::onPacket(const Packet& packet, TimePoint now) {
    if (state_ == State::Synchronising) {
        onSync(packet, now);
    } else if (const auto sip = parseServerInformation(packet)) {
        onServerInformation(*sip, now);
    } else if (auto config = parseRobotConfig(packet)) {
        robot_.config = std::make_shared<const RobotConfig>(std::move(*config));
    } else if (const auto laser = parseLaserPacket(packet)) {
        onLaser(*laser, now);
    } else if (const auto gripper = parseGripperPacket(packet)) {
        gripper_known_ = true;
        gripper_type_ = gripper->type;
    } else if (const auto io = parseInputsOutputs(packet); io && io->digital_in.size() >= 4) {
        table_sensors_by_io_ = true;
        readInfrared(io->digital_in[3], robot_);
    }
}

void ClientSession::onSync(const Packet& packet, TimePoint now) {
    if (packet.id != sync_) {
        // A late echo of an earlier try, or server information of a session that was never closed: the robot
        // is asked again when the time-out passes, and the last round before giving up starts with CLOSE.
        return;
    }
    tries_ = 0;
    if (sync_ < 2) {
        ++sync_;
        sendSync(now);
        return;
    }
    FieldReader fields(packet.data);
    identity_ = {fields.text(), fields.text(), fields.text()};
    state_ = State::Opening;
    last_heard_ = now;
    send(encodeCommand(Command::Open), now);
    send(encodeCommand(Command::Pulse), now);
    send(encodeCommand(Command::Config, 1), now);
    send(encodeCommand(Command::IoRequest, 2), now);
    send(encodeCommand(Command::Sonar, 1), now);
    // The robot itself stalls on a bumper, however slow this program is.
    send(encodeCommand(Command::BumpStall, 3), now);
    // Robots whose laser is wired to the computer ignore it. MobileSim is asked as its own clients do.
    send(encodeCommand(isMobileSim() ? Command::OldLaserOn : Command::LaserOn, 1), now);
}

void ClientSession::onLaser(const LaserPacket& packet, TimePoint now) {
    const auto readings = laser_.add(packet);
    if (!readings || !previous_) return;
    auto scan = std::make_shared<LaserScan>();
    scan->sequence = robot_.laser ? robot_.laser->sequence + 1 : 1;
    scan->taken = now;
    scan->x_mm = robot_.x_mm;
    scan->y_mm = robot_.y_mm;
    scan->heading_deg = robot_.heading_deg;
    if (!packet.extended) {
        scan->x_mm += ringDifference(previous_->x, packet.x, kPositionModulus);
        scan->y_mm += ringDifference(previous_->y, packet.y, kPositionModulus);
        // In whole degrees: where it agrees with the server information, that is the finer of the two.
        const double turned = std::remainder(packet.theta - robot_.heading_deg, 360.0);
        if (std::abs(turned) > 1) scan->heading_deg += turned;
    }
    if (readings->size() > 1) {
        scan->start_deg = -90;
        scan->step_deg = 180.0 / static_cast<double>(readings->size() - 1);
    }
    scan->ranges_mm.reserve(readings->size());
    for (const auto& reading : *readings) scan->ranges_mm.push_back(reading.range_mm);
    robot_.laser = std::move(scan);
}

void ClientSession::readGripper(std::uint8_t grip_state, std::uint8_t general_io) {
    auto& gripper = robot_.gripper;
    gripper = {};
    gripper.known = gripper_known_;
    gripper.fitted = gripper_type_ != GripperPacket::kNone;
    if (!gripper.fitted) return;
    const auto state = parseGripState(grip_state);
    gripper.open = state.paddles_open;
    gripper.closed = state.paddles_closed;
    gripper.lift_up = state.lift_up;
    gripper.lift_down = state.lift_down;
    gripper.lift_at_limit = state.lift_up || state.lift_down;
    gripper.paddles_moving = state.paddles_moving;
    gripper.lift_moving = state.lift_moving;
    gripper.paddle_error = state.paddles_error;
    gripper.lift_error = state.lift_error;
    if (gripper_type_ != GripperPacket::kGeneralIo) return;
    const auto switches = parseGripperSwitches(general_io);
    gripper.open = gripper.open || switches.paddles_open;
    gripper.lift_at_limit = gripper.lift_at_limit || switches.lift_at_limit;
    gripper.paddles_moving = gripper.paddles_moving || switches.paddles_moving;
    gripper.lift_moving = gripper.lift_moving || switches.lift_moving;
    gripper.outer_beam = switches.outer_beam_broken;
    gripper.inner_beam = switches.inner_beam_broken;
    gripper.left_pressed = switches.left_paddle_pressed;
    gripper.right_pressed = switches.right_paddle_pressed;
    // There is no switch for it: paddles that rest and are not open are closed, on something or on each other.
    if (!gripper.open && !gripper.paddles_moving) gripper.closed = true;
}

void ClientSession::onServerInformation(const ServerInformation& sip, TimePoint now) {
    last_heard_ = now;
    if (previous_) {
        robot_.x_mm += ringDifference(previous_->x, sip.x, kPositionModulus);
        robot_.y_mm += ringDifference(previous_->y, sip.y, kPositionModulus);
        robot_.heading_deg +=
            ringDifference(previous_->theta, sip.theta, kAngleUnitsPerTurn) * kDegreesPerAngleUnit;
    } else {
        robot_.x_mm = ringDifference(0, sip.x, kPositionModulus);
        robot_.y_mm = ringDifference(0, sip.y, kPositionModulus);
        robot_.heading_deg = ringDifference(0, sip.theta, kAngleUnitsPerTurn) * kDegreesPerAngleUnit;
    }
    robot_.online = true;
    ++robot_.sequence;
    robot_.taken = now;
    robot_.left_mm_s = sip.left_mm_s;
    robot_.right_mm_s = sip.right_mm_s;
    robot_.rotation_deg_s = sip.rotation_tenth_deg_s / 10.0;
    robot_.moving = sip.moving;
    robot_.motors_on = (sip.flags & ServerInformation::kMotorsOn) != 0;
    robot_.left_stall = sip.left_stall;
    robot_.right_stall = sip.right_stall;
    robot_.front_bumpers = sip.front_bumpers;
    robot_.rear_bumpers = sip.rear_bumpers;
    robot_.battery_v = (sip.battery_x10 != 0 ? sip.battery_x10 : sip.battery_dv) / 10.0;
    if (!table_sensors_by_io_) readInfrared(sip.digital_in, robot_);
    readGripper(sip.grip_state, sip.general_io);
    for (const auto& sonar : sip.sonars) {
        if (sonar.number < RobotState::kSonars) robot_.sonars[sonar.number] = {sonar.range_mm, now};
    }
    previous_ = sip;
    if (state_ == State::Opening) {
        state_ = State::Online;
        port_.onOnline(identity_);
    }
    port_.onState(robot_);
}

void ClientSession::tick(TimePoint now) {
    switch (state_) {
        case State::Closed:
            return;
        case State::Synchronising:
            if (now - last_sent_ < kSyncTimeout) return;
            if (tries_ >= kSyncTries || sync_ > 0) {
                // An echo got lost: the robot may be one step further than this side, so both start again.
                tries_ = 0;
                sync_ = 0;
                if (++rounds_ >= kSyncRounds) {
                    end("the robot does not answer SYNC: is it an ARCOS robot, and is no other client "
                        "connected to it?");
                    return;
                }
                if (rounds_ == kSyncRounds - 1) send(encodeCommand(Command::Close), now);
            }
            sendSync(now);
            return;
        case State::Opening:
            if (now - last_heard_ >= kOpenTimeout) end("the robot does not send its state after OPEN");
            break;
        case State::Online:
            if (now - last_heard_ >= silence_limit_) {
                end("no word from the robot for " +
                    std::to_string(
                        std::chrono::duration_cast<std::chrono::milliseconds>(silence_limit_).count()) +
                    " ms");
                return;
            }
            // For MobileSim, which has no gripper, the same number is the laser's last angle.
            if (!gripper_known_ && !isMobileSim() && now - gripper_asked_ >= kGripperRequestPeriod) {
                gripper_asked_ = now;
                send(encodeCommand(Command::GripperRequest, 1), now);
            }
            break;
    }
    if (state_ != State::Closed && now - last_sent_ >= kPulsePeriod) send(encodeCommand(Command::Pulse), now);
}

}  // namespace axon::arcos
