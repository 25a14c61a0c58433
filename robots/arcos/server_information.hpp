// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>

#include "robots/arcos/packet.hpp"

namespace axon::arcos {

inline constexpr double kRadiansPerAngleUnit =
    0.001534;                                    // 2 pi / 4096, as the vendor's parameter files round it
inline constexpr int kPositionModulus = 0x8000;  // positions have 15 bits and wrap
inline constexpr int kNoEcho_mm = 5000;          // a sonar that hears nothing reports this

/// The server information packet (SIP) that the robot sends every 100 ms: what it is doing and what it
/// senses, in the units of the wire. A value type; RobotState (client_session.hpp) is the same in units a
/// person thinks in.
struct ServerInformation {
    struct Sonar {
        std::uint8_t number = 0;
        std::uint16_t range_mm = 0;
        bool operator==(const Sonar&) const = default;
    };
    // Bits of `flags`.
    static constexpr std::uint16_t kMotorsOn = 1U << 0U;
    static constexpr std::uint16_t kFirstSonarArrayOn = 1U << 1U;  // arrays 1 to 4 are bits 1 to 4

    bool moving = false;
    std::uint16_t x = 0;  // millimetres modulo kPositionModulus
    std::uint16_t y = 0;
    std::int16_t theta = 0;  // in kRadiansPerAngleUnit
    std::int16_t left_mm_s = 0;
    std::int16_t right_mm_s = 0;
    std::uint8_t battery_dv = 0;  // tenths of a volt
    bool left_stall = false;
    bool right_stall = false;
    std::uint8_t front_bumpers = 0;  // bit 0 is segment 1; five segments
    std::uint8_t rear_bumpers = 0;
    std::int16_t control = 0;
    std::uint16_t flags = 0;
    std::uint8_t compass = 0;
    std::vector<Sonar> sonars;  // those that fired since the last packet
    // Robots with old firmware end here.
    std::uint8_t grip_state = 0;  // GripState (gripper.hpp)
    std::uint8_t general_io = 0;  // GripperSwitches (gripper.hpp), where other robots tell the analogue port
    std::uint8_t analog = 0;
    std::uint8_t digital_in = 0;
    std::uint8_t digital_out = 0;
    std::uint16_t battery_x10 = 0;  // tenths of a volt again, with room for 48 V robots
    std::uint8_t charge_state = 0;
    std::int16_t rotation_tenth_deg_s = 0;
    std::uint16_t faults = 0;
    std::int16_t lateral_mm_s = 0;
    std::int8_t temperature_c = -128;  // -128: not measured
    std::uint8_t state_of_charge = 0;  // percent; 0: not measured

    bool operator==(const ServerInformation&) const = default;
};

Packet toPacket(const ServerInformation& sip);
/// Nothing for other packets and for packets that end before their sonar readings do.
std::optional<ServerInformation> parseServerInformation(const Packet& packet);

/// What the robot is and how it is tuned (CONFIGpac). The fields that this project gives a meaning; the
/// others of the packet are sent as zero and skipped when read.
struct RobotConfig {
    std::string type;
    std::string subtype;
    std::string serial_number;
    int top_rotation_deg_s = 0;
    int top_speed_mm_s = 0;
    int top_rotation_acceleration = 0;
    int top_acceleration = 0;
    std::string name;
    int sip_cycle_ms = 0;
    bool gripper = false;
    bool front_sonar = false;
    bool rear_sonar = false;
    int low_battery_dv = 0;
    int watchdog_ms = 0;
    int stall_pause_ms = 0;
    int rotation_limit_deg_s = 0;
    int speed_limit_mm_s = 0;
    int rotation_acceleration = 0;
    int rotation_deceleration = 0;
    int acceleration = 0;
    int deceleration = 0;
    int front_bumpers = 0;
    int rear_bumpers = 0;
    int sonar_cycle_ms = 0;
    std::string firmware;

    bool operator==(const RobotConfig&) const = default;
};

Packet toPacket(const RobotConfig& config);
std::optional<RobotConfig> parseRobotConfig(const Packet& packet);

/// Digital and analogue inputs and outputs (IOpac). Digital inputs are active low; on a PeopleBot bits 0 and
/// 1 of the fourth are the right and left table sensors, bits 2 and 3 the beams of the column.
struct InputsOutputs {
    Bytes digital_in;
    Bytes digital_out;
    std::vector<std::uint16_t> analog;

    bool operator==(const InputsOutputs&) const = default;
};

Packet toPacket(const InputsOutputs& io);
std::optional<InputsOutputs> parseInputsOutputs(const Packet& packet);

}  // namespace axon::arcos
