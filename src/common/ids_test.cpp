// SPDX-License-Identifier: GPL-2.0-or-later
#include "common/ids.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

TEST(Id128, TextRoundTrips) {
    SeededRandom random(7);
    for (int i = 0; i < 100; ++i) {
        const auto id = Id128::uuid(random);
        EXPECT_EQ(Id128::parse(id.toString()), id);
        EXPECT_EQ(Id128::fromBytes(id.bytes()), id);
        EXPECT_EQ(id.toString()[14], '4') << "version 4";
    }
}

TEST(Id128, RefusesWhatIsNotAUuid) {
    EXPECT_FALSE(Id128::parse(""));
    EXPECT_FALSE(Id128::parse("0123456789abcdef0123456789abcdef"));
    EXPECT_FALSE(Id128::parse("01234567-89ab-cdef-0123-456789abcdeg"));
    EXPECT_FALSE(Id128::parse("01234567x89ab-cdef-0123-456789abcdef"));
    EXPECT_FALSE(Id128::fromBytes("fifteen bytes.."));
}

TEST(Id128, TheSameSeedGivesTheSameIds) {
    SeededRandom a(3);
    SeededRandom b(3);
    EXPECT_EQ(Id128::random(a), Id128::random(b));
    SystemRandom system;
    EXPECT_NE(Id128::random(system), Id128::random(system));
}

}  // namespace
}  // namespace axon
