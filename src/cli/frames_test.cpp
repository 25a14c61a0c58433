// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/frames.hpp"

#include <gmock/gmock.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <fstream>
#include <iterator>

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;
using testing::Not;

namespace {

namespace fs = std::filesystem;

std::string contentOf(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

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

TEST(Pictures, ACompressedOneIsTakenAsItIsIfItIsOne) {
    EXPECT_EQ(pictureOf(image("jpeg", 1, 1, "/9j/4A==")), "\xFF\xD8\xFF\xE0");
    EXPECT_EQ(pictureOf(image("png", 1, 1, "iVBORw0K")), "\x89PNG\r\n");
    EXPECT_FALSE(pictureOf(image("jpeg", 1, 1, "iVBORw0K"))) << "it is a png";
    EXPECT_FALSE(pictureOf(image("png", 1, 1, "PGh0bWw+"))) << "it is a page";
    EXPECT_FALSE(pictureOf(image("jpeg", 1, 1, "/9g="))) << "too short";
}

TEST(Pictures, PixelsBecomeABitmapFromBelow) {
    // Red above blue, one column.
    const auto picture = pictureOf(image("rgb8", 1, 2, "/wAAAAD/"));
    ASSERT_TRUE(picture);
    ASSERT_EQ(picture->size(), 54U + 8U);
    EXPECT_EQ(picture->substr(0, 2), "BM");
    EXPECT_EQ(picture->substr(54, 4), std::string("\xFF\0\0\0", 4)) << "blue is the first byte";
    EXPECT_EQ(picture->substr(58, 4), std::string("\0\0\xFF\0", 4));
    EXPECT_EQ(pictureOf(image("bgr8", 1, 2, "AAD//wAA")), picture);
    EXPECT_EQ(pictureOf(image("mono8", 1, 1, "fw=="))->substr(54, 3), "\x7F\x7F\x7F");
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

TEST(Pictures, AFileThatIsWrittenMeanwhileIsNobodyElses) {
    std::string name = (fs::temp_directory_path() / "axon-frames-XXXXXX").string();
    const fs::path folder = ::mkdtemp(name.data());
    const auto file = folder / "now.jpg";
    // Where the file was written before it took its place, in earlier versions.
    std::ofstream(folder / "victim") << "mine";
    fs::create_symlink(folder / "victim", file.string() + ".new-" + std::to_string(::getpid()));
    ASSERT_TRUE(replaceFile(file, "picture"));
    EXPECT_EQ(contentOf(folder / "victim"), "mine");
    EXPECT_EQ(contentOf(file), "picture");
    const auto mask = ::umask(027);
    ASSERT_TRUE(replaceFile(file, "next"));
    ::umask(mask);
    EXPECT_EQ(fs::status(file).permissions(), fs::perms(0640)) << "as any file of the user";
    EXPECT_EQ(std::distance(fs::directory_iterator(folder), {}), 3) << "nothing is left over";
    fs::remove_all(folder);
}

TEST(Pictures, OnlyARegularFileIsReplaced) {
    std::string name = (fs::temp_directory_path() / "axon-frames-XXXXXX").string();
    const fs::path folder = ::mkdtemp(name.data());
    std::ofstream(folder / "elsewhere") << "mine";
    fs::create_symlink(folder / "elsewhere", folder / "link");
    ASSERT_EQ(::mkfifo((folder / "pipe").c_str(), 0600), 0);
    fs::create_directory(folder / "folder");
    for (const auto* target : {"link", "pipe", "folder"}) {
        const auto type = fs::symlink_status(folder / target).type();
        const auto refused = replaceFile(folder / target, "picture");
        ASSERT_FALSE(refused) << target;
        EXPECT_THAT(refused.refusal().message, HasSubstr("no regular file"));
        EXPECT_EQ(fs::symlink_status(folder / target).type(), type);
    }
    EXPECT_EQ(contentOf(folder / "elsewhere"), "mine");
    EXPECT_EQ(std::distance(fs::directory_iterator(folder), {}), 4) << "nothing is left over";
    fs::remove_all(folder);
}

TEST(Pictures, EachStreamHasAFolderOfItsOwn) {
    const auto* id = "11111111-0000-4000-8000-000000000001";
    EXPECT_EQ(viewFolderName(id, "camera"), std::string("view-") + id + "-camera");
    EXPECT_NE(viewFolderName(id, "front camera"), viewFolderName(id, "front_camera"));
    EXPECT_NE(viewFolderName(id, "_20"), viewFolderName(id, " "));
    EXPECT_THAT(viewFolderName("../x", "../y"), Not(HasSubstr("/")));
}

TEST(Pictures, ThePageShowsNoNameAsMarkup) {
    const auto page = viewerPage("<b>robot</b> camera", "/tmp/a\"b #1?/50%.jpg");
    EXPECT_THAT(page, Not(HasSubstr("<b>")));
    EXPECT_THAT(page, HasSubstr("src=\"/tmp/a%22b%20%231%3F/50%25.jpg\""));
}
