// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/server_information.hpp"

namespace axon::arcos {

Packet toPacket(const ServerInformation& sip) {
    FieldWriter f;
    f.u16(sip.x).u16(sip.y).u16(sip.theta).u16(sip.left_mm_s).u16(sip.right_mm_s).u8(sip.battery_dv);
    f.u8((sip.left_stall ? 1U : 0U) | ((sip.rear_bumpers & 0x1FU) << 1U));
    f.u8((sip.right_stall ? 1U : 0U) | ((sip.front_bumpers & 0x1FU) << 1U));
    f.u16(sip.control).u16(sip.flags).u8(sip.compass);
    f.u8(static_cast<unsigned>(sip.sonars.size()));
    for (const auto& sonar : sip.sonars) f.u8(sonar.number).u16(sonar.range_mm);
    f.u8(sip.grip_state).u8(sip.general_io).u8(sip.analog).u8(sip.digital_in).u8(sip.digital_out);
    f.u16(sip.battery_x10)
        .u8(sip.charge_state)
        .u16(sip.rotation_tenth_deg_s)
        .u16(sip.faults)
        .u16(sip.lateral_mm_s);
    f.u8(static_cast<std::uint8_t>(sip.temperature_c)).u8(sip.state_of_charge);
    return {sip.moving ? kMovingPacket : kStandingPacket, f.take()};
}

std::optional<ServerInformation> parseServerInformation(const Packet& packet) {
    if ((packet.id & 0xF0U) != 0x30) return std::nullopt;
    FieldReader f(packet.data);
    ServerInformation sip;
    sip.moving = packet.id == kMovingPacket;
    sip.x = f.u16() & (kPositionModulus - 1);
    sip.y = f.u16() & (kPositionModulus - 1);
    sip.theta = f.i16();
    sip.left_mm_s = f.i16();
    sip.right_mm_s = f.i16();
    sip.battery_dv = f.u8();
    const unsigned low = f.u8();
    const unsigned high = f.u8();
    sip.left_stall = (low & 1U) != 0;
    sip.right_stall = (high & 1U) != 0;
    sip.rear_bumpers = (low >> 1U) & 0x1FU;
    sip.front_bumpers = (high >> 1U) & 0x1FU;
    sip.control = f.i16();
    sip.flags = f.u16();
    sip.compass = f.u8();
    const int count = f.u8();
    for (int i = 0; i < count && !f.truncated(); ++i) {
        const auto number = f.u8();
        sip.sonars.push_back({number, f.u16()});
    }
    if (f.truncated()) return std::nullopt;
    if (f.atEnd()) return sip;
    sip.grip_state = f.u8();
    sip.general_io = f.u8();
    sip.analog = f.u8();
    sip.digital_in = f.u8();
    sip.digital_out = f.u8();
    sip.battery_x10 = f.u16();
    sip.charge_state = f.u8();
    sip.rotation_tenth_deg_s = f.i16();
    sip.faults = f.u16();
    sip.lateral_mm_s = f.i16();
    if (!f.atEnd()) sip.temperature_c = static_cast<std::int8_t>(f.u8());
    if (!f.atEnd()) sip.state_of_charge = f.u8();
    return sip;
}

Packet toPacket(const RobotConfig& c) {
    FieldWriter f;
    f.text(c.type).text(c.subtype).text(c.serial_number).u8(0);
    f.u16(c.top_rotation_deg_s)
        .u16(c.top_speed_mm_s)
        .u16(c.top_rotation_acceleration)
        .u16(c.top_acceleration);
    f.u16(0).text(c.name).u8(static_cast<unsigned>(c.sip_cycle_ms)).u8(0).u8(0).u16(c.gripper ? 1 : 0);
    f.u16(c.front_sonar ? 1 : 0).u8(c.rear_sonar ? 1 : 0);
    f.u16(c.low_battery_dv).u16(0).u16(c.watchdog_ms).u8(0).u16(0).u16(c.stall_pause_ms).u16(0).u16(0);
    f.u16(c.rotation_limit_deg_s)
        .u16(c.speed_limit_mm_s)
        .u16(c.rotation_acceleration)
        .u16(c.rotation_deceleration);
    f.u16(0).u16(0).u16(0).u16(c.acceleration).u16(c.deceleration).u16(0).u16(0).u16(0);
    f.u8(static_cast<unsigned>(c.front_bumpers)).u8(static_cast<unsigned>(c.rear_bumpers)).u8(0);
    f.u8(static_cast<unsigned>(c.sonar_cycle_ms))
        .u8(0)
        .u8(0)
        .u16(0)
        .u8(0)
        .u8(0)
        .u16(0)
        .u16(0)
        .text(c.firmware);
    // Gyro errors, kinematics delay, the lateral limits and the charge threshold: nothing that this robot
    // has.
    f.u16(0).u16(0).u8(0).u16(0).u16(0).u16(0).u16(0).u16(0).u16(0);
    return {kConfigPacket, f.take()};
}

std::optional<RobotConfig> parseRobotConfig(const Packet& packet) {
    if (packet.id != kConfigPacket) return std::nullopt;
    FieldReader f(packet.data);
    const auto skip = [&f](int bytes) {
        for (; bytes > 0; --bytes) f.u8();
    };
    RobotConfig c;
    c.type = f.text();
    c.subtype = f.text();
    c.serial_number = f.text();
    skip(1);
    c.top_rotation_deg_s = f.u16();
    c.top_speed_mm_s = f.u16();
    c.top_rotation_acceleration = f.u16();
    c.top_acceleration = f.u16();
    skip(2);
    c.name = f.text();
    c.sip_cycle_ms = f.u8();
    skip(2);
    c.gripper = f.u16() != 0;
    c.front_sonar = f.u16() != 0;
    c.rear_sonar = f.u8() != 0;
    c.low_battery_dv = f.u16();
    skip(2);
    c.watchdog_ms = f.u16();
    skip(3);
    c.stall_pause_ms = f.u16();
    skip(4);
    c.rotation_limit_deg_s = f.u16();
    c.speed_limit_mm_s = f.u16();
    c.rotation_acceleration = f.u16();
    c.rotation_deceleration = f.u16();
    skip(6);
    c.acceleration = f.u16();
    c.deceleration = f.u16();
    skip(6);
    c.front_bumpers = f.u8();
    c.rear_bumpers = f.u8();
    skip(1);
    c.sonar_cycle_ms = f.u8();
    skip(10);
    c.firmware = f.text();
    if (f.truncated()) return std::nullopt;
    return c;
}

Packet toPacket(const InputsOutputs& io) {
    FieldWriter f;
    f.u8(static_cast<unsigned>(io.digital_in.size()));
    for (const auto byte : io.digital_in) f.u8(byte);
    f.u8(static_cast<unsigned>(io.digital_out.size()));
    for (const auto byte : io.digital_out) f.u8(byte);
    f.u8(static_cast<unsigned>(io.analog.size()));
    for (const auto value : io.analog) f.u16(value);
    return {kIoPacket, f.take()};
}

std::optional<InputsOutputs> parseInputsOutputs(const Packet& packet) {
    if (packet.id != kIoPacket) return std::nullopt;
    FieldReader f(packet.data);
    InputsOutputs io;
    for (int n = f.u8(); n > 0 && !f.truncated(); --n) io.digital_in.push_back(f.u8());
    for (int n = f.u8(); n > 0 && !f.truncated(); --n) io.digital_out.push_back(f.u8());
    for (int n = f.u8(); n > 0 && !f.truncated(); --n) io.analog.push_back(f.u16());
    if (f.truncated()) return std::nullopt;
    return io;
}

}  // namespace axon::arcos
