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

TEST(IsUtf8, FindsOneBrokenByteWhereverItStands) {
    for (std::size_t size = 1; size < 40; ++size)
        for (std::size_t at = 0; at < size; ++at) {
            std::string text(size, 'a');
            EXPECT_TRUE(isUtf8(text));
            text[at] = '\xFF';
            EXPECT_FALSE(isUtf8(text)) << at << " of " << size;
            EXPECT_EQ(validUtf8(text), std::string(at, 'a') + kSign + std::string(size - at - 1, 'a'));
        }
}

TEST(IsUtf8, AgreesWithTheReplacementOnEveryTwoAndThreeBytes) {
    std::string text = "12345678???";
    const auto agrees = [&] {
        const bool valid = isUtf8(text);
        EXPECT_EQ(valid, validUtf8(text) == text) << testing::PrintToString(text);
        EXPECT_TRUE(isUtf8(validUtf8(text)));
    };
    for (unsigned lead = 0x7F; lead < 0x100; ++lead)
        for (unsigned second = 0; second < 0x100; ++second)
            for (const unsigned third : {0x00U, 0x7FU, 0x80U, 0xBFU, 0xC0U}) {
                text[8] = static_cast<char>(lead);
                text[9] = static_cast<char>(second);
                text[10] = static_cast<char>(third);
                agrees();
            }
}

TEST(IsUtf8, TakesNeitherOverlongFormsNorSurrogatesNorWhatIsBeyondUnicode) {
    for (const std::string text : {"\xC1\xBF", "\xE0\x9F\xBF", "\xF0\x8F\xBF\xBF", "\xED\xA0\x80",
                                   "\xF4\x90\x80\x80", "\xE2\x82", "\x80"})
        EXPECT_FALSE(isUtf8(text)) << testing::PrintToString(text);
    for (const std::string text :
         {"\xC2\x80", "\xE0\xA0\x80", "\xF0\x90\x80\x80", "\xED\x9F\xBF", "\xF4\x8F\xBF\xBF"}) {
        EXPECT_TRUE(isUtf8(text)) << testing::PrintToString(text);
        EXPECT_EQ(utf8Length(text + "more"), text.size());
    }
    EXPECT_EQ(utf8Length(""), 0U);
    EXPECT_EQ(utf8Length("\xE2\x82"), 0U);
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
