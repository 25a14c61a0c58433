// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/ports/resource_places.hpp"

#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <sstream>

namespace axon::entity_manager {
namespace {

namespace fs = std::filesystem;

struct ResourcePlaces : testing::Test {
    ResourcePlaces() {
        char name[] = "/tmp/axon-places-XXXXXX";
        top = fs::canonical(::mkdtemp(name));
        for (const auto* folder : {"profiles", "profiles/maps", "maps", "outside"})
            fs::create_directories(top / folder);
        roots = {(top / "profiles").string(), {(top / "maps").string()}};
    }
    ~ResourcePlaces() override { fs::remove_all(top); }
    std::string write(const std::string& file, const std::string& text) const {
        std::ofstream(top / file) << text;
        return (top / file).string();
    }
    static std::string read(const std::string& file) {
        std::stringstream text;
        text << std::ifstream(file).rdbuf();
        return text.str();
    }
    ResourcePlace find(const std::string& url) const { return findResourcePlace(roots, url); }
    std::string at(const std::string& file) const { return (top / file).string(); }
    fs::path top;
    ResourceRoots roots;
};

TEST_F(ResourcePlaces, ARelativeUrlBeginsInTheFolderOfTheProfiles) {
    EXPECT_EQ(find("maps/lab.map").path, at("profiles/maps/lab.map"));
    EXPECT_FALSE(find("maps/lab.map").there);
    EXPECT_TRUE(find("maps/lab.map").refusal.ok());
    write("profiles/maps/lab.map", "walls");
    EXPECT_TRUE(find("maps/lab.map").there);
    EXPECT_EQ(find("maps/lab.map").size, 5U);
    EXPECT_EQ(find("not/yet/made.map").path, at("profiles/not/yet/made.map"));
}

TEST_F(ResourcePlaces, AnAbsoluteUrlLiesBelowAFolderThatIsPermitted) {
    write("maps/lab.map", "walls");
    EXPECT_TRUE(find(at("maps/lab.map")).there);
    for (const auto& url : {at("outside/x"), at("mapsx/x"), at("maps"), std::string("/etc/passwd"),
                            at("profiles/maps/lab.map")}) {
        const auto place = find(url);
        EXPECT_EQ(place.refusal.code, RefusalCode::BadName) << url;
        EXPECT_EQ(place.path, "") << url;
    }
    EXPECT_NE(find("/etc/passwd").refusal.message.find(at("maps")), std::string::npos) << "what is permitted";
    roots.permitted.clear();
    EXPECT_NE(find("/etc/passwd").refusal.message.find("it permits none"), std::string::npos);
}

TEST_F(ResourcePlaces, NothingLeavesItsFolder) {
    fs::create_directory_symlink(top / "outside", top / "profiles/away");
    fs::create_symlink("/etc/passwd", top / "profiles/users");
    fs::create_symlink("/etc/passwd", top / "maps/users");
    fs::create_symlink("loop", top / "profiles/loop");
    fs::create_directory_symlink(top / "profiles/maps", top / "profiles/inside");
    for (const auto& url :
         {std::string("away/x"), std::string("users"), at("maps/users"), std::string("../outside/x"),
          at("maps/../outside/x"), std::string("loop"), std::string("loop/x"), std::string("")})
        EXPECT_FALSE(find(url).refusal.ok()) << url;
    EXPECT_NE(find("users").refusal.message.find("symbolic link"), std::string::npos);
    write("profiles/maps/lab.map", "walls");
    EXPECT_EQ(find("inside/lab.map").path, at("profiles/maps/lab.map")) << "a link that stays is followed";
    fs::create_directory_symlink(top / "profiles", top / "by another name");
    roots.profiles = at("by another name");
    EXPECT_EQ(find("maps/lab.map").path, at("profiles/maps/lab.map"))
        << "the folder itself may be reached by a link";
}

TEST_F(ResourcePlaces, AFolderIsNoFileAndWithoutAFolderARelativeUrlLeadsNowhere) {
    EXPECT_EQ(find("maps").refusal.code, RefusalCode::BadName);
    roots.profiles.clear();
    EXPECT_EQ(find("lab.map").refusal.code, RefusalCode::BadName);
}

TEST_F(ResourcePlaces, AFileIsReplacedAsAWholeAndKeepsItsMode) {
    const auto old = write("profiles/maps/lab.map", "old");
    ::chmod(old.c_str(), 0640);
    const auto from = write("arrived", "new");
    ::chmod(from.c_str(), 0600);
    ASSERT_TRUE(replaceResource(from, find("maps/lab.map")).ok());
    EXPECT_EQ(read(old), "new");
    EXPECT_EQ(fs::status(old).permissions(), fs::perms{0640});
    EXPECT_FALSE(fs::exists(from));
    ASSERT_TRUE(replaceResource(write("arrived", "first"), find("made/on/demand")).ok());
    EXPECT_EQ(read(at("profiles/made/on/demand")), "first");
    EXPECT_EQ(fs::status(at("profiles/made/on/demand")).permissions(), fs::perms{0644})
        << "the application may be another user";
}

TEST_F(ResourcePlaces, AFileOfAnotherDiskIsCopied) {
    char name[] = "/dev/shm/axon-places-XXXXXX";
    const char* other = ::mkdtemp(name);
    if (other == nullptr) GTEST_SKIP() << "no /dev/shm here";
    const std::string from = std::string(other) + "/arrived";
    std::ofstream(from) << std::string(3'000'000, 'x');
    const auto old = write("profiles/lab.map", "old");
    ASSERT_TRUE(replaceResource(from, find("lab.map")).ok());
    EXPECT_EQ(read(old), std::string(3'000'000, 'x'));
    EXPECT_FALSE(fs::exists(from));
    EXPECT_EQ(std::distance(fs::directory_iterator(top / "profiles"), fs::directory_iterator()), 2)
        << "nothing is left beside it";
    fs::remove_all(other);
}

TEST_F(ResourcePlaces, WhatMayNotBeReplacedSaysSoAndStays) {
    const auto old = write("profiles/lab.map", "old");
    ::chmod(old.c_str(), 0444);
    const auto from = write("arrived", "new");
    const auto replaced = replaceResource(from, find("lab.map"));
    ASSERT_FALSE(replaced.ok());
    EXPECT_EQ(replaced.refusal().code, RefusalCode::PermissionDenied);
    EXPECT_NE(replaced.refusal().message.find("read-only"), std::string::npos);
    EXPECT_EQ(read(old), "old");
    EXPECT_EQ(read(from), "new");
    EXPECT_FALSE(replaceResource(from, find("../x")).ok()) << "what has no place";
    write("profiles/file", "x");
    EXPECT_FALSE(replaceResource(from, find("file/below")).ok()) << "a file is no folder";
    EXPECT_EQ(read(from), "new");
    // For root every folder can be written; the system's own need not be tried.
    if (::geteuid() == 0) return;
    fs::permissions(top / "profiles", fs::perms::owner_read | fs::perms::owner_exec);
    EXPECT_EQ(mayReplaceResource(find("new.map")).code, RefusalCode::PermissionDenied);
    fs::permissions(top / "profiles", fs::perms::owner_all);
}

}  // namespace
}  // namespace axon::entity_manager
