// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <chrono>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "lab/cyton/geometry.hpp"

namespace axon::lab {

/// The Lynxmotion SSC-32 of a Cyton: 32 channels of servo pulses, told over a serial line. Lines end with a
/// carriage return; capitals, small letters and blanks do not matter.
///
/// | line | does | answers |
/// |---|---|---|
/// | `#<ch>P<us>[S<us/s>] ... [T<ms>]` | one group: starts together, and ends together, after the longest of
/// T and what each S needs; without S and T at once | nothing | | `Q` | | `.` every move is over, `+` one is
/// not | | `QP<ch>` (any number in a line) | | one byte each: the commanded pulse in 10 us, rounded down | |
/// `VER` | | `SSC32-V2.01XE` and a carriage return | | `STOP<ch>` | the channel keeps the pulse it has |
/// nothing | | ESC (a byte, anywhere) | the unfinished line is forgotten, every move ends where it is |
/// nothing |
///
/// What it gives is what it commands: nobody measures where the arm is, as with the real one. After the start
/// the pulses are those of the vendor's home position (assumed: written as the board's start-up string).
/// Channels 0 to 6 are the joints, 7 the gripper, the others have no servo. Pulses are clamped to the servo's
/// range; the servos follow no faster than the vendor's highest rate, whatever is asked.
///
/// Threads: none, not thread-safe. I/O-free: time comes in with step(). A line that is unknown, malformed or
/// longer than kLongestLine changes nothing but a counter, also when only one of its groups is.
class Ssc32Server {
  public:
    using Duration = std::chrono::nanoseconds;
    static constexpr std::size_t kChannels = 32;
    static constexpr std::size_t kLongestLine = 512;

    struct Counters {
        std::uint64_t moves = 0;
        std::uint64_t queries = 0;
        std::uint64_t refused_lines = 0;  ///< unknown, malformed or too long
        std::uint64_t clamped_pulses = 0;
    };

    Ssc32Server();

    /// Bytes of the client; gives the answers.
    std::vector<std::uint8_t> receive(std::span<const std::uint8_t> bytes);
    /// A new client does not inherit half a line. Moves go on: the board does not know who is listening.
    void clientConnected();
    void step(Duration period);

    /// Where the servos are told to be now: rad, and metres that each claw is open.
    std::array<double, cyton::kChannels> targets() const;
    /// The commanded pulse, not yet limited by the servo's rate.
    double pulse_us(std::size_t channel) const { return channels_[channel].pulse_us; }
    bool moving() const;
    const Counters& counters() const { return counters_; }
    /// A fault: the servo stays where it is, whatever it is told.
    void setStuck(std::size_t channel, bool stuck) { channels_[channel].stuck = stuck; }

  private:
    struct Channel {
        double pulse_us = 1500;
        double servo_us = 1500;  // lags behind by the servo's rate
        double from_us = 1500;
        double to_us = 1500;
        Duration gone{};
        Duration lasts{};  // zero: no move
        bool stuck = false;
    };
    struct Line;

    void onLine(std::string_view line, std::vector<std::uint8_t>& answers);
    bool move(Line& line);
    bool query(Line& line, std::vector<std::uint8_t>& answers);
    bool stopChannel(Line& line);
    void cancel();

    std::array<Channel, kChannels> channels_;
    std::string line_;
    bool too_long_ = false;
    Counters counters_;
};

}  // namespace axon::lab
