// SPDX-License-Identifier: MIT
#include "common/release.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon {
namespace {

using testing::EndsWith;
using testing::HasSubstr;

struct Release : testing::Test {
    std::optional<std::string> said(std::string_view release) { return notes.onPeer("a client", release); }
    ReleaseNotes notes{"this server", "contract 3"};
};

TEST_F(Release, OursAndNoneSayNothing) {
    EXPECT_TRUE(isRelease(kRelease));
    EXPECT_EQ(said(kRelease), std::nullopt);
    EXPECT_EQ(said(""), std::nullopt);
}

TEST_F(Release, AnotherIsSaidOnceForEachKindOfPeer) {
    EXPECT_EQ(said("7.1"), "connected with a client of release 7.1, this server has " +
                               std::string(kRelease) + "; they work together, because both have contract 3");
    EXPECT_EQ(said("7.1"), std::nullopt);
    EXPECT_TRUE(said("7.2"));
    EXPECT_TRUE(notes.onPeer("an Entity Manager", "7.1"));
    EXPECT_EQ(said("7.1"), std::nullopt);
}

TEST_F(Release, HostileTextIsCutAndEscapedAndSaidOnce) {
    const auto long_one = said(std::string(1'000'000, 'x'));
    ASSERT_TRUE(long_one);
    EXPECT_THAT(*long_one, HasSubstr("of an unknown release ('" + std::string(kReleaseMax, 'x') + "...')"));
    for (const std::string_view hostile : {std::string_view("1\n2026 error"), std::string_view("\x1b[2J"),
                                           std::string_view("\xff\xfe"), std::string_view("\0", 1)})
        EXPECT_EQ(said(hostile), std::nullopt) << "unknown releases are one release";

    const auto raw = std::string_view("1\n\x1b\xff\xc3\xa4\x7f\0", 8);
    ReleaseNotes others("this server", "contract 3");
    const auto shown = others.onPeer("a client", raw);
    ASSERT_TRUE(shown);
    EXPECT_THAT(*shown, HasSubstr(R"(('1\x0a\x1b\xff\xc3\xa4\x7f\x00'))"));
}

TEST_F(Release, AsManyAsCanBeRememberedAreSaidAndTheLastSaysSo) {
    for (std::size_t i = 1; i < ReleaseNotes::kRemembered; ++i)
        EXPECT_THAT(said(std::to_string(i)).value_or(""), EndsWith("contract 3"));
    EXPECT_THAT(said("a").value_or(""), EndsWith("; further releases are not logged"));
    EXPECT_EQ(said("b"), std::nullopt);
    EXPECT_EQ(said("1"), std::nullopt);
}

TEST(IsRelease, WantsOneToThirtyTwoPrintableCharacters) {
    for (const auto* good : {"0.1.0", "0.1.0~rc1+git20260101.1a2b3c4", "x"}) EXPECT_TRUE(isRelease(good));
    EXPECT_TRUE(isRelease(std::string(kReleaseMax, 'x')));
    EXPECT_FALSE(isRelease(std::string(kReleaseMax + 1, 'x')));
    for (const auto* bad : {"", "\t", "0.1.0\n", "0.1.\xc3\xa4"}) EXPECT_FALSE(isRelease(bad));
}

}  // namespace
}  // namespace axon
