// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/proof.hpp"

#include <gtest/gtest.h>

namespace axon::direct {
namespace {

constexpr std::string_view kKey = "0123456789abcdef";

Claim claim() {
    SeededRandom random(7);
    return {Lane::Signal, {3, 7}, Id128::uuid(random), Id128::random(random), Id128::random(random)};
}

TEST(Proof, IsRightForWhatItWasMadeForAndNothingElse) {
    const auto right = claim();
    const auto proof = proofOf(right, Prover::Client, kKey);
    EXPECT_EQ(proof.size(), 32U);
    EXPECT_TRUE(proves(proof, right, Prover::Client, kKey));

    EXPECT_FALSE(proves(proof, right, Prover::EntityManager, kKey)) << "its own proof, sent back";
    EXPECT_FALSE(proves(proof, right, Prover::Client, "0123456789abcdeF"));
    auto other = right;
    other.lane = Lane::Data;
    EXPECT_FALSE(proves(proof, other, Prover::Client, kKey));
    other = right;
    other.lease.number = 8;
    EXPECT_FALSE(proves(proof, other, Prover::Client, kKey));
    other = right;
    other.lease.epoch = 4;
    EXPECT_FALSE(proves(proof, other, Prover::Client, kKey));
    SeededRandom random(8);
    for (auto field : {&Claim::client, &Claim::path, &Claim::nonce}) {
        other = right;
        other.*field = Id128::random(random);
        EXPECT_FALSE(proves(proof, other, Prover::Client, kKey));
    }
}

TEST(Proof, OfTheWrongLengthOrWithoutAKeyIsNone) {
    const auto right = claim();
    const auto proof = proofOf(right, Prover::Client, kKey);
    EXPECT_FALSE(proves({}, right, Prover::Client, kKey));
    EXPECT_FALSE(proves(proof.substr(0, 31), right, Prover::Client, kKey));
    EXPECT_FALSE(proves(proof + "x", right, Prover::Client, kKey));
    EXPECT_FALSE(proves(proofOf(right, Prover::Client, {}), right, Prover::Client, {}));
}

/// The bytes are part of the contract: a client in another language makes them too
/// (docs/reference/direct.md).
TEST(Proof, HasTheBytesOfTheReference) {
    Claim known;
    known.lane = Lane::Data;
    known.lease = {3, 7};
    known.client = *Id128::parse("11111111-1111-4111-8111-111111111111");
    known.path = *Id128::parse("22222222-2222-4222-8222-222222222222");
    known.nonce = *Id128::parse("33333333-3333-4333-8333-333333333333");
    const auto hexOf = [&](Prover prover) {
        std::string hex;
        for (const unsigned char byte : proofOf(known, prover, kKey)) {
            constexpr const char* kDigits = "0123456789abcdef";
            hex += {kDigits[byte >> 4U], kDigits[byte & 15U]};
        }
        return hex;
    };
    EXPECT_EQ(hexOf(Prover::Client), "a4ff567b0d5d782815e30068ebbd49f018ac519502750feb17b71c1afea7d18d");
    EXPECT_EQ(hexOf(Prover::EntityManager),
              "bfd164931ce0130c02ac3b82bffa4dde74e22b99bc6f91996ed3e216582b504b");
}

}  // namespace
}  // namespace axon::direct
