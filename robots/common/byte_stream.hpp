// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "common/clock.hpp"
#include "common/result.hpp"

namespace axon::robots {

/// The speed of a serial line.
struct LineSpeed {
    int baud = 0;   ///< the present one; 0: it is no serial line
    int asked = 0;  ///< that its address asks for in so many words; 0: the protocol may choose
};

/// A link that carries bytes both ways to a robot: a TCP connection or a serial line.
/// Threads: read() on one thread, write() on any; the owner makes sure that no two write at once. Owns its
/// descriptor.
class ByteStream {
  public:
    virtual ~ByteStream() = default;
    /// Readable when there is something to read(); for poll(2).
    virtual int descriptor() const = 0;
    /// What is there, without waiting: bytes read, 0 for nothing yet, -1 when the link is gone.
    virtual int read(std::span<std::uint8_t> into) = 0;
    /// All bytes at once, without waiting, or false: a link that cannot take a few bytes is as good as gone.
    virtual bool write(std::span<const std::uint8_t> bytes) = 0;

    virtual LineSpeed speed() const { return {}; }
    /// Changes the speed of a serial line, both ways, from the next byte on. False where there is no speed,
    /// and for a speed that the line does not have; it then keeps the one it has. Must not be called while
    /// another thread writes.
    virtual bool setSpeed(int /*baud*/) { return false; }
};

/// Opens a link, waiting for at most the given time.
using StreamOpener = std::function<Result<std::unique_ptr<ByteStream>>(Duration timeout)>;

/// Of a serial line whose address names none: what ARCOS and the SICK LMS-200 expect after they were switched
/// on.
inline constexpr int kFirstSpeed = 9600;

/// Opens TCP connections to "host:port". Throws std::invalid_argument for what is not that.
StreamOpener tcpStreams(const std::string& address);

/// Opens a serial line, raw, eight bits, no parity: "/dev/ttyS0" at kFirstSpeed, "/dev/ttyUSB0:38400" at the
/// speed that is asked for. A pseudo terminal takes any speed. Throws std::invalid_argument for a speed that
/// serial lines do not have.
StreamOpener serialStreams(const std::string& device);

/// What begins with "/" is a serial line, everything else host:port. Throws as the two above.
StreamOpener robotStreams(const std::string& address);

}  // namespace axon::robots
