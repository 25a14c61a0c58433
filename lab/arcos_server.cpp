// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/arcos_server.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "robots/arcos/laser.hpp"

namespace axon::lab {
namespace {

using arcos::Argument;
using arcos::Command;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kVel2Unit_mm_s = 20;  // Vel2Divisor of the vendor's parameter file
constexpr double kResting_mm_s = 2;    // below this a wheel stands still
constexpr std::size_t kAuxiliaryBuffer = 256;

std::int16_t rounded(double value) {
    return static_cast<std::int16_t>(std::lround(std::clamp(value, -32768.0, 32767.0)));
}

std::uint16_t onWire(double position_mm) {
    return static_cast<std::uint16_t>(std::lround(position_mm) & (arcos::kPositionModulus - 1));
}

}  // namespace

int LaserSettings::readings() const {
    return std::clamp(static_cast<int>(std::floor((end_deg - start_deg) / resolution_deg + 0.5)) + 1, 1,
                      kMaximumReadings);
}

void ArcosServer::clientConnected(TimePoint now) {
    endSession(State::Synchronising);
    reader_.reset();
    last_packet_ = now;
}

void ArcosServer::clientLost() {
    endSession(State::NoClient);
}

void ArcosServer::endSession(State next) {
    if (state_ == State::Open) motion_.stop();
    motors_on_ = false;
    io_requests_ = gripper_requests_ = 0;
    gripper_.halt();
    auxiliary_.clear();
    auxiliary_wanted_ = 0;
    laser_ = {};
    sync_ = 0;
    watchdog_tripped_ = false;
    state_ = next;
}

void ArcosServer::receive(std::span<const std::uint8_t> bytes, TimePoint now) {
    for (const auto& packet : reader_.feed(bytes, now)) {
        if (state_ == State::NoClient) return;
        onPacket(packet, now);
    }
}

void ArcosServer::onPacket(const arcos::Packet& packet, TimePoint now) {
    last_packet_ = now;
    watchdog_tripped_ = false;
    if (state_ == State::Synchronised && packet.id == static_cast<std::uint8_t>(Command::Open)) {
        state_ = State::Open;
        next_sip_ = now + kSipPeriod;
        x_mm_ = y_mm_ = theta_deg_ = 0;
        motion_.translation() = MotionControl().translation();
        motion_.rotation() = MotionControl().rotation();
        bump_stall_ = 0;
        sonar_arrays_ = 0b111;
        stalled_ = left_stall_ = right_stall_ = false;
        return;
    }
    if (state_ == State::Open) {
        onCommand(packet, now);
    } else {
        onSync(packet);
    }
}

void ArcosServer::onSync(const arcos::Packet& packet) {
    // A client that missed an echo starts again with SYNC0, wherever this side is.
    if (packet.id == 0) sync_ = 0;
    // The answer to SYNC2 may be asked for once more.
    if (state_ == State::Synchronised && packet.id == 2) sync_ = 2;
    state_ = State::Synchronising;
    if (packet.id != sync_) {
        ++counters_.out_of_order_syncs;
        sync_ = 0;
        return;
    }
    if (sync_ < 2) {
        port_.send(arcos::encode({packet.id, {}}));
        ++sync_;
        return;
    }
    arcos::FieldWriter fields;
    fields.text(identity_.name).text(identity_.type).text(identity_.subtype);
    port_.send(arcos::encode({packet.id, fields.take()}));
    state_ = State::Synchronised;
    sync_ = 0;
}

void ArcosServer::onCommand(const arcos::Packet& packet, TimePoint now) {
    const auto command = static_cast<Command>(packet.id);
    const auto argument = arcos::parseArgument(packet);
    ++counters_.commands;
    if (command != Command::GripperValue && command != Command::Pulse) gripper_.forgetValue();
    const auto needsInteger = [&] {
        if (argument.kind == Argument::Kind::Integer) return true;
        ++counters_.malformed_commands;
        return false;
    };
    const auto setLimits = [&](MotionLimits& limits) {
        // A limit of zero would make every ramp endless, the one that stops included.
        (argument.value < 0 ? limits.deceleration : limits.acceleration) =
            std::max(1, std::abs(argument.value));
    };
    switch (command) {
        case Command::Pulse:
        case Command::Open:
        case Command::Encoder:
        case Command::JoyDrive:
        case Command::BatteryInfo:
            break;
        case Command::HostBaud:
            if (!needsInteger()) break;
            if (argument.value >= 0 && argument.value < static_cast<int>(arcos::kHostBaudCodes.size()))
                baud_ = arcos::kHostBaudCodes[static_cast<std::size_t>(argument.value)];
            else
                ++counters_.malformed_commands;
            break;
        case Command::Close:
            endSession(State::Synchronising);
            break;
        case Command::Enable:
            if (!needsInteger()) break;
            motors_on_ = argument.value != 0;
            if (!motors_on_) motion_.halt();
            break;
        case Command::SetA:
            if (needsInteger()) setLimits(motion_.translation());
            break;
        case Command::SetRa:
            if (needsInteger()) setLimits(motion_.rotation());
            break;
        case Command::SetV:
            if (needsInteger())
                motion_.translation().speed =
                    std::min<double>(std::abs(argument.value), motion_.translation().top);
            break;
        case Command::SetRv:
            if (needsInteger())
                motion_.rotation().speed = std::min<double>(std::abs(argument.value), motion_.rotation().top);
            break;
        case Command::SetO:
            x_mm_ = y_mm_ = theta_deg_ = 0;
            break;
        case Command::Move:
        case Command::Rotate:
        case Command::Vel:
        case Command::Head:
        case Command::DHead:
        case Command::RVel:
        case Command::Vel2:
            if (needsInteger() && motors_on_ && now >= stalled_until_) onMotion(command, argument);
            break;
        case Command::Stop:
            motion_.stop();
            break;
        case Command::EStop:
        case Command::QStop:
            motion_.emergencyStop();
            break;
        case Command::Config:
            sendConfig();
            break;
        case Command::Sonar:
            if (needsInteger()) onSonar(argument.value);
            break;
        case Command::DigOut:
            // The high byte selects the bits that the low byte sets.
            if (needsInteger()) {
                const unsigned mask = argument.raw >> 8U;
                digital_out_ = static_cast<std::uint8_t>((digital_out_ & ~mask) | (argument.raw & mask));
            }
            break;
        case Command::IoRequest:
            if (!needsInteger()) break;
            io_requests_ = std::clamp(argument.value, 0, 2);
            if (io_requests_ == 1) {
                sendInputsOutputs();
                io_requests_ = 0;
            }
            break;
        case Command::BumpStall:
            if (needsInteger()) bump_stall_ = static_cast<unsigned>(std::clamp(argument.value, 0, 3));
            break;
        case Command::Gripper:
        case Command::GripperValue:
        case Command::GripperRequest:
            if (needsInteger()) onGripper(command, argument.value);
            break;
        case Command::OldLaserOn:
        case Command::OldLaserResolution:
        case Command::LaserOn:
        case Command::LaserStart:
        case Command::LaserEnd:
        case Command::LaserResolution:
            if (needsInteger()) onLaser(command, argument.value);
            break;
        case Command::Tty2:
        case Command::GetAux:
            onCamera(command, argument);
            break;
        default:
            ++counters_.unknown_commands;
    }
}

void ArcosServer::onGripper(Command command, int argument) {
    if (command == Command::Gripper) {
        if (!gripper_.order(argument)) ++counters_.malformed_commands;
    } else if (command == Command::GripperValue) {
        if (!gripper_.value(argument)) onLaser(Command::LaserStart, argument);
    } else if (argument < 0 || argument > 2) {
        onLaser(Command::LaserEnd, argument);
    } else {
        gripper_requests_ = argument;
        if (gripper_requests_ == 1) {
            sendGripper();
            gripper_requests_ = 0;
        }
    }
}

void ArcosServer::onLaser(Command command, int argument) {
    if (!has_laser_) {
        ++counters_.unknown_commands;
        return;
    }
    auto wanted = laser_;
    switch (command) {
        case Command::OldLaserOn:
        case Command::LaserOn:
            wanted.on = argument != 0;
            laser_reflectances_ = argument == 2;
            break;
        case Command::LaserStart:
            wanted.start_deg = argument;
            break;
        case Command::LaserEnd:
            wanted.end_deg = argument;
            break;
        case Command::LaserResolution:
            wanted.resolution_deg = argument;
            break;
        default:
            wanted.resolution_deg = argument / 100.0;
    }
    // Start and end come one after the other: which one is the first is seen when the laser turns.
    const bool possible = std::abs(wanted.start_deg) <= 90 && std::abs(wanted.end_deg) <= 90 &&
                          wanted.resolution_deg >= 0.5 && wanted.resolution_deg <= 90;
    if (!possible) {
        ++counters_.malformed_commands;
        return;
    }
    laser_ = wanted;
}

void ArcosServer::onCamera(Command command, const Argument& argument) {
    const auto wanted = command == Command::Tty2 ? Argument::Kind::Text : Argument::Kind::Integer;
    if (argument.kind != wanted) {
        ++counters_.malformed_commands;
        return;
    }
    if (command == Command::Tty2) {
        auxiliary_ += camera_.receive(argument.text);
        if (auxiliary_.size() > kAuxiliaryBuffer) auxiliary_.erase(0, auxiliary_.size() - kAuxiliaryBuffer);
    } else if (argument.value <= 0) {
        auxiliary_.clear();
        auxiliary_wanted_ = 0;
    } else {
        auxiliary_wanted_ =
            std::min<std::size_t>(static_cast<std::size_t>(argument.value), arcos::kMaximumData);
    }
    sendAuxiliary();
}

/// Clients ask before the camera has anything to say: the bytes follow when they are there.
void ArcosServer::sendAuxiliary() {
    if (auxiliary_wanted_ == 0 || auxiliary_.size() < auxiliary_wanted_) return;
    arcos::Bytes bytes(auxiliary_.begin(),
                       auxiliary_.begin() + static_cast<std::ptrdiff_t>(auxiliary_wanted_));
    auxiliary_.erase(0, auxiliary_wanted_);
    auxiliary_wanted_ = 0;
    port_.send(arcos::encode({arcos::kAuxPacket, std::move(bytes)}));
}

void ArcosServer::sendGripper() {
    port_.send(arcos::encode(
        arcos::toPacket(arcos::GripperPacket{arcos::GripperPacket::kGeneralIo, gripper_.switches(),
                                             static_cast<std::uint8_t>(gripper_.graspTime())})));
}

void ArcosServer::sendLaser(const BodyReadings& readings) {
    const auto& ranges = readings.laser_mm;
    for (std::size_t first = 0; first < ranges.size(); first += arcos::LaserPacket::kMaximumReadings) {
        arcos::LaserPacket packet;
        packet.extended = laser_reflectances_;
        packet.x = onWire(x_mm_);
        packet.y = onWire(y_mm_);
        packet.theta = rounded(std::remainder(theta_deg_, 360.0));
        packet.total = static_cast<std::uint16_t>(ranges.size());
        packet.first = static_cast<std::uint16_t>(first);
        const auto end = std::min(ranges.size(), first + arcos::LaserPacket::kMaximumReadings);
        for (auto i = first; i < end; ++i) packet.readings.push_back({ranges[i]});
        port_.send(arcos::encode(arcos::toPacket(packet)));
    }
}

void ArcosServer::onMotion(Command command, const Argument& argument) {
    switch (command) {
        case Command::Vel:
            motion_.setVelocity(argument.value);
            break;
        case Command::RVel:
        case Command::Rotate:
            motion_.setRotation(argument.value);
            break;
        case Command::Vel2: {
            const double right = static_cast<std::int8_t>(argument.raw & 0xFFU) * kVel2Unit_mm_s;
            const double left = static_cast<std::int8_t>(argument.raw >> 8U) * kVel2Unit_mm_s;
            motion_.setVelocity((left + right) / 2);
            motion_.setRotation((right - left) / kTrack_mm / kDegree);
            break;
        }
        case Command::Move:
            motion_.move(argument.value);
            break;
        case Command::Head:
            motion_.turnTo(argument.value);
            break;
        case Command::DHead:
            motion_.turnBy(argument.value);
            break;
        default:
            break;
    }
}

void ArcosServer::onSonar(int argument) {
    const auto bits = static_cast<unsigned>(argument);
    const unsigned array = (bits >> 1U) & 7U;  // 0: all of them, else 1 to 3
    const unsigned chosen = array == 0 ? 0b111U : (1U << (array - 1)) & 0b111U;
    sonar_arrays_ = (bits & 1U) != 0 ? sonar_arrays_ | chosen : sonar_arrays_ & ~chosen;
}

ArcosServer::WheelSpeeds ArcosServer::step(Duration period, const BodyReadings& readings, TimePoint now) {
    receive({}, now);  // what stands behind a false start
    updateOdometry(readings);
    for (int array = 0; array < 3; ++array) {
        if (sonarOn(array))
            sonars_pending_ |= readings.sonars_fired & (0xFFU << static_cast<unsigned>(8 * array));
    }
    digital_in_ = static_cast<std::uint8_t>(0xFFU & ~(readings.table_right ? 1U : 0U) &
                                            ~(readings.table_left ? 2U : 0U));

    if (state_ == State::Open && !watchdog_tripped_ && now - last_packet_ >= kWatchdog) {
        watchdog_tripped_ = true;
        ++counters_.watchdog_trips;
        motion_.stop();
    }
    watchBody(readings, now);
    gripper_speeds_ = gripper_.step(period, readings.gripper);
    camera_.step(period);
    if (state_ == State::Open && laser_.on && readings.laser_scanned) sendLaser(readings);
    const auto speed = motion_.step(period, distance_mm_, theta_deg_);
    if (state_ == State::Open && now >= next_sip_) {
        next_sip_ = std::max(next_sip_ + kSipPeriod, now);
        sendServerInformation(readings);
        if (io_requests_ == 2) sendInputsOutputs();
        if (gripper_requests_ == 2) sendGripper();
    }
    const double difference = speed.left_deg_s * kDegree * kTrack_mm / 2;
    return {speed.forward_mm_s - difference, speed.forward_mm_s + difference};
}

void ArcosServer::watchBody(const BodyReadings& readings, TimePoint now) {
    if (stalled_ && now >= stalled_until_) stalled_ = left_stall_ = right_stall_ = false;
    if (stalled_) return;
    const int direction = motion_.direction();
    const bool front = (bump_stall_ & 1U) != 0 && readings.front_bumpers != 0 && direction > 0;
    const bool rear = (bump_stall_ & 2U) != 0 && readings.rear_bumpers != 0 && direction < 0;
    if (front || rear) {
        stall(now, true, true);
    } else if (readings.left_blocked || readings.right_blocked) {
        stall(now, readings.left_blocked, readings.right_blocked);
    }
}

void ArcosServer::stall(TimePoint now, bool left, bool right) {
    motion_.halt();
    stalled_ = true;
    left_stall_ = left;
    right_stall_ = right;
    stalled_until_ = now + kStallPause;
    ++counters_.stalls;
}

void ArcosServer::updateOdometry(const BodyReadings& readings) {
    if (encoders_known_) {
        const double left = readings.left_wheel_mm - last_left_mm_;
        const double right = readings.right_wheel_mm - last_right_mm_;
        const double way = (left + right) / 2;
        const double turn_deg = (right - left) / kTrack_mm / kDegree;
        const double middle = (theta_deg_ + turn_deg / 2) * kDegree;
        x_mm_ += way * std::cos(middle);
        y_mm_ += way * std::sin(middle);
        theta_deg_ += turn_deg;
        distance_mm_ += way;
    }
    encoders_known_ = true;
    last_left_mm_ = readings.left_wheel_mm;
    last_right_mm_ = readings.right_wheel_mm;
}

void ArcosServer::sendServerInformation(const BodyReadings& readings) {
    arcos::ServerInformation sip;
    sip.moving =
        std::abs(readings.left_mm_s) > kResting_mm_s || std::abs(readings.right_mm_s) > kResting_mm_s;
    sip.x = onWire(x_mm_);
    sip.y = onWire(y_mm_);
    sip.theta = rounded(std::remainder(theta_deg_, 360.0) * kDegree / arcos::kRadiansPerAngleUnit);
    sip.left_mm_s = rounded(readings.left_mm_s);
    sip.right_mm_s = rounded(readings.right_mm_s);
    sip.battery_dv = static_cast<std::uint8_t>(std::lround(readings.battery_v * 10));
    sip.left_stall = left_stall_;
    sip.right_stall = right_stall_;
    sip.front_bumpers = static_cast<std::uint8_t>(readings.front_bumpers);
    sip.rear_bumpers = static_cast<std::uint8_t>(readings.rear_bumpers);
    sip.control = sip.theta;
    sip.flags = static_cast<std::uint16_t>((motors_on_ ? 1U : 0U) | (sonar_arrays_ << 1U));
    for (unsigned i = 0; i < BodyReadings::kSonars; ++i) {
        if ((sonars_pending_ & (1U << i)) != 0)
            sip.sonars.push_back({static_cast<std::uint8_t>(i), readings.sonar_mm[i]});
    }
    sonars_pending_ = 0;
    sip.grip_state = arcos::toByte(gripper_.state());
    sip.general_io = arcos::toByte(gripper_.switches());
    sip.digital_in = digital_in_;
    sip.digital_out = digital_out_;
    sip.battery_x10 = sip.battery_dv;
    sip.state_of_charge = static_cast<std::uint8_t>(std::lround(readings.charge * 100));
    const double rotation = (readings.right_mm_s - readings.left_mm_s) / kTrack_mm / kDegree;
    sip.rotation_tenth_deg_s = rounded(rotation * 10);
    port_.send(arcos::encode(arcos::toPacket(sip)));
}

void ArcosServer::sendConfig() {
    const auto& translation = motion_.translation();
    const auto& rotation = motion_.rotation();
    arcos::RobotConfig config;
    config.type = identity_.type;
    config.subtype = identity_.subtype;
    config.serial_number = "SIM";  // as the vendor's simulators say it
    config.top_rotation_deg_s = static_cast<int>(rotation.top);
    config.top_speed_mm_s = static_cast<int>(translation.top);
    config.top_rotation_acceleration = 1000;
    config.top_acceleration = 4000;
    config.name = identity_.name;
    config.sip_cycle_ms = static_cast<int>(kSipPeriod / std::chrono::milliseconds{1});
    config.gripper = config.front_sonar = config.rear_sonar = true;
    config.low_battery_dv = 115;
    config.watchdog_ms = static_cast<int>(kWatchdog / std::chrono::milliseconds{1});
    config.stall_pause_ms = static_cast<int>(kStallPause / std::chrono::milliseconds{1});
    config.rotation_limit_deg_s = static_cast<int>(rotation.speed);
    config.speed_limit_mm_s = static_cast<int>(translation.speed);
    config.rotation_acceleration = static_cast<int>(rotation.acceleration);
    config.rotation_deceleration = static_cast<int>(rotation.deceleration);
    config.acceleration = static_cast<int>(translation.acceleration);
    config.deceleration = static_cast<int>(translation.deceleration);
    config.front_bumpers = config.rear_bumpers = 5;
    config.sonar_cycle_ms = 40;
    config.firmware = "1.0";
    port_.send(arcos::encode(arcos::toPacket(config)));
}

void ArcosServer::sendInputsOutputs() {
    // Only the fourth input byte is wired on a PeopleBot; the others read high, as open inputs do.
    port_.send(arcos::encode(arcos::toPacket(arcos::InputsOutputs{
        {0xFF, 0xFF, 0xFF, digital_in_}, {digital_out_}, std::vector<std::uint16_t>(8, 0)})));
}

}  // namespace axon::lab
