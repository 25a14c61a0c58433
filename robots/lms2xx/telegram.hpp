// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/clock.hpp"

/// The telegrams of the laser range finders SICK LMS-200, -211, -220, -221 and -291 on a serial line, as the
/// vendor's telegram listing (8007954/Q501, 2006) tells them.
namespace axon::lms2xx {

using Bytes = std::vector<std::uint8_t>;

/// Some of what a host may ask. The laser's answer has the same number with the highest bit set.
enum class Command : std::uint8_t {
    Mode = 0x20,               // Mode
    Measure = 0x30,            // 1: one scan
    Status = 0x31,             //
    Variant = 0x3B,            // Variant
    ReadConfiguration = 0x74,  //
};

/// What Command::Mode switches to. Its answer has one byte, 0 when it is done.
enum class Mode : std::uint8_t {
    ContinuousOutput = 0x24,  // every scan that the line has room for
    OutputOnRequest = 0x25,
    Baud38400 = 0x40,
    Baud19200 = 0x41,
    Baud9600 = 0x42,
    Baud500000 = 0x48,  // RS-422 only
};

inline constexpr std::uint8_t kModeAnswer = 0xA0;
inline constexpr std::uint8_t kMeasuredValues = 0xB0;
inline constexpr std::uint8_t kVariantAnswer = 0xBB;
inline constexpr std::uint8_t kConfigurationAnswer = 0xF4;
inline constexpr std::uint8_t kPowerOn = 0x90;  // unasked: the laser was switched on, and is ready
inline constexpr std::uint8_t kRefused = 0x92;  // the command is unknown, or not possible now

/// One telegram. On the wire: STX (02) | address | length (2) | command | data | CRC (2), low bytes first;
/// length counts command and data. The CRC is over all before it.
struct Telegram {
    static constexpr std::uint8_t kAnyLaser = 0x00;   ///< address of a request: whoever is on the line
    static constexpr std::uint8_t kFromLaser = 0x80;  ///< in addresses of answers
    static constexpr std::size_t kMaximumLength =
        808;                                    ///< a scan of 401 values with two indices: 814 bytes in all
    static constexpr std::size_t kFraming = 6;  ///< bytes besides command and data

    std::uint8_t address = kAnyLaser;
    std::uint8_t command = 0;
    Bytes data;  ///< of an answer: its last byte is the status (Status)

    bool operator==(const Telegram&) const = default;
};

/// The vendor's CRC: polynomial 8005, begins at zero, one step for each byte, with the byte before it mixed
/// in.
std::uint16_t crc16(std::span<const std::uint8_t> bytes);

/// Data longer than kMaximumLength - 1 is a bug of the caller (assertion).
Bytes encode(const Telegram& telegram);

/// What stands alone on the line, between telegrams: a request arrived, or arrived damaged.
inline constexpr std::uint8_t kAck = 0x06;
inline constexpr std::uint8_t kNak = 0x15;

/// The last byte of an answer's data.
struct Status {
    explicit Status(std::uint8_t byte) : severity(byte & 7U), polluted((byte & 0x80U) != 0) {}
    /// The laser does not work. 5 to 7 are not used.
    bool faulty() const { return severity >= 3; }

    unsigned severity;  ///< 0 good, 1 information, 2 warning, 3 error, 4 fatal
    bool polluted;      ///< the front screen is dirty
};

/// Finds telegrams, and ACK and NAK between them, in a stream of bytes. Noise is skipped and counted. A
/// length that no telegram has and a wrong CRC cost one byte: the search goes on right behind the false
/// start, so that a damaged telegram costs itself and not the one after it. The rest of a telegram that does
/// not follow within kPartialTimeout is given up. Holds at most one telegram's bytes. I/O-free, not
/// thread-safe.
class TelegramReader {
  public:
    /// The listing allows 14 ms between two bytes of the laser; a computer's drivers add to that.
    static constexpr Duration kPartialTimeout = std::chrono::milliseconds{200};

    enum class From { Laser, Host };
    struct Item {
        enum class Kind { Telegram, Ack, Nak };
        Kind kind = Kind::Telegram;
        Telegram telegram;            ///< Kind::Telegram
        std::size_t followed_by = 0;  ///< Kind::Telegram: bytes of the same feed() that came after it

        /// The same was said, however it arrived.
        bool operator==(const Item& other) const { return kind == other.kind && telegram == other.telegram; }
    };

    /// `from`: whose telegrams are read. The others, which an adapter that echoes brings back, are noise.
    explicit TelegramReader(From from) : from_(from) {}

    /// All that these bytes complete, in order.
    std::vector<Item> feed(std::span<const std::uint8_t> bytes, TimePoint now);
    /// Forgets a partial telegram: for a new connection, and after a change of speed.
    void reset() { buffer_.clear(); }
    /// Whether a telegram has begun, as far as one can tell.
    bool partial() const { return !buffer_.empty(); }

    std::uint64_t badCrcs() const { return bad_crcs_; }
    std::uint64_t noiseBytes() const { return noise_bytes_; }

  private:
    void find(std::vector<Item>& found);

    const From from_;
    Bytes buffer_;
    TimePoint last_feed_{};
    std::uint64_t bad_crcs_ = 0;
    std::uint64_t noise_bytes_ = 0;
};

}  // namespace axon::lms2xx
