// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/built_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>

namespace axon::console {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

class BuiltFolderTest : public testing::Test {
  protected:
    BuiltFolderTest() {
        std::string name = (fs::temp_directory_path() / "axon-console-XXXXXX").string();
        root = ::mkdtemp(name.data());
    }
    ~BuiltFolderTest() override { fs::remove_all(root); }
    void write(const fs::path& path, const std::string& content) const {
        fs::create_directories((root / path).parent_path());
        std::ofstream(root / path) << content;
    }
    fs::path root;
    ManualClock clock;
    std::vector<std::string> notes;
    BuiltFolder& folder() {
        if (!its) its.emplace(root, clock, [this](const std::string& line) { notes.push_back(line); });
        return *its;
    }
    std::optional<BuiltFolder> its;
};

TEST_F(BuiltFolderTest, HasItsFilesInEveryCoding) {
    write("index.html", "<html>");
    write("assets/a.js", "plain");
    write("assets/a.js.gz", "gz");
    write("assets/a.js.br", "br");
    write("assets/only.css.gz", "nothing without gzip");
    const auto files = folder().files();
    EXPECT_EQ(files->size(), 2U);
    const auto& script = files->at("/assets/a.js");
    EXPECT_EQ(*script.plain + *script.gzip + *script.br, "plaingzbr");
    EXPECT_EQ(script.type, "text/javascript; charset=utf-8");
    EXPECT_EQ(script.tag.size(), 32U);
    EXPECT_EQ(files->at("/index.html").gzip, nullptr);
}

TEST_F(BuiltFolderTest, FollowsNoLinksAndHidesWhatIsHidden) {
    write("index.html", "<html>");
    write(".env", "secret");
    write(".git/config", "secret");
    fs::create_symlink("/etc/passwd", root / "passwd.txt");
    fs::create_directory_symlink("/etc", root / "etc");
    EXPECT_EQ(folder().files()->size(), 1U);
}

TEST_F(BuiltFolderTest, IsReadAgainWhenItsFirstPageHasChanged) {
    EXPECT_TRUE(folder().files()->empty());
    write("index.html", "1");
    EXPECT_TRUE(folder().files()->empty()) << "looked at a moment ago";
    clock.advance(1s);
    const auto first = folder().files();
    EXPECT_EQ(*first->at("/index.html").plain, "1");
    write("index.html", "22");
    clock.advance(1s);
    EXPECT_EQ(*folder().files()->at("/index.html").plain, "22");
    EXPECT_EQ(*first->at("/index.html").plain, "1") << "who has the old ones keeps them";
    fs::remove(root / "index.html");
    clock.advance(1s);
    EXPECT_TRUE(folder().files()->empty());
}

TEST_F(BuiltFolderTest, ABuildThatWasReadHalfWayIsReadAgain) {
    write("index.html", "<html>");
    write("assets/a.js", "half");
    EXPECT_EQ(folder().files()->size(), 2U);
    write("assets/a.js", "half and the other half");
    write("assets/a.js.br", "br");
    write("assets/b.js", "another");
    clock.advance(1s);
    const auto files = folder().files();
    EXPECT_EQ(files->size(), 3U) << "its first page has not changed";
    EXPECT_EQ(*files->at("/assets/a.js").plain, "half and the other half");
    EXPECT_NE(files->at("/assets/a.js").br, nullptr);
    clock.advance(1s);
    EXPECT_EQ(folder().files(), files) << "what has not changed is not read again";
    fs::remove(root / "assets/b.js");
    clock.advance(1s);
    EXPECT_EQ(folder().files()->size(), 2U);
}

TEST_F(BuiltFolderTest, LeavesOutWhatIsTooLarge) {
    write("index.html", "<html>");
    write("large.bin", std::string(BuiltFolder::kFileMax + 1, 'x'));
    EXPECT_EQ(folder().files()->size(), 1U);
    ASSERT_EQ(notes.size(), 1U);
    EXPECT_THAT(notes[0], testing::HasSubstr("1 files"));
}

TEST_F(BuiltFolderTest, OfAProgramIsInstalledBesideItOrBuiltInTheSources) {
    EXPECT_EQ(consoleFolder(root / "usr/bin/axon-server"), root / "usr/share/axon/console");
    fs::create_directories(root / "web/console");
    EXPECT_EQ(consoleFolder(root / "build/dev/bin/axon-server"), root / "web/console/dist");
    write("build/dev/share/axon/console/index.html", "<html>");
    EXPECT_EQ(consoleFolder(root / "build/dev/bin/axon-server"), root / "build/dev/share/axon/console");
}

TEST(TypeOf, WhatIsNotKnownIsBytes) {
    EXPECT_EQ(typeOf("a.svg"), "image/svg+xml");
    EXPECT_EQ(typeOf("a.unknown"), "application/octet-stream");
    EXPECT_EQ(typeOf("a"), "application/octet-stream");
}

}  // namespace
}  // namespace axon::console
