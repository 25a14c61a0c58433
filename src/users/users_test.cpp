// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

namespace axon::users {
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

TEST(UsersFile, TheFingerprintIsThatOfWhatTheFileSaysAndNotOfHowItIsWritten) {
    const auto of = [](const std::string& text) { return Users::parse(text, "f").fingerprint(); };
    const auto one = of("client1 operator " + kHash + "\nboss admin " + kHash);
    EXPECT_EQ(one.size(), 8U);
    EXPECT_EQ(of("# lab\nboss\tadmin " + kHash + " # ann\n\nclient1 operator " + kHash + "\r\n"), one);
    EXPECT_NE(of("client1 observer " + kHash + "\nboss admin " + kHash), one);
    EXPECT_NE(of("client1 operator " + kHash), one);
    EXPECT_NE(of("client1 operator " + hashPassword("secret1") + "\nboss admin " + kHash), one);
}

TEST(UsersFile, WhoHasProvedToBeAUserStaysThatUserUntilThePasswordIsAnother) {
    const auto before = Users::parse("ann operator " + kHash + "\nbob operator " + kHash, "f");
    const auto after = Users::parse(
        "ann admin " + kHash + "\nbob operator " + hashPassword("x") + "\ncarl observer " + kHash, "f");
    EXPECT_TRUE(after.keeps("ann", before));
    EXPECT_FALSE(after.keeps("bob", before));
    EXPECT_FALSE(after.keeps("carl", before));
    EXPECT_FALSE(before.keeps("carl", after));
    EXPECT_FALSE(after.keeps("nobody", before));
}

// Cores ask for each client under the lock that heartbeats need.
TEST(UsersFile, AUserOfManyIsFoundWithoutLookingAtAll) {
    std::string text;
    for (int i = 0; i < 5000; ++i) text += "user" + std::to_string(i) + " operator " + kHash + "\n";
    const auto users = Users::parse(text, "f");
    EXPECT_EQ(users.size(), 5000U);
    for (const auto* name : {"user0", "user4999", "user77"}) EXPECT_EQ(users.find(name)->name, name);
    EXPECT_EQ(users.find("user5000"), nullptr);
    const auto copy = users;
    EXPECT_EQ(copy.find("user77"), &copy.all()[77]);
}

TEST(UsersFile, TakesAnyBytesWithoutHarm) {
    for (const auto& text : {std::string("\0\0\0", 3), std::string("\xff\xfe\n\x01 admin x"),
                             std::string(100'000, '\n'), std::string(100'000, ' '), std::string(100'000, 'a'),
                             std::string("#"), std::string("\r"), std::string("a b\tc")})
        EXPECT_THAT(complaint(text), testing::AnyOf(StartsWith("users.cfg:"), "accepted"));
    EXPECT_THAT(complaint("\x1b[2J admin x"), Not(HasSubstr("\x1b")));
}

}  // namespace
}  // namespace axon::users
