// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/clock.hpp"

/// ARCOS, the protocol of the Pioneer family's onboard controller, as this project speaks it: on the side of
/// the robot application (ClientSession) and on the side of the virtual robot (lab/arcos_server.hpp).
namespace axon::arcos {

using Bytes = std::vector<std::uint8_t>;

/// What travels between client and robot: an id and at most kMaximumData bytes. On the wire
///     FA FB | count | id | data ... | checksum, high byte first
/// where count is everything after itself, 3 to kMaximumCount. All integers inside the data are
/// little-endian.
struct Packet {
    std::uint8_t id = 0;
    Bytes data;

    bool operator==(const Packet&) const = default;
};

inline constexpr std::size_t kMaximumCount = 200;               // ARCOS's
inline constexpr std::size_t kMaximumData = kMaximumCount - 3;  // count includes id and checksum

/// The sum over id and data of big-endian byte pairs modulo 2^16; an odd last byte is combined by exclusive
/// or.
std::uint16_t checksum(std::span<const std::uint8_t> id_and_data);

/// The packet's wire form. Data longer than kMaximumData is a bug of the caller (assertion).
Bytes encode(const Packet& packet);

/// What a client orders. The numbers are ARCOS's; SYNC0 to SYNC2 share theirs with PULSE, OPEN and CLOSE, the
/// state of the session tells them apart.
enum class Command : std::uint8_t {
    Pulse = 0,
    Open = 1,
    Close = 2,
    Enable = 4,
    SetA = 5,
    SetV = 6,
    SetO = 7,
    Move = 8,
    Rotate = 9,
    SetRv = 10,
    Vel = 11,
    Head = 12,
    DHead = 13,
    Config = 18,
    Encoder = 19,
    RVel = 21,
    SetRa = 23,
    Sonar = 28,
    Stop = 29,
    DigOut = 30,
    Vel2 = 32,
    Gripper = 33,             // GripperOrder (gripper.hpp)
    OldLaserOn = 35,          // 0 off, 1 on, 2 on with reflectances; ids 35 to 38 as old clients use them
    GripperValue = 36,        // right after Gripper 16 or 17; else the old laser's first angle
    GripperRequest = 37,      // 0 stop, 1 once, 2 continuously; any other value: the old laser's last angle
    OldLaserResolution = 38,  // hundredths of a degree
    IoRequest = 40,
    Tty2 = 42,    // a text: bytes for the serial port that the camera is wired to
    GetAux = 43,  // so many bytes that came in on it are sent as kAuxPacket; 0: they are forgotten
    BumpStall = 44,
    JoyDrive = 47,
    HostBaud = 50,  // kHostBaudCodes; until the robot is switched off
    EStop = 55,
    QStop = 57,
    BatteryInfo = 62,
    LaserOn = 230,          // as OldLaserOn
    LaserStart = 231,       // degrees from straight ahead, the first reading; -90 is to the right
    LaserEnd = 232,         // degrees, the last reading
    LaserResolution = 233,  // degrees between readings
};

/// The speeds of the robot's serial line that HOSTBAUD's argument, 0 to 4, stands for.
inline constexpr std::array<int, 5> kHostBaudCodes{9600, 19200, 38400, 57600, 115200};

/// What a robot sends.
inline constexpr std::uint8_t kStandingPacket = 0x32;  // server information, motors at rest
inline constexpr std::uint8_t kMovingPacket = 0x33;
inline constexpr std::uint8_t kConfigPacket = 0x20;
inline constexpr std::uint8_t kIoPacket = 0xF0;
inline constexpr std::uint8_t kLaserPacket = 0x60;          // laser.hpp
inline constexpr std::uint8_t kExtendedLaserPacket = 0x61;  // with reflectances
inline constexpr std::uint8_t kAuxPacket = 0xB0;            // bytes from the camera, nothing else
inline constexpr std::uint8_t kGripperPacket = 0xE0;        // gripper.hpp

/// A command without, with an integer, with a text argument. Integers are sent as sign and magnitude, clamped
/// to -0x8000 to 0x7FFF.
Bytes encodeCommand(Command command);
Bytes encodeCommand(Command command, int argument);
Bytes encodeCommand(Command command, std::string_view argument);

/// The argument of a command as it arrived.
struct Argument {
    enum class Kind { None, Integer, Text, Malformed };
    Kind kind = Kind::None;
    int value = 0;          ///< Integer: with its sign, -0x8000 to 0x7FFF
    std::uint16_t raw = 0;  ///< Integer: its 16 bits in two's complement, for commands that pack two bytes
    std::string text;       ///< Text
};
Argument parseArgument(const Packet& command);

/// Reads little-endian fields off packet data. Never reads beyond the end: it then gives zero and remembers
/// that the packet was too short.
class FieldReader {
  public:
    explicit FieldReader(std::span<const std::uint8_t> data) : rest_(data) {}

    std::uint8_t u8();
    std::uint16_t u16();
    std::int16_t i16() { return static_cast<std::int16_t>(u16()); }
    /// Up to and without the terminating zero.
    std::string text();
    bool atEnd() const { return rest_.empty(); }
    bool truncated() const { return truncated_; }

  private:
    std::span<const std::uint8_t> rest_;
    bool truncated_ = false;
};

/// The counterpart of FieldReader.
class FieldWriter {
  public:
    FieldWriter& u8(unsigned value);
    FieldWriter& u16(int value);  ///< signed values in two's complement
    FieldWriter& text(std::string_view value);
    Bytes take() { return std::move(data_); }

  private:
    Bytes data_;
};

/// Finds packets in a stream of bytes: skips garbage, ignores and counts packets with a wrong checksum, and
/// looks for the next packet right after the false start, so one damaged byte never costs more than the
/// packet it is in. What looks like a packet's beginning is given up kPartialTimeout after it arrived if the
/// rest has not come by then; what came after it is kept, and is searched at once. Holds at most one packet's
/// bytes. I/O-free, not thread-safe.
class PacketReader {
  public:
    /// The longest packet takes 211 ms on a serial line of 9600 baud.
    static constexpr Duration kPartialTimeout = std::chrono::milliseconds{300};

    /// All packets completed by these bytes, in order. To be called without bytes as well, every 50 ms or so,
    /// lest a packet behind a false start waits for whatever comes next.
    std::vector<Packet> feed(std::span<const std::uint8_t> bytes, TimePoint now);
    /// Forgets a partial packet: for a new connection.
    void reset() {
        buffer_.clear();
        arrived_.clear();
    }

    std::uint64_t badChecksums() const { return bad_checksums_; }
    std::uint64_t garbageBytes() const { return garbage_bytes_; }

  private:
    Bytes buffer_;
    std::vector<TimePoint> arrived_;  // of each byte
    std::uint64_t bad_checksums_ = 0;
    std::uint64_t garbage_bytes_ = 0;
};

}  // namespace axon::arcos
