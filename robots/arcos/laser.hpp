// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>

#include "robots/arcos/packet.hpp"

namespace axon::arcos {

/// One of the packets that together are a scan of the laser range finder. They say nothing of angles: reading
/// n lies at start + n * resolution, as the client has asked for (LaserStart, LaserResolution; without asking
/// -90 degrees, which is to the right, and 1 degree: 181 readings from right to left).
struct LaserPacket {
    static constexpr std::size_t kMaximumReadings = 32;
    static constexpr std::uint16_t kNothing_mm = 32767;  ///< nothing within the laser's range
    struct Reading {
        std::uint16_t range_mm = 0;
        std::uint8_t reflectance = 0;  ///< extended packets only
        bool operator==(const Reading&) const = default;
    };

    bool extended = false;
    std::uint16_t x = 0;  ///< as in the server information, where the scan was taken; not in extended packets
    std::uint16_t y = 0;
    std::int16_t theta = 0;   ///< whole degrees
    std::uint16_t total = 0;  ///< readings of the whole scan
    std::uint16_t first = 0;  ///< number of the first reading in this packet
    std::vector<Reading> readings;

    bool operator==(const LaserPacket&) const = default;
};

/// More than kMaximumReadings readings is a bug of the caller (assertion).
Packet toPacket(const LaserPacket& laser);
/// Nothing for other packets, and for packets whose readings do not fit into the packet or into the scan.
std::optional<LaserPacket> parseLaserPacket(const Packet& packet);

/// Puts the packets of a scan together. A scan with a hole is dropped and counted. Not thread-safe.
class LaserScanAssembler {
  public:
    /// The whole scan, when this was its last packet.
    std::optional<std::vector<LaserPacket::Reading>> add(const LaserPacket& packet);
    std::uint64_t dropped() const { return dropped_; }

  private:
    std::vector<LaserPacket::Reading> readings_;
    std::uint16_t total_ = 0;
    std::uint64_t dropped_ = 0;
};

}  // namespace axon::arcos
