// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/shares.hpp"

#include <gtest/gtest.h>

#include <string>

namespace axon::audit {
namespace {

using namespace std::chrono_literals;

constexpr ShareBounds kBounds{3, 10, 25};

Note of(std::string_view client) {
    return {.kind = Kind::Command, .client = client};
}

struct AuditShares : testing::Test {
    int admitted(const Note& note, int tries) {
        int many = 0;
        for (int i = 0; i < tries; ++i) many += shares.admit(note, now) ? 1 : 0;
        return many;
    }
    Shares shares{kBounds};
    TimePoint now{1000s};
};

TEST_F(AuditShares, OneSourceHasItsPartAndNoMoreUntilTheNextSecond) {
    EXPECT_EQ(admitted(of("a"), 100), 10);
    EXPECT_EQ(admitted(of("a"), 100), 0);
    now += 1s;
    EXPECT_EQ(admitted(of("a"), 100), 10);
}

TEST_F(AuditShares, ManyThatAskForMuchLeaveTheOthersWhatIsSure) {
    int noisy = 0;
    for (int i = 0; i < 50; ++i) noisy += admitted(of("noisy " + std::to_string(i)), 100);
    // What is sure of each of at most 50 parts, and what all share.
    EXPECT_LE(noisy, 50 * 3 + 25);
    int quiet = 0, tries = 0;
    for (; tries < 20; ++tries) quiet += admitted(of("quiet " + std::to_string(tries)), 3);
    EXPECT_GE(quiet, 3 * (tries - 8)) << "some may meet a noisy one in their part, but most do not";
}

TEST_F(AuditShares, AllSessionsOfAUserAreOneSource) {
    const auto ann = [](int session) {
        return userPart("ann") + "8123-9abc-12345678900" + std::to_string(session);
    };
    EXPECT_EQ(admitted(of(ann(1)), 6), 6);
    EXPECT_EQ(admitted(of(ann(2)), 100), 4);
}

TEST_F(AuditShares, WithoutAClientTheSourceIsTheAddressWhateverThePortAndTheUser) {
    const auto from = [](std::string_view peer, std::string_view user) {
        return Note{.kind = Kind::Refusal, .user = user, .peer = peer};
    };
    EXPECT_EQ(admitted(from("10.0.0.1:4000", "ann"), 6), 6);
    EXPECT_EQ(admitted(from("10.0.0.1:4001", "bob"), 100), 4);
}

TEST_F(AuditShares, WhatHasNeitherHasAPartToo) {
    EXPECT_EQ(admitted({}, 100), 10);
}

TEST_F(AuditShares, LessThanWhatIsSureIsNotMore) {
    Shares few({3, 1, 0});
    int many = 0;
    for (int i = 0; i < 100; ++i) many += few.admit(of("a"), now) ? 1 : 0;
    EXPECT_EQ(many, 3);
}

}  // namespace
}  // namespace axon::audit
