// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/client_session.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>

namespace axon::arcos {
namespace {

constexpr double kDegreesPerAngleUnit = kRadiansPerAngleUnit * 180 / std::numbers::pi;
// A full turn in angle units; the vendor's rounded constant makes it 4095.9.
constexpr int kAngleUnitsPerTurn = 4096;
constexpr std::size_t kFraming = 6;  // of a packet: what is sent besides its data

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

bool LaserScan::sees() const {
    return std::any_of(ranges_mm.begin(), ranges_mm.end(),
                       [](std::uint16_t range) { return range > 0 && range < LaserPacket::kNothing_mm; });
}

void ClientSession::begin(TimePoint now, const robots::LineSpeed& line) {
    state_ = State::Synchronising;
    reader_.reset();
    identity_ = {};
    robot_ = {};
    laser_ = {};
    poses_.clear();
    scan_.reset();
    gripper_type_ = GripperPacket::kNone;
    gripper_known_ = false;
    previous_.reset();
    table_sensors_by_io_ = false;
    line_ = line;
    if (line_.asked == 0) line_.asked = kRaisedSpeed;
    speeds_.clear();
    if (line_.baud != 0) {
        for (const int baud : {line_.baud, robots::kFirstSpeed, kRaisedSpeed})
            if (std::find(speeds_.begin(), speeds_.end(), baud) == speeds_.end()) speeds_.push_back(baud);
    }
    speed_ = 0;
    speed_change_due_.reset();
    speed_before_ = 0;
    sync_ = attempts_ = 0;
    old_session_seen_ = -1;
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
    if (sync_ == 0 && !speeds_.empty()) {
        send(encodeCommand(Command::EStop), now);
        // Not each time: a controller that closes its server lets nobody connect until it is done with that.
        if (attempts_ / static_cast<int>(speeds_.size()) % 2 == 0) send(encodeCommand(Command::Close), now);
    }
    send(encodeCommand(static_cast<Command>(sync_)), now);
}

void ClientSession::receive(std::span<const std::uint8_t> bytes, TimePoint now) {
    for (const auto& packet : reader_.feed(bytes, now)) {
        if (state_ == State::Closed) return;
        onPacket(packet, now);
    }
}

void ClientSession::onPacket(const Packet& packet, TimePoint now) {
    if (speed_change_due_) return;  // told before the robot changed its speed: it proves nothing
    if (state_ == State::Synchronising) {
        onSync(packet, now);
    } else if (const auto sip = parseServerInformation(packet)) {
        onServerInformation(*sip, now, onTheWire(packet.data.size() + kFraming));
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
    if (packet.id == kMovingPacket || packet.id == kStandingPacket) {
        // Of a session that was never closed. Once for each attempt: some more are on their way.
        if (old_session_seen_ != attempts_) {
            old_session_seen_ = attempts_;
            sync_ = 0;
            send(encodeCommand(Command::EStop), now);
            send(encodeCommand(Command::Close), now);
            send(encodeCommand(static_cast<Command>(sync_)), now);
        }
        return;
    }
    if (packet.id != sync_)
        return;  // a late echo of an earlier try: the robot is asked again after the time-out
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
    const auto* const code = std::find(kHostBaudCodes.begin(), kHostBaudCodes.end(), line_.asked);
    if (speeds_.empty() || line_.baud == line_.asked || code == kHostBaudCodes.end()) {
        askForEverything(now);
        return;
    }
    send(encodeCommand(Command::HostBaud, static_cast<int>(code - kHostBaudCodes.begin())), now);
    speed_change_due_ = now + kSpeedPause;
}

void ClientSession::changeSpeed(TimePoint now) {
    if (speed_change_due_ && now >= *speed_change_due_) {
        speed_change_due_.reset();
        if (!port_.setSpeed(line_.asked)) {
            end("the serial line does not have " + std::to_string(line_.asked) +
                " baud; fix: put the speed that it has behind the name of the line, such as :9600");
            return;
        }
        speed_before_ = std::exchange(line_.baud, line_.asked);
        speed_changed_ = now;
        reader_.reset();
        send(encodeCommand(Command::Pulse), now);
    } else if (speed_before_ != 0 && now - speed_changed_ >= kSpeedPatience) {
        line_.baud = std::exchange(speed_before_, 0);
        port_.setSpeed(line_.baud);
        reader_.reset();
        last_heard_ = now;
        askForEverything(now);
    }
}

void ClientSession::askForEverything(TimePoint now) {
    send(encodeCommand(Command::Config, 1), now);
    send(encodeCommand(Command::IoRequest, 2), now);
    send(encodeCommand(Command::Sonar, 1), now);
    // The robot itself stalls on a bumper, however slow this program is.
    send(encodeCommand(Command::BumpStall, 3), now);
    // Robots whose laser is wired to the computer ignore it. MobileSim is asked as its own clients do.
    send(encodeCommand(isMobileSim() ? Command::OldLaserOn : Command::LaserOn, 1), now);
}

Duration ClientSession::onTheWire(std::size_t bytes) const {
    // Start bit, eight bits, stop bit.
    return line_.baud == 0 ? Duration::zero()
                           : Duration(std::chrono::seconds{1}) * static_cast<int>(bytes) * 10 / line_.baud;
}

void ClientSession::newScan(LaserScan scan) {
    laser_of_ours_ = true;
    if (state_ == State::Online) scan_ = std::move(scan);
}

void ClientSession::publishScan(LaserScan scan) {
    const auto pose = poses_.at(scan.taken);
    if (!pose) return;
    scan.sequence = robot_.laser ? robot_.laser->sequence + 1 : 1;
    scan.x_mm = pose->x_mm;
    scan.y_mm = pose->y_mm;
    scan.heading_deg = pose->heading_deg;
    robot_.laser = std::make_shared<const LaserScan>(std::move(scan));
}

void ClientSession::onLaser(const LaserPacket& packet, TimePoint now) {
    const auto readings = laser_.add(packet);
    if (!readings || !previous_ || laser_of_ours_) return;
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
    // There is no switch for it: paddles that rest and are not open are closed, on something or on each
    // other.
    if (!gripper.open && !gripper.paddles_moving) gripper.closed = true;
}

void ClientSession::onServerInformation(const ServerInformation& sip, TimePoint now, Duration on_the_wire) {
    last_heard_ = now;
    if (std::exchange(speed_before_, 0) != 0) askForEverything(now);
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
    robot_.baud = line_.baud;
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
    poses_.add(now - on_the_wire, {robot_.x_mm, robot_.y_mm, robot_.heading_deg});
    if (scan_) publishScan(*std::exchange(scan_, std::nullopt));
    if (state_ == State::Opening) {
        state_ = State::Online;
        port_.onOnline(identity_);
    }
    port_.onState(robot_);
}

Duration ClientSession::pulsePeriod() const {
    if (!robot_.config || robot_.config->watchdog_ms == 0) return kPulsePeriod;
    return std::clamp<Duration>(std::chrono::milliseconds{robot_.config->watchdog_ms} / 4,
                                kShortestPulsePeriod, kPulsePeriod);
}

void ClientSession::tick(TimePoint now) {
    receive({}, now);  // what stands behind a false start
    switch (state_) {
        case State::Closed:
            return;
        case State::Synchronising:
            if (now - last_sent_ < kSyncTimeout) return;
            if (++attempts_ >= kSyncAttempts) {
                end("the robot does not answer SYNC: is it an ARCOS robot, and is no other client "
                    "connected to it?");
                return;
            }
            if (sync_ == 0 && speeds_.size() > 1) {
                speed_ = (speed_ + 1) % speeds_.size();
                if (port_.setSpeed(speeds_[speed_])) line_.baud = speeds_[speed_];
                reader_.reset();
            }
            // An echo may have been lost: the robot may be one step further than this side, so both start
            // again.
            sync_ = 0;
            sendSync(now);
            return;
        case State::Opening:
            changeSpeed(now);
            if (state_ != State::Closed && now - last_heard_ >= kOpenTimeout)
                end("the robot does not send its state after OPEN");
            break;
        case State::Online:
            if (now - last_heard_ >= silence_limit_) {
                send(encodeCommand(Command::EStop), now);
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
    if (state_ != State::Closed && now - last_sent_ >= pulsePeriod())
        send(encodeCommand(Command::Pulse), now);
}

}  // namespace axon::arcos
