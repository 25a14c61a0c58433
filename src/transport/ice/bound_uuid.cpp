// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/bound_uuid.hpp"

#include <sodium.h>

#include <array>

#include "common/ids.hpp"

namespace axon::transport {
namespace {

constexpr std::size_t kVersionDigit = 14;  // of the text
constexpr std::string_view kWhatFor = "axon entity";

}  // namespace

std::string boundUuid(std::string_view secret) {
    const auto text = std::string(kWhatFor).append(secret);
    std::array<unsigned char, crypto_hash_sha256_BYTES> hash;
    crypto_hash_sha256(hash.data(), reinterpret_cast<const unsigned char*>(text.data()), text.size());
    hash[6] = static_cast<unsigned char>((hash[6] & 0x0FU) | 0x80U);
    hash[8] = static_cast<unsigned char>((hash[8] & 0x3FU) | 0x80U);
    return Id128::fromBytes({reinterpret_cast<const char*>(hash.data()), 16})->toString();
}

bool isBoundUuid(std::string_view uuid) {
    return Id128::parse(uuid) && uuid[kVersionDigit] == '8';
}

bool mayRegister(std::string_view uuid, std::string_view secret) {
    return !isBoundUuid(uuid) || (secret.size() == kSecretBytes && uuid == boundUuid(secret));
}

}  // namespace axon::transport
