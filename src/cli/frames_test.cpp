// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/frames.hpp"

#include <gmock/gmock.h>

#include <fstream>

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;
using testing::Not;

namespace {

Json image(const char* encoding, int width, int height, const char* pixels) {
    return {{"image",
             {{"encoding", encoding},
              {"width", unsigned(width)},
              {"height", unsigned(height)},
              {"pixels", pixels}}}};
}

}  // namespace

TEST(Base64, IsReadWithAndWithoutPadding) {
    EXPECT_EQ(fromBase64("aGVsbG8="), "hello");
    EXPECT_EQ(fromBase64("aGVsbG8"), "hello");
    EXPECT_EQ(fromBase64("+/+/"), fromBase64("-_-_"));
    EXPECT_EQ(fromBase64(""), "");
    EXPECT_FALSE(fromBase64("a"));
    EXPECT_FALSE(fromBase64("aGVs bG8="));
    EXPECT_FALSE(fromBase64("====") && fromBase64("====")->size() > 0);
}

TEST(Pictures, ACompressedOneIsTakenAsItIs) {
    const auto picture = pictureOf(image("jpeg", 1, 1, "aGVsbG8="));
    ASSERT_TRUE(picture);
    EXPECT_EQ(picture->bytes, "hello");
    EXPECT_STREQ(picture->extension, ".jpg");
}

TEST(Pictures, PixelsBecomeABitmapFromBelow) {
    // Red above blue, one column.
    const auto picture = pictureOf(image("rgb8", 1, 2, "/wAAAAD/"));
    ASSERT_TRUE(picture);
    ASSERT_EQ(picture->bytes.size(), 54U + 8U);
    EXPECT_EQ(picture->bytes.substr(0, 2), "BM");
    EXPECT_EQ(picture->bytes.substr(54, 4), std::string("\xFF\0\0\0", 4)) << "blue is the first byte";
    EXPECT_EQ(picture->bytes.substr(58, 4), std::string("\0\0\xFF\0", 4));
    EXPECT_EQ(pictureOf(image("bgr8", 1, 2, "AAD//wAA"))->bytes, picture->bytes);
    EXPECT_EQ(pictureOf(image("mono8", 1, 1, "fw=="))->bytes.substr(54, 3), "\x7F\x7F\x7F");
}

TEST(Pictures, OneThatIsNotAsItSaysIsNone) {
    EXPECT_FALSE(pictureOf(image("rgb8", 2, 2, "/wAAAAD/"))) << "too few pixels";
    EXPECT_FALSE(pictureOf(image("rgb8", 0, 2, "")));
    EXPECT_FALSE(pictureOf(image("rgb8", 0x7FFFFFFF, 0x7FFFFFFF, "/wAA")));
    EXPECT_FALSE(pictureOf(image("bayer", 1, 1, "/wAA")));
    EXPECT_FALSE(pictureOf(image("jpeg", 1, 1, "no base64!")));
    EXPECT_FALSE(pictureOf({{"pose", {{"x", 1}}}}));
    EXPECT_FALSE(pictureOf({{"image", {{"encoding", 7}, {"pixels", Json::array()}}}}));
    EXPECT_FALSE(pictureOf("no json"));
}

TEST(Pictures, AFileIsReplacedAsAWhole) {
    const auto file = std::filesystem::path(testing::TempDir()) / "axon-replaced";
    ASSERT_TRUE(replaceFile(file, "first"));
    ASSERT_TRUE(replaceFile(file, "second"));
    std::string content;
    std::ifstream(file) >> content;
    EXPECT_EQ(content, "second");
    std::filesystem::remove(file);
    const auto refused = replaceFile(file / "below", "x");
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.refusal().message, HasSubstr("below"));
}

TEST(Pictures, ThePageShowsNoNameAsMarkup) {
    const auto page = viewerPage("<b>robot</b> camera", "/tmp/a\"b/picture");
    EXPECT_THAT(page, Not(HasSubstr("<b>")));
    EXPECT_THAT(page, HasSubstr("src=\"/tmp/a&#34;b/picture\""));
}
