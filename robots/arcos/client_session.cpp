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

/// Table sensors are active low, right on bit 0, left on bit 1.
void readTableSensors(unsigned digital_in, RobotState& robot) {
    robot.table_right = (digital_in & 1U) == 0;
    robot.table_left = (digital_in & 2U) == 0;
}

}  // namespace

void ClientSession::begin(TimePoint now) {
    state_ = State::Synchronising;
    reader_.reset();
    identity_ = {};
    robot_ = {};
    config_.reset();
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
        config_ = std::move(config);
    } else if (const auto io = parseInputsOutputs(packet); io && io->digital_in.size() >= 4) {
        table_sensors_by_io_ = true;
        readTableSensors(io->digital_in[3], robot_);
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
    if (!table_sensors_by_io_) readTableSensors(sip.digital_in, robot_);
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
            break;
    }
    if (state_ != State::Closed && now - last_sent_ >= kPulsePeriod) send(encodeCommand(Command::Pulse), now);
}

}  // namespace axon::arcos
