// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/gripper.hpp"

namespace axon::arcos {
namespace {

/// Bits from the lowest up.
template <class... Bools>
std::uint8_t pack(Bools... bits) {
    unsigned byte = 0;
    unsigned n = 0;
    ((byte |= bits ? 1U << n : 0U, ++n), ...);
    return static_cast<std::uint8_t>(byte);
}

bool bit(std::uint8_t byte, unsigned n) {
    return (byte & (1U << n)) != 0;
}

}  // namespace

std::uint8_t toByte(const GripperSwitches& s) {
    return pack(!s.paddles_open, !s.lift_at_limit, s.outer_beam_broken, s.inner_beam_broken,
                !s.left_paddle_pressed, !s.right_paddle_pressed, s.lift_moving, s.paddles_moving);
}

GripperSwitches parseGripperSwitches(std::uint8_t byte) {
    return {!bit(byte, 0), !bit(byte, 1), bit(byte, 2), bit(byte, 3),
            !bit(byte, 4), !bit(byte, 5), bit(byte, 6), bit(byte, 7)};
}

std::uint8_t toByte(const GripState& s) {
    return pack(s.paddles_open, s.paddles_closed, s.paddles_moving, s.paddles_error, s.lift_up, s.lift_down,
                s.lift_moving, s.lift_error);
}

GripState parseGripState(std::uint8_t byte) {
    return {bit(byte, 0), bit(byte, 1), bit(byte, 2), bit(byte, 3),
            bit(byte, 4), bit(byte, 5), bit(byte, 6), bit(byte, 7)};
}

Packet toPacket(const GripperPacket& gripper) {
    FieldWriter fields;
    fields.u8(gripper.type).u8(toByte(gripper.switches)).u8(gripper.grasp_time);
    return {kGripperPacket, fields.take()};
}

std::optional<GripperPacket> parseGripperPacket(const Packet& packet) {
    if (packet.id != kGripperPacket) return std::nullopt;
    FieldReader fields(packet.data);
    GripperPacket gripper;
    gripper.type = fields.u8();
    gripper.switches = parseGripperSwitches(fields.u8());
    gripper.grasp_time = fields.u8();
    if (fields.truncated()) return std::nullopt;
    return gripper;
}

}  // namespace axon::arcos
