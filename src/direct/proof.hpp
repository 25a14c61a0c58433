// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <string_view>

#include "common/ids.hpp"
#include "common/routed.hpp"

namespace axon::direct {

/// What both ends of one connection of a direct path agree on, and prove to know the lease's key for: no
/// server vouches for either there.
struct Claim {
    Lane lane = Lane::Data;
    LeaseNumber lease;
    Id128 client;  ///< session UUID of the holder
    Id128 path;    ///< the client's choice, at random, the same for both lanes
    Id128 nonce;   ///< the Entity Manager's, at random, used once
};

/// Who proves; so that nobody's proof can be sent back as an answer.
enum class Prover : std::uint8_t { Client = 1, EntityManager = 2 };

/// HMAC-SHA256 under the lease's key of 16 bytes, over the prover and all fields: 32 bytes. Pure; any thread.
std::string proofOf(const Claim& claim, Prover prover, std::string_view key);
/// Whether the proof is right. Takes the same time wherever it is wrong. False for a key that is not 16
/// bytes.
bool proves(std::string_view proof, const Claim& claim, Prover prover, std::string_view key);

}  // namespace axon::direct
