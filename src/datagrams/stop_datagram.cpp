// SPDX-License-Identifier: GPL-2.0-or-later
#include "datagrams/stop_datagram.hpp"

#include <sodium.h>

#include <cstring>
#include <limits>
#include <string>

namespace axon::datagrams {
namespace {

constexpr std::string_view kMagic = "AxSt";
constexpr std::uint8_t kVersion = 1;
constexpr std::size_t kMacBytes = 16;  // of HMAC-SHA256, truncated as RFC 2104, section 5, allows
constexpr std::size_t kAuthentic = kStopDatagramBytes - kMacBytes;

// Where each field begins.
constexpr std::size_t kVersionAt = 4, kKindAt = 5, kCauseAt = 6, kReservedAt = 7, kEpochAt = 8,
                      kNumberAt = 12, kGenerationAt = 16, kSequenceAt = 20, kSentAt = 28, kSenderAt = 36;
static_assert(kSenderAt + 16 == kAuthentic);

void put(char* at, std::uint64_t value, int bytes) {
    for (int i = bytes - 1; i >= 0; --i, value >>= 8U) at[i] = static_cast<char>(value & 255U);
}

std::uint64_t take(const char* at, int bytes) {
    std::uint64_t value = 0;
    for (int i = 0; i < bytes; ++i) value = value << 8U | static_cast<unsigned char>(at[i]);
    return value;
}

std::array<unsigned char, kMacBytes> macOf(const char* bytes, std::string_view key) {
    crypto_auth_hmacsha256_state state;
    crypto_auth_hmacsha256_init(&state, reinterpret_cast<const unsigned char*>(key.data()), key.size());
    crypto_auth_hmacsha256_update(&state, reinterpret_cast<const unsigned char*>(bytes), kAuthentic);
    std::array<unsigned char, crypto_auth_hmacsha256_BYTES> whole{};
    crypto_auth_hmacsha256_final(&state, whole.data());
    std::array<unsigned char, kMacBytes> mac{};
    std::memcpy(mac.data(), whole.data(), mac.size());
    return mac;
}

}  // namespace

StopDatagramBytes encode(const StopDatagram& datagram, std::string_view key) {
    StopDatagramBytes bytes{};
    char* const at = bytes.data();
    std::memcpy(at, kMagic.data(), kMagic.size());
    put(at + kVersionAt, kVersion, 1);
    put(at + kKindAt, static_cast<std::uint8_t>(datagram.kind), 1);
    put(at + kCauseAt, static_cast<std::uint8_t>(datagram.cause), 1);
    put(at + kEpochAt, static_cast<std::uint32_t>(datagram.lease.epoch), 4);
    put(at + kNumberAt, static_cast<std::uint32_t>(datagram.lease.number), 4);
    put(at + kGenerationAt, datagram.generation, 4);
    put(at + kSequenceAt, static_cast<std::uint64_t>(datagram.sequence), 8);
    put(at + kSentAt, static_cast<std::uint64_t>(datagram.sent_at_us), 8);
    const auto sender = datagram.sender.bytes();
    std::memcpy(at + kSenderAt, sender.data(), sender.size());
    const auto mac = macOf(at, key);
    std::memcpy(at + kAuthentic, mac.data(), mac.size());
    return bytes;
}

std::optional<LeaseNumber> leaseOf(std::string_view bytes) {
    if (bytes.size() != kStopDatagramBytes || !bytes.starts_with(kMagic)) return std::nullopt;
    const char* const at = bytes.data();
    if (take(at + kVersionAt, 1) != kVersion || take(at + kReservedAt, 1) != 0) return std::nullopt;
    constexpr std::uint64_t kMost = std::numeric_limits<std::int32_t>::max();
    const auto epoch = take(at + kEpochAt, 4);
    const auto number = take(at + kNumberAt, 4);
    if (epoch == 0 || epoch > kMost || number == 0 || number > kMost) return std::nullopt;
    return LeaseNumber{static_cast<std::int32_t>(epoch), static_cast<std::int32_t>(number)};
}

std::optional<StopDatagram> decode(std::string_view bytes, std::string_view key) {
    const auto lease = leaseOf(bytes);
    if (!lease || key.size() != kLeaseKeyBytes) return std::nullopt;
    const char* const at = bytes.data();
    const auto mac = macOf(at, key);
    if (sodium_memcmp(mac.data(), at + kAuthentic, mac.size()) != 0) return std::nullopt;

    StopDatagram datagram;
    const auto kind = take(at + kKindAt, 1);
    const auto sequence = take(at + kSequenceAt, 8);
    if (kind != static_cast<std::uint8_t>(StopDatagram::Kind::Stop) &&
        kind != static_cast<std::uint8_t>(StopDatagram::Kind::Ack))
        return std::nullopt;
    if (take(at + kCauseAt, 1) != static_cast<std::uint8_t>(StopCause::Requested)) return std::nullopt;
    if (sequence == 0 || sequence >= 1ULL << 53U) return std::nullopt;  // a double on the signal lane
    datagram.kind = static_cast<StopDatagram::Kind>(kind);
    datagram.lease = *lease;
    datagram.generation = static_cast<std::uint32_t>(take(at + kGenerationAt, 4));
    datagram.sequence = static_cast<std::int64_t>(sequence);
    datagram.sent_at_us = static_cast<std::int64_t>(take(at + kSentAt, 8));
    datagram.sender = Id128::fromBytes(bytes.substr(kSenderAt, 16)).value();
    if (datagram.sender.isZero()) return std::nullopt;
    return datagram;
}

}  // namespace axon::datagrams
