// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/opening.hpp"

#include <gtest/gtest.h>

#include "common/frame.hpp"
#include "direct/lane/frames.hpp"

namespace axon::direct::lane {
namespace {

const std::string kKey = "0123456789abcdef";

std::string content(const std::string& bytes) {
    FrameReader reader(kOpeningMax);
    reader.feed(bytes);
    std::string frame;
    EXPECT_TRUE(reader.next(frame));
    EXPECT_FALSE(reader.nextView()) << "one frame";
    return frame;
}

class LaneOpening : public ::testing::Test {
  protected:
    /// With the client's key.
    ClientOpening client(const std::string& key = kKey) {
        return {
            claim,
            [this, key](const Id128& its) {
                claim.nonce = its;
                return proofOf(claim, Prover::Client, key);
            },
            [this, key](std::string_view proof) { return proves(proof, claim, Prover::EntityManager, key); }};
    }
    std::string claimTo(const ManagerOpening& whom, const std::string& key = kKey) {
        auto its = client(key);
        return content(std::get<0>(its.onFrame(content(whom.greeting()))));
    }

    SeededRandom random{1};
    Id128 nonce = Id128::random(random);
    Claim claim{Lane::Data, {3, 7}, Id128::random(random), Id128::random(random), {}};
    ManagerOpening manager{nonce};
};

TEST_F(LaneOpening, BothSidesProveThatTheyKnowTheKey) {
    auto its = client();
    const auto claimed = its.onFrame(content(manager.greeting()));
    ASSERT_EQ(claimed.index(), 0U);
    EXPECT_EQ(its.state(), ClientOpening::State::ProofAwaited);
    const auto judged = manager.onFrame(content(std::get<0>(claimed)));
    ASSERT_EQ(judged.index(), 0U);
    const auto& [said, proof] = std::get<0>(judged);
    EXPECT_EQ(said.lane, Lane::Data);
    EXPECT_EQ(said.lease, claim.lease);
    EXPECT_EQ(said.client, claim.client);
    EXPECT_EQ(said.path, claim.path);
    EXPECT_EQ(said.nonce, nonce);
    EXPECT_TRUE(proves(proof, said, Prover::Client, kKey));
    const auto answer = manager.admit(proofOf(said, Prover::EntityManager, kKey));
    EXPECT_EQ(manager.state(), ManagerOpening::State::Open);
    const auto opened = its.onFrame(content(answer));
    ASSERT_EQ(opened.index(), 0U);
    EXPECT_TRUE(std::get<0>(opened).empty());
    EXPECT_EQ(its.state(), ClientOpening::State::Open);
}

TEST_F(LaneOpening, AProofForAnotherNonceIsNone) {
    ManagerOpening other{Id128::random(random)};
    const auto replayed = manager.onFrame(claimTo(other));
    ASSERT_EQ(replayed.index(), 0U);
    const auto& [said, proof] = std::get<0>(replayed);
    EXPECT_EQ(said.nonce, nonce) << "that of the connection, whatever the claim was made for";
    EXPECT_FALSE(proves(proof, said, Prover::Client, kKey));
}

TEST_F(LaneOpening, WhoDoesNotKnowTheKeyIsNotTrusted) {
    auto its = client();
    ASSERT_EQ(its.onFrame(content(manager.greeting())).index(), 0U);
    const auto echoed = proofOf(claim, Prover::Client, kKey);
    const auto answer = its.onFrame(content(frameOf(Kind::Proof, echoed)));
    ASSERT_EQ(answer.index(), 1U) << "its own proof sent back is none";
    EXPECT_EQ(std::get<1>(answer).code, RefusalCode::PermissionDenied);
    EXPECT_EQ(its.state(), ClientOpening::State::Over);
    EXPECT_EQ(its.onFrame(content(frameOf(Kind::Proof, proofOf(claim, Prover::EntityManager, kKey)))).index(),
              1U)
        << "it stays over";
}

TEST_F(LaneOpening, OnlyOneClaimIsHeard) {
    const auto said = claimTo(manager);
    ASSERT_EQ(manager.onFrame(said).index(), 0U);
    const auto again = manager.onFrame(said);
    ASSERT_EQ(again.index(), 1U);
    EXPECT_EQ(std::get<1>(again).code, RefusalCode::WrongState);
}

TEST_F(LaneOpening, EveryClaimThatIsNotWholeIsMalformed) {
    const auto said = claimTo(manager);
    for (std::size_t size = 0; size <= said.size() + 1; ++size) {
        if (size == said.size()) continue;
        ManagerOpening hears{nonce};
        auto wrong = said + "x";
        const auto answer = hears.onFrame(std::string_view(wrong).substr(0, size));
        ASSERT_EQ(answer.index(), 1U) << size;
        EXPECT_EQ(std::get<1>(answer).code, RefusalCode::Malformed) << size;
    }
    auto no_path = said;
    no_path.replace(1 + 4 + 8 + 16, 16, 16, '\0');
    EXPECT_EQ(std::get<1>(manager.onFrame(no_path)).code, RefusalCode::Malformed);
    for (const char kind : {'\0', '\1', '\3', '\4', '\5', '\6', '\7'}) {
        ManagerOpening hears{nonce};
        auto other = said;
        other[0] = kind;
        EXPECT_EQ(std::get<1>(hears.onFrame(other)).code, RefusalCode::Malformed) << int{kind};
    }
}

TEST_F(LaneOpening, EditionsBeforeAndAfterAreToldBothNumbers) {
    for (const auto contract : {kContract - 1, kContract + 1}) {
        auto said = claimTo(manager);
        said[4] = static_cast<char>(contract);
        said.resize(said.size() - 5);  // of an edition that says something else
        ManagerOpening hears{nonce};
        const auto refusal = std::get<1>(hears.onFrame(said));
        EXPECT_EQ(refusal.code, RefusalCode::NotSupported);
        for (const auto number : {kContract, contract})
            EXPECT_NE(refusal.message.find("contract " + std::to_string(number)), std::string::npos);

        auto greeting = content(manager.greeting());
        greeting[4] = static_cast<char>(contract);
        auto its = client();
        EXPECT_EQ(std::get<1>(its.onFrame(greeting)).code, RefusalCode::NotSupported);
    }
}

TEST_F(LaneOpening, ARefusalIsToldToTheClient) {
    auto its = client();
    ASSERT_EQ(manager.onFrame(content(std::get<0>(its.onFrame(content(manager.greeting()))))).index(), 0U);
    const auto refused =
        its.onFrame(content(manager.refuse({RefusalCode::Overloaded, std::string(5000, 'w'), {}})));
    EXPECT_EQ(manager.state(), ManagerOpening::State::Over);
    ASSERT_EQ(refused.index(), 1U);
    EXPECT_EQ(std::get<1>(refused).code, RefusalCode::Overloaded);
    EXPECT_LT(std::get<1>(refused).message.size(), 1100U);
    EXPECT_EQ(its.state(), ClientOpening::State::Over);
}

TEST_F(LaneOpening, WhateverElseAnEntityManagerSaysEndsTheOpening) {
    const auto greeting = content(manager.greeting());
    const std::vector<std::string> wrong{"",
                                         "IceP",
                                         "\x05" + std::string(40, 'x'),
                                         greeting + "x",
                                         greeting.substr(0, 20),
                                         content(frameOf(Kind::Proof, std::string(32, 'p')))};
    for (const auto& frame : wrong) {
        auto its = client();
        EXPECT_EQ(its.onFrame(frame).index(), 1U) << frame.size();
        EXPECT_EQ(its.state(), ClientOpening::State::Over);
    }
    auto its = client();
    ASSERT_EQ(its.onFrame(greeting).index(), 0U);
    EXPECT_EQ(its.onFrame(greeting).index(), 1U) << "one nonce";
}

}  // namespace
}  // namespace axon::direct::lane
