// SPDX-License-Identifier: MIT
#include "common/utf8.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

const std::string kSign = "\xEF\xBF\xBD";

TEST(ValidUtf8, KeepsWhatIsValid) {
    for (const std::string text :
         {"", "plain", "gr\xC3\xBC\xC3\x9F", "\xE2\x82\xAC", "\xF0\x9F\xA4\x96", "\xF4\x8F\xBF\xBF"})
        EXPECT_EQ(validUtf8(text), text);
    EXPECT_EQ(validUtf8(std::string_view("a\0b", 3)), std::string("a\0b", 3));
}

TEST(ValidUtf8, ReplacesEachBrokenSequenceByOneSign) {
    EXPECT_EQ(validUtf8("gr\xFC\xDF e"), "gr" + kSign + kSign + " e");
    EXPECT_EQ(validUtf8("\xE2\x82"), kSign);                       // truncated
    EXPECT_EQ(validUtf8("\xE2\x82x"), kSign + "x");                // what follows is kept
    EXPECT_EQ(validUtf8("\xC0\xAF"), kSign + kSign);               // overlong
    EXPECT_EQ(validUtf8("\xED\xA0\x80"), kSign + kSign + kSign);   // a surrogate
    EXPECT_EQ(validUtf8("\xF4\x90\x80\x80").substr(0, 3), kSign);  // beyond U+10FFFF
    EXPECT_EQ(validUtf8("\x80"), kSign);
}

TEST(CutUtf8, EndsBetweenCharacters) {
    EXPECT_EQ(cutUtf8("abc", 3), "abc");
    EXPECT_EQ(cutUtf8("abc", 2), "ab");
    EXPECT_EQ(cutUtf8("a\xE2\x82\xAC", 3), "a");
    EXPECT_EQ(cutUtf8("a\xE2\x82\xAC"
                      "b",
                      4),
              "a\xE2\x82\xAC");
    EXPECT_EQ(cutUtf8("\xF0\x9F\xA4\x96", 3), "");
}

}  // namespace
}  // namespace axon
