// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users_file.hpp"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "common/descriptor.hpp"

namespace axon::users {
namespace {

using testing::HasSubstr;

TEST(UsersFile, AUserIsReplacedInItsPlaceAndOthersAndCommentsStay) {
    const std::string text = "# lab\nclient1 operator old # desk 3\nclient2 admin other";
    EXPECT_EQ(withUser(text, "client1", UserRole::Observer, "new"),
              "# lab\nclient1 observer new # desk 3\nclient2 admin other\n");
    EXPECT_EQ(withUser(text, "client3", UserRole::Entity, "new"), text + "\nclient3 entity new\n");
    EXPECT_EQ(withUser("", "client1", UserRole::Admin, "new"), "client1 admin new\n");
    EXPECT_EQ(withUser("client1 operator old # desk 3\r\r\r\n", "client1", UserRole::Admin, "new"),
              "client1 admin new # desk 3\n");
}

TEST(UsersFile, AUserIsRemovedAndOthersAndCommentsStay) {
    EXPECT_EQ(withoutUser("# client1\nclient1 operator old\n\n client2 admin x # client1\r\n", "client1"),
              "# client1\n\n client2 admin x # client1\r\n");
    EXPECT_EQ(withoutUser("client1 operator old\nclient2 admin x", "client2"), "client1 operator old\n");
    EXPECT_EQ(withoutUser("client1 operator old", "client"), "client1 operator old");
    EXPECT_EQ(withoutUser("", "client1"), "");
}

class UsersOnDisk : public testing::Test {
  protected:
    UsersOnDisk() {
        std::string name = std::filesystem::temp_directory_path() / "axon-users-XXXXXX";
        folder = ::mkdtemp(name.data());
        file = folder + "/users.cfg";
    }
    ~UsersOnDisk() override { std::filesystem::remove_all(folder); }
    std::string complaint() const {
        try {
            Users::read(file);
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return "accepted";
    }
    std::string content() const {
        std::stringstream text;
        text << std::ifstream(file).rdbuf();
        return text.str();
    }
    unsigned mode() const {
        struct stat facts {};
        ::stat(file.c_str(), &facts);
        return facts.st_mode & 07777U;
    }
    std::string folder;
    std::string file;
};

TEST_F(UsersOnDisk, AddsAndReplacesUsersInAFileOfItsOwner) {
    writeUser(file, "client1", UserRole::Operator, "one");
    EXPECT_EQ(mode(), 0600U);
    writeUser(file, "client2", UserRole::Observer, "two");
    writeUser(file, "client1", UserRole::Admin, "three");
    const auto users = Users::read(file);
    EXPECT_EQ(users.size(), 2U);
    EXPECT_EQ(users.verify("client1", "three"), UserRole::Admin);
    EXPECT_FALSE(users.verify("client1", "one"));
    EXPECT_THROW(writeUser(file, "a b", UserRole::Admin, "x"), std::runtime_error);
    EXPECT_THROW(writeUser(file, "client3", UserRole::Admin, ""), std::runtime_error);
    EXPECT_EQ(Users::read(file).size(), 2U);
}

// An administrator adds a user as root, and the server reads the file as another user through its group.
TEST_F(UsersOnDisk, KeepsOwnerGroupAndModeOfTheFile) {
    if (::geteuid() != 0) GTEST_SKIP() << "only root may give a file away";
    std::ofstream(file) << "# nobody yet\n";
    ::chmod(file.c_str(), 0640);
    ASSERT_EQ(::chown(file.c_str(), 4321, 1234), 0);
    writeUser(file, "client1", UserRole::Operator, "one");
    struct stat facts {};
    ASSERT_EQ(::stat(file.c_str(), &facts), 0);
    EXPECT_EQ(facts.st_uid, 4321U);
    EXPECT_EQ(facts.st_gid, 1234U);
    EXPECT_EQ(mode(), 0640U);
}

TEST_F(UsersOnDisk, ChangesOneThingOfAUserAndKeepsTheRest) {
    addUser(file, "client1", UserRole::Operator, "one");
    addUser(file, "boss", UserRole::Admin, "two");
    std::ofstream(file, std::ios::app) << "# the end\n";
    setRole(file, "client1", UserRole::Observer);
    EXPECT_EQ(Users::read(file).verify("client1", "one"), UserRole::Observer);
    setPassword(file, "client1", "three");
    EXPECT_EQ(Users::read(file).verify("client1", "three"), UserRole::Observer);
    removeUser(file, "client1");
    EXPECT_EQ(Users::read(file).all().size(), 1U);
    EXPECT_EQ(Users::read(file).verify("boss", "two"), UserRole::Admin);
    EXPECT_THAT(content(), testing::EndsWith("# the end\n"));
    EXPECT_FALSE(std::filesystem::exists(file + ".new"));
}

TEST_F(UsersOnDisk, RefusesWhatWouldNotBeMeantAndLeavesTheFileAsItIs) {
    addUser(file, "boss", UserRole::Admin, "two");
    const auto before = content();
    const auto refused = [](const auto& change) -> std::string {
        try {
            change();
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return "accepted";
    };
    EXPECT_THAT(refused([&] { addUser(file, "boss", UserRole::Operator, "x"); }), HasSubstr("already"));
    EXPECT_THAT(refused([&] { removeUser(file, "boss"); }), HasSubstr("only user"));
    EXPECT_THAT(refused([&] { removeUser(file, "nobody"); }), HasSubstr("no user 'nobody'"));
    EXPECT_THAT(refused([&] { setRole(file, "nobody", UserRole::Admin); }), HasSubstr("no user 'nobody'"));
    EXPECT_THAT(refused([&] { setPassword(file, "boss", ""); }), HasSubstr("expected a password"));
    EXPECT_THAT(refused([&] { setPassword(file, "a b", "x"); }), HasSubstr("expected a name"));
    EXPECT_THAT(refused([&] { setRole(file + "x", "boss", UserRole::Admin); }), HasSubstr("No such file"));
    EXPECT_EQ(content(), before);
    std::ofstream(file, std::ios::app) << "client1 king x\n";
    EXPECT_THAT(refused([&] { removeUser(file, "boss"); }), HasSubstr("users.cfg:3: expected the role"));
    EXPECT_EQ(content(), before + "client1 king x\n");
}

TEST_F(UsersOnDisk, OfTwoChangesAtOnceTheLaterIsRefused) {
    addUser(file, "boss", UserRole::Admin, "two");
    const auto lock = file + ".lock";
    const Descriptor other(::open(lock.c_str(), O_RDWR));
    ASSERT_EQ(::flock(other.get(), LOCK_EX), 0);
    EXPECT_THROW(addUser(file, "client1", UserRole::Operator, "one"), std::runtime_error);
    ::flock(other.get(), LOCK_UN);
    addUser(file, "client1", UserRole::Operator, "one");
    EXPECT_EQ(Users::read(file).size(), 2U);
}

// Everybody may open the folder, and keep it locked.
TEST_F(UsersOnDisk, WhoLocksTheFolderKeepsNobodyFromRemovingAUser) {
    addUser(file, "boss", UserRole::Admin, "two");
    addUser(file, "client1", UserRole::Operator, "one");
    const Descriptor other(::open(folder.c_str(), O_RDONLY | O_DIRECTORY));
    ASSERT_EQ(::flock(other.get(), LOCK_EX), 0);
    removeUser(file, "client1");
    EXPECT_EQ(Users::read(file).size(), 1U);
    struct stat facts {};
    ASSERT_EQ(::stat((file + ".lock").c_str(), &facts), 0);
    EXPECT_EQ(facts.st_mode & 07777U, 0600U);
}

TEST_F(UsersOnDisk, ALockThatIsALinkOrOpenToOthersIsNotTaken) {
    addUser(file, "boss", UserRole::Admin, "two");
    const auto lock = file + ".lock";
    ::chmod(lock.c_str(), 0666);
    setRole(file, "boss", UserRole::Operator);
    struct stat facts {};
    ::stat(lock.c_str(), &facts);
    EXPECT_EQ(facts.st_mode & 07777U, 0600U);
    std::filesystem::remove(lock);
    std::ofstream(folder + "/other") << "text";
    std::filesystem::create_symlink(folder + "/other", lock);
    EXPECT_THROW(setRole(file, "boss", UserRole::Admin), std::runtime_error);
    EXPECT_EQ(Users::read(file).roleOf("boss"), UserRole::Operator);
}

TEST_F(UsersOnDisk, ALinkToTheFileStaysALink) {
    addUser(file, "boss", UserRole::Admin, "two");
    const auto link = folder + "/link.cfg";
    std::filesystem::create_symlink(file, link);
    addUser(link, "client1", UserRole::Operator, "one");
    EXPECT_TRUE(std::filesystem::is_symlink(link));
    EXPECT_EQ(Users::read(file).size(), 2U);
}

TEST_F(UsersOnDisk, WhatOthersMightReadIsNarrowed) {
    addUser(file, "boss", UserRole::Admin, "two");
    ::chmod(file.c_str(), 0644);
    const auto before = ::umask(077);
    setRole(file, "boss", UserRole::Operator);
    ::umask(before);
    EXPECT_EQ(mode(), 0640U);
}

TEST_F(UsersOnDisk, RefusesAFileThatOthersMayReadOrWrite) {
    writeUser(file, "client1", UserRole::Operator, "one");
    for (const unsigned wide : {0644U, 0660U, 0604U, 0602U, 0740U}) {
        ::chmod(file.c_str(), wide);
        EXPECT_THAT(complaint(), HasSubstr("chmod 640 " + file)) << std::oct << wide;
    }
    for (const unsigned fine : {0640U, 0600U, 0400U}) {
        ::chmod(file.c_str(), fine);
        EXPECT_EQ(complaint(), "accepted") << std::oct << fine;
    }
}

TEST_F(UsersOnDisk, SaysWhatIsWrongWithTheFileItself) {
    EXPECT_THAT(complaint(),
                testing::AllOf(HasSubstr("No such file; fix: write the line"), HasSubstr("axon users add")));
    std::ofstream(file) << "# nobody yet\n";
    ::chmod(file.c_str(), 0600);
    EXPECT_THAT(complaint(), HasSubstr("expected at least one user"));
    std::ofstream(file) << std::string(2'000'000, '#');
    EXPECT_THAT(complaint(), HasSubstr("at most 1 MiB"));
    file = folder;
    EXPECT_THAT(complaint(), HasSubstr("expected a regular file"));
}

}  // namespace
}  // namespace axon::users
