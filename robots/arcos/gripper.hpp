// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>

#include "robots/arcos/packet.hpp"

namespace axon::arcos {

/// What GRIPPER (33) can be asked to do. The paddles and the lift move at once and independently.
enum class GripperOrder : int {
    Open = 1,
    Close = 2,  ///< until both paddles feel something, and then for the grasp time
    Stop = 3,   ///< the paddles
    LiftUp = 4,
    LiftDown = 5,
    LiftStop = 6,
    Store = 7,       ///< paddles closed, lift up
    Deploy = 8,      ///< paddles open, lift down
    Halt = 15,       ///< paddles and lift
    Press = 16,      ///< the next GripperValue is the grasp time in units of 20 ms; then close
    LiftCarry = 17,  ///< the next GripperValue is how long the lift moves, in 20 ms; negative is down
};

/// The gripper's switches: the byte after the grip state in the server information of a robot whose gripper
/// is wired to the General-I/O port, as a PeopleBot's is, and the second byte of the gripper packet. A value
/// type. (On the wire some bits are active low; here true is always what the name says.)
struct GripperSwitches {
    bool paddles_open = false;   ///< at the open limit
    bool lift_at_limit = false;  ///< all the way up or all the way down
    bool outer_beam_broken = false;
    bool inner_beam_broken = false;
    bool left_paddle_pressed = false;
    bool right_paddle_pressed = false;
    bool lift_moving = false;
    bool paddles_moving = false;

    bool operator==(const GripperSwitches&) const = default;
};
std::uint8_t toByte(const GripperSwitches& switches);
GripperSwitches parseGripperSwitches(std::uint8_t byte);

/// The grip state byte of the server information.
struct GripState {
    bool paddles_open = false;
    bool paddles_closed = false;  ///< on something or on each other
    bool paddles_moving = false;
    bool paddles_error = false;
    bool lift_up = false;  ///< at the upper limit
    bool lift_down = false;
    bool lift_moving = false;
    bool lift_error = false;

    bool operator==(const GripState&) const = default;
};
std::uint8_t toByte(const GripState& state);
GripState parseGripState(std::uint8_t byte);

/// GRIPPERpac, the answer to GripperRequest.
struct GripperPacket {
    static constexpr std::uint8_t kNone = 0;
    static constexpr std::uint8_t kUserIo = 1;
    static constexpr std::uint8_t kGeneralIo = 2;  ///< PeopleBot
    std::uint8_t type = kNone;
    GripperSwitches switches;
    std::uint8_t grasp_time = 0;  ///< units of 20 ms that the paddles go on pressing

    bool operator==(const GripperPacket&) const = default;
};
Packet toPacket(const GripperPacket& gripper);
/// Nothing for other packets and for packets that are too short.
std::optional<GripperPacket> parseGripperPacket(const Packet& packet);

}  // namespace axon::arcos
