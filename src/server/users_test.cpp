// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/users.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>

namespace axon::server {
namespace {

using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

// openssl passwd -6 -salt saltsalt secret1
const std::string kHash =
    "$6$saltsalt$jCP90RmSIIja2o9FRs25ASQaR1lMN6uKHmNcHaoNCpAXgV3n5NfAlQdZQcvMVQO1BTCOFF0LzoHFZBt9E45NW0";

std::string complaint(const std::string& text) {
    try {
        Users::parse(text, "users.cfg");
    } catch (const std::runtime_error& error) {
        return error.what();
    }
    return "accepted";
}

TEST(UsersFile, ReadsLinesCommentsAndWindowsLineEnds) {
    const auto users =
        Users::parse("# who may come in\n\nclient1 operator " + kHash + "  # from the lab\r\n" +
                         "\tleft   entity\t" + kHash + "\nboss admin " + kHash,
                     "users.cfg");
    EXPECT_EQ(users.size(), 3U);
    EXPECT_EQ(users.verify("client1", "secret1"), UserRole::Operator);
    EXPECT_EQ(users.verify("left", "secret1"), UserRole::Entity);
    EXPECT_EQ(users.verify("boss", "secret1"), UserRole::Admin);
}

TEST(UsersFile, RefusesWrongPasswordsUnknownUsersAndWhatCryptCannotTake) {
    const auto users = Users::parse("client1 operator " + kHash + "\n", "users.cfg");
    EXPECT_FALSE(users.verify("client1", "secret2"));
    EXPECT_FALSE(users.verify("client1", ""));
    EXPECT_FALSE(users.verify("client1", std::string("secret1\0", 8)));
    EXPECT_FALSE(users.verify("client1", std::string(100'000, 'x')));
    EXPECT_FALSE(users.verify("client2", "secret1"));
    EXPECT_FALSE(users.verify("", ""));
    EXPECT_FALSE(users.verify("Client1", "secret1"));
    EXPECT_FALSE(Users::parse("", "users.cfg").verify("client1", "secret1"));
}

TEST(UsersFile, SaysWhichLineIsWrongAndHowToFixIt) {
    const auto second = [](const std::string& line) {
        return complaint("client1 operator " + kHash + "\n" + line);
    };
    EXPECT_THAT(second("client2 operator"),
                StartsWith("users.cfg:2: expected 'name role hash', not 2 words; fix: "));
    EXPECT_THAT(second("client2 operator " + kHash + " x"), HasSubstr("not 4 words"));
    EXPECT_THAT(second("client2 king " + kHash),
                HasSubstr("expected the role observer, operator, admin or entity, not 'king'"));
    EXPECT_THAT(second("client2 Admin " + kHash), HasSubstr("expected the role"));
    EXPECT_THAT(second("client1 admin " + kHash), HasSubstr("'client1' has one already"));
    EXPECT_THAT(second("a:b admin " + kHash), HasSubstr("expected a name"));
    EXPECT_THAT(second(std::string(65, 'x') + " admin " + kHash), HasSubstr("expected a name"));
    EXPECT_THAT(second("client2 king"), HasSubstr("axon-server --users FILE --add-user"));
}

TEST(UsersFile, AcceptsNoWeakOrBrokenHashAndDoesNotRepeatIt) {
    for (const std::string hash : {"secret1", "*", "!", "x", "ab01FAX.bQRSU",  // DES
                                   "$1$saltsalt$qjXMvbEw8oaL.CzflDtaK/",       // MD5
                                   "$6$saltsalt$", "$6$saltsalt", "$6$", "$$$",
                                   "$99$salt$0123456789012345678901234567890123456789012345"}) {
        const auto said = complaint("client1 operator " + hash);
        EXPECT_THAT(said, StartsWith("users.cfg:1: expected a hash")) << hash;
        if (hash.size() > 4) EXPECT_THAT(said, Not(HasSubstr(hash)));
    }
    EXPECT_THAT(complaint("client1 operator $6$" + std::string(5000, 'x')), HasSubstr("expected a hash"));
}

TEST(UsersFile, TakesAnyBytesWithoutHarm) {
    for (const auto& text : {std::string("\0\0\0", 3), std::string("\xff\xfe\n\x01 admin x"),
                             std::string(100'000, '\n'), std::string(100'000, ' '), std::string(100'000, 'a'),
                             std::string("#"), std::string("\r"), std::string("a b\tc")})
        EXPECT_THAT(complaint(text), testing::AnyOf(StartsWith("users.cfg:"), "accepted"));
    EXPECT_THAT(complaint("\x1b[2J admin x"), Not(HasSubstr("\x1b")));
}

TEST(UsersFile, AHashThatWeMakeIsOneThatWeAccept) {
    const auto hash = hashPassword("secret1");
    EXPECT_NE(hash, hashPassword("secret1"));  // a salt of its own
    EXPECT_EQ(Users::parse("client1 admin " + hash, "f").verify("client1", "secret1"), UserRole::Admin);
    EXPECT_THROW(hashPassword(""), std::runtime_error);
    EXPECT_THROW(hashPassword(std::string(512, 'x')), std::runtime_error);
    EXPECT_THROW(hashPassword(std::string("a\0b", 3)), std::runtime_error);
}

TEST(UsersFile, AUserIsReplacedInItsPlaceAndOthersStay) {
    const std::string text = "# lab\nclient1 operator old # desk 3\nclient2 admin other";
    EXPECT_EQ(withUser(text, "client1", UserRole::Observer, "new"),
              "# lab\nclient1 observer new\nclient2 admin other\n");
    EXPECT_EQ(withUser(text, "client3", UserRole::Entity, "new"), text + "\nclient3 entity new\n");
    EXPECT_EQ(withUser("", "client1", UserRole::Admin, "new"), "client1 admin new\n");
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
    EXPECT_THAT(complaint(), HasSubstr("No such file"));
    std::ofstream(file) << "# nobody yet\n";
    ::chmod(file.c_str(), 0600);
    EXPECT_THAT(complaint(), HasSubstr("expected at least one user"));
    std::ofstream(file) << std::string(2'000'000, '#');
    EXPECT_THAT(complaint(), HasSubstr("at most 1 MiB"));
    file = folder;
    EXPECT_THAT(complaint(), HasSubstr("expected a regular file"));
}

}  // namespace
}  // namespace axon::server
