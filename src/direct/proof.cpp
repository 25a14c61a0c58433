// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/proof.hpp"

#include <sodium.h>

#include <array>

#include "common/frame.hpp"

namespace axon::direct {
namespace {

constexpr std::string_view kMagic = "AxDi";
constexpr char kVersion = 1;
constexpr std::size_t kKeyBytes = 16;

}  // namespace

std::string proofOf(const Claim& claim, Prover prover, std::string_view key) {
    std::string text(kMagic);
    text += kVersion;
    text += static_cast<char>(prover);
    text += static_cast<char>(claim.lane);
    appendNumber(text, static_cast<std::uint32_t>(claim.lease.epoch));
    appendNumber(text, static_cast<std::uint32_t>(claim.lease.number));
    text += claim.client.bytes() + claim.path.bytes() + claim.nonce.bytes();

    const std::string under(key);  // an empty view's data may be null
    crypto_auth_hmacsha256_state state;
    crypto_auth_hmacsha256_init(&state, reinterpret_cast<const unsigned char*>(under.data()), under.size());
    crypto_auth_hmacsha256_update(&state, reinterpret_cast<const unsigned char*>(text.data()), text.size());
    std::array<unsigned char, crypto_auth_hmacsha256_BYTES> mac{};
    crypto_auth_hmacsha256_final(&state, mac.data());
    return {reinterpret_cast<const char*>(mac.data()), mac.size()};
}

bool proves(std::string_view proof, const Claim& claim, Prover prover, std::string_view key) {
    if (key.size() != kKeyBytes || proof.size() != crypto_auth_hmacsha256_BYTES) return false;
    const auto expected = proofOf(claim, prover, key);
    return sodium_memcmp(expected.data(), proof.data(), expected.size()) == 0;
}

}  // namespace axon::direct
