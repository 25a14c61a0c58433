// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/laser.hpp"

#include <cassert>
#include <utility>

namespace axon::arcos {

Packet toPacket(const LaserPacket& laser) {
    assert(laser.readings.size() <= LaserPacket::kMaximumReadings);
    FieldWriter f;
    if (!laser.extended) f.u16(laser.x).u16(laser.y).u16(laser.theta);
    f.u16(laser.total).u16(laser.first).u8(static_cast<unsigned>(laser.readings.size()));
    for (const auto& reading : laser.readings) {
        f.u16(reading.range_mm);
        if (laser.extended) f.u8(reading.reflectance).u16(0);
    }
    if (laser.extended) f.u8(0).u8(0);  // which laser, and flags that are reserved
    return {laser.extended ? kExtendedLaserPacket : kLaserPacket, f.take()};
}

std::optional<LaserPacket> parseLaserPacket(const Packet& packet) {
    if (packet.id != kLaserPacket && packet.id != kExtendedLaserPacket) return std::nullopt;
    FieldReader f(packet.data);
    LaserPacket laser;
    laser.extended = packet.id == kExtendedLaserPacket;
    if (!laser.extended) {
        laser.x = f.u16();
        laser.y = f.u16();
        laser.theta = f.i16();
    }
    laser.total = f.u16();
    laser.first = f.u16();
    const int count = f.u8();
    for (int i = 0; i < count && !f.truncated(); ++i) {
        LaserPacket::Reading reading{f.u16()};
        if (laser.extended) {
            reading.reflectance = f.u8();
            f.u16();
        }
        laser.readings.push_back(reading);
    }
    if (f.truncated() || laser.first + count > laser.total) return std::nullopt;
    return laser;
}

std::optional<std::vector<LaserPacket::Reading>> LaserScanAssembler::add(const LaserPacket& packet) {
    if (packet.first == 0) {
        if (!readings_.empty()) ++dropped_;
        readings_.clear();
        total_ = packet.total;
    }
    if (packet.first != readings_.size() || packet.total != total_) {
        if (!readings_.empty()) ++dropped_;
        readings_.clear();
        return std::nullopt;
    }
    readings_.insert(readings_.end(), packet.readings.begin(), packet.readings.end());
    if (readings_.size() < total_ || readings_.empty()) return std::nullopt;
    return std::exchange(readings_, {});
}

}  // namespace axon::arcos
