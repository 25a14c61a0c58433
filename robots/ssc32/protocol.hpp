// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <span>
#include <string>

#include "common/clock.hpp"

/// The Lynxmotion SSC-32, a controller of up to 32 hobby servos on a serial line: lines of text that end with
/// a carriage return. It generates pulses and knows nothing else: no servo tells where it is.
namespace axon::ssc32 {

/// One servo's part of a group move. Pulses are whole microseconds from 500 to 2500.
struct ServoMove {
    std::size_t channel = 0;
    int pulse_us = 1500;
};

/// `#0P1500#1P900T50`: all start now and end together after `time` (whole milliseconds). Without a time
/// everything is to be there at once.
std::string encodeMove(std::span<const ServoMove> moves, Duration time);
std::string encodeMove(std::span<const ServoMove> moves);

/// `Q`: is answered `.` when the moves are over, `+` while one is not.
std::string encodeQuery();
/// `QP3`: is answered one byte, the pulse in 10 us, rounded down; 0 where there is no pulse since power-up.
std::string encodePulseQuery(std::size_t channel);

/// Forgets an unfinished line and ends all moves.
inline constexpr char kEscape = 27;
inline constexpr int kPulseStep_us = 10;  ///< of the answers

}  // namespace axon::ssc32
