// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/packet.hpp"

#include <algorithm>
#include <cassert>
#include <cstdlib>

namespace axon::arcos {
namespace {

constexpr std::uint8_t kFirstSync = 0xFA;
constexpr std::uint8_t kSecondSync = 0xFB;
constexpr std::uint8_t kPositiveInteger = 0x3B;
constexpr std::uint8_t kNegativeInteger = 0x1B;
constexpr std::uint8_t kText = 0x2B;
constexpr int kLeastInteger = -0x8000;
constexpr int kGreatestInteger = 0x7FFF;

}  // namespace

std::uint16_t checksum(std::span<const std::uint8_t> id_and_data) {
    unsigned sum = 0;
    std::size_t i = 0;
    for (; i + 1 < id_and_data.size(); i += 2)
        sum = (sum + (id_and_data[i] << 8U) + id_and_data[i + 1]) & 0xFFFFU;
    if (i < id_and_data.size()) sum ^= id_and_data[i];
    return static_cast<std::uint16_t>(sum);
}

Bytes encode(const Packet& packet) {
    assert(packet.data.size() <= kMaximumData);
    Bytes wire;
    wire.reserve(packet.data.size() + 6);
    wire.push_back(kFirstSync);
    wire.push_back(kSecondSync);
    wire.push_back(static_cast<std::uint8_t>(packet.data.size() + 3));
    wire.push_back(packet.id);
    for (const auto byte : packet.data) wire.push_back(byte);
    const auto sum = checksum(std::span(wire).subspan(3));
    wire.push_back(static_cast<std::uint8_t>(sum >> 8U));
    wire.push_back(static_cast<std::uint8_t>(sum & 0xFFU));
    return wire;
}

Bytes encodeCommand(Command command) {
    return encode({static_cast<std::uint8_t>(command), {}});
}

Bytes encodeCommand(Command command, int argument) {
    argument = std::clamp(argument, kLeastInteger, kGreatestInteger);
    FieldWriter fields;
    fields.u8(argument < 0 ? kNegativeInteger : kPositiveInteger).u16(std::abs(argument));
    return encode({static_cast<std::uint8_t>(command), fields.take()});
}

Bytes encodeCommand(Command command, std::string_view argument) {
    argument = argument.substr(0, kMaximumData - 2);
    FieldWriter fields;
    fields.u8(kText).u8(static_cast<unsigned>(argument.size()));
    for (const char c : argument) fields.u8(static_cast<std::uint8_t>(c));
    return encode({static_cast<std::uint8_t>(command), fields.take()});
}

Argument parseArgument(const Packet& command) {
    if (command.data.empty()) return {};
    FieldReader fields(command.data);
    const auto type = fields.u8();
    Argument argument;
    if (type == kText) {
        const std::size_t length = fields.u8();
        if (command.data.size() < 2 + length) return {Argument::Kind::Malformed};
        argument.kind = Argument::Kind::Text;
        argument.text.assign(command.data.begin() + 2,
                             command.data.begin() + 2 + static_cast<std::ptrdiff_t>(length));
        return argument;
    }
    const int sent = fields.u16();
    if ((type != kPositiveInteger && type != kNegativeInteger) || fields.truncated())
        return {Argument::Kind::Malformed};
    // Sign and magnitude; but a client that packs two bytes may send 16 bits without a sign.
    const int value = type == kNegativeInteger ? -sent : static_cast<std::int16_t>(sent);
    if (value < kLeastInteger) return {Argument::Kind::Malformed};
    argument.kind = Argument::Kind::Integer;
    argument.value = value;
    argument.raw = static_cast<std::uint16_t>(value);
    return argument;
}

std::uint8_t FieldReader::u8() {
    if (rest_.empty()) {
        truncated_ = true;
        return 0;
    }
    const auto value = rest_.front();
    rest_ = rest_.subspan(1);
    return value;
}

std::uint16_t FieldReader::u16() {
    if (rest_.size() < 2) {
        truncated_ = true;
        rest_ = {};
        return 0;
    }
    const auto value = static_cast<std::uint16_t>(rest_[0] | (rest_[1] << 8U));
    rest_ = rest_.subspan(2);
    return value;
}

std::string FieldReader::text() {
    const auto end = std::find(rest_.begin(), rest_.end(), 0);
    std::string value(rest_.begin(), end);
    if (end == rest_.end()) {
        truncated_ = true;
        rest_ = {};
    } else {
        rest_ = rest_.subspan(value.size() + 1);
    }
    return value;
}

FieldWriter& FieldWriter::u8(unsigned value) {
    data_.push_back(static_cast<std::uint8_t>(value));
    return *this;
}

FieldWriter& FieldWriter::u16(int value) {
    const auto bits = static_cast<unsigned>(value);
    return u8(bits & 0xFFU).u8((bits >> 8U) & 0xFFU);
}

FieldWriter& FieldWriter::text(std::string_view value) {
    data_.insert(data_.end(), value.begin(), value.end());
    data_.push_back(0);
    return *this;
}

std::vector<Packet> PacketReader::feed(std::span<const std::uint8_t> bytes, TimePoint now) {
    buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
    arrived_.resize(buffer_.size(), now);

    std::vector<Packet> packets;
    std::size_t at = 0;
    const auto skip = [&] {
        ++at;
        ++garbage_bytes_;
    };
    while (at < buffer_.size()) {
        const std::span rest(buffer_.data() + at, buffer_.size() - at);
        if (rest[0] != kFirstSync || (rest.size() > 1 && rest[1] != kSecondSync) ||
            (rest.size() > 2 && (rest[2] < 3 || rest[2] > kMaximumCount))) {
            skip();
            continue;
        }
        if (rest.size() < 3 || rest.size() < 3U + rest[2]) {  // the packet is not complete yet
            if (now - arrived_[at] <= kPartialTimeout) break;
            skip();
            continue;
        }
        const std::size_t count = rest[2];
        const auto id_and_data = rest.subspan(3, count - 2);
        const auto sum = static_cast<std::uint16_t>((rest[count + 1] << 8U) | rest[count + 2]);
        if (sum != checksum(id_and_data)) {
            ++bad_checksums_;
            ++at;
            continue;
        }
        packets.push_back({id_and_data[0], Bytes(id_and_data.begin() + 1, id_and_data.end())});
        at += 3 + count;
    }
    buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(at));
    arrived_.erase(arrived_.begin(), arrived_.begin() + static_cast<std::ptrdiff_t>(at));
    return packets;
}

}  // namespace axon::arcos
