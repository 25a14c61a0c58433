// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "common/clock.hpp"
#include "common/result.hpp"

namespace axon::arcos {

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
};

/// Opens a link, waiting for at most the given time.
using StreamOpener = std::function<Result<std::unique_ptr<ByteStream>>(Duration timeout)>;

/// Opens TCP connections to "host:port". Throws std::invalid_argument for what is not that.
StreamOpener tcpStreams(const std::string& address);

/// Opens a serial line, raw, eight bits, no parity: "/dev/ttyS0" at 9600 baud, which ARCOS expects after it
/// was switched on, "/dev/ttyUSB0:38400" at another speed. A pseudo terminal takes any speed. Throws
/// std::invalid_argument for a speed that serial lines do not have.
StreamOpener serialStreams(const std::string& device);

/// What begins with "/" is a serial line, everything else host:port. Throws as the two above.
StreamOpener robotStreams(const std::string& address);

}  // namespace axon::arcos
