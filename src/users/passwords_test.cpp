// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/passwords.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>

namespace axon::users {
namespace {

using testing::StartsWith;

// libargon2, which is another implementation: echo -n secret1 | argon2 saltsaltsaltsalt -id -t 1 -k 8192 -p 4
const std::string kFourLanes =
    "$argon2id$v=19$m=8192,t=1,p=4$c2FsdHNhbHRzYWx0c2FsdA$secOTBA+gz85TAEUf7XSokQzY4hyKPPmdEpIPKhmCac";
// mkpasswd -m yescrypt secret1
const std::string kYescrypt = "$y$j9T$saltsaltsaltsaltsalt1.$.ygqZkrUThVkCVyogqrF8nEGYe0ml/MtmvKx23KTn1A";
// openssl passwd -6 -salt saltsalt secret1
const std::string kSha512 =
    "$6$saltsalt$jCP90RmSIIja2o9FRs25ASQaR1lMN6uKHmNcHaoNCpAXgV3n5NfAlQdZQcvMVQO1BTCOFF0LzoHFZBt9E45NW0";

TEST(Passwords, AHashThatWeMakeIsArgon2idOfOurCostAndOneThatWeAccept) {
    const auto hash = hashPassword("secret1");
    EXPECT_THAT(hash, StartsWith("$argon2id$v=19$m=19456,t=2,p=1$"));
    EXPECT_NE(hash, hashPassword("secret1"));  // a salt of its own
    EXPECT_TRUE(isHash(hash));
    EXPECT_TRUE(matches(hash, "secret1"));
    EXPECT_FALSE(matches(hash, "secret2"));
    EXPECT_FALSE(matches(hash, ""));
    EXPECT_THROW(hashPassword(""), std::runtime_error);
    EXPECT_THROW(hashPassword(std::string(512, 'x')), std::runtime_error);
    EXPECT_THROW(hashPassword(std::string("a\0b", 3)), std::runtime_error);
}

TEST(Passwords, HashesOfOtherProgramsAreVerified) {
    for (const auto& hash : {kFourLanes, kYescrypt, kSha512}) {
        EXPECT_TRUE(isHash(hash)) << hash;
        EXPECT_TRUE(matches(hash, "secret1")) << hash;
        EXPECT_FALSE(matches(hash, "secret2")) << hash;
    }
    EXPECT_STREQ(kindOf(kFourLanes), "argon2id");
    EXPECT_STREQ(kindOf(kYescrypt), "yescrypt");
    EXPECT_STREQ(kindOf(kSha512), "sha512");
}

TEST(Passwords, WhatNoPasswordCanBeMatchesNothing) {
    for (const auto& hash : {hashPassword("secret1"), kSha512}) {
        EXPECT_FALSE(matches(hash, std::string("secret1\0", 8)));
        EXPECT_FALSE(matches(hash, std::string(100'000, 'x')));
    }
}

// Whoever writes users.cfg could otherwise have one log-in take the memory and the time of the server.
TEST(Passwords, AHashThatAsksForTooMuchOrTooLittleIsNone) {
    const std::string tail = "$UtOU5N71jSD9CHU9IzIrrg$WhjeN9remt0azQgOxTUnqxXwsieEI1BJEpijWgf6IbI";
    const auto with = [&](const std::string& costs) { return isHash("$argon2id$v=19$" + costs + tail); };
    EXPECT_TRUE(with("m=19456,t=2,p=1"));
    EXPECT_TRUE(with("m=262144,t=16,p=16"));
    for (const auto* costs :
         {"m=262145,t=2,p=1", "m=19456,t=17,p=1", "m=19456,t=2,p=17", "m=7167,t=2,p=1", "m=19456,t=0,p=1",
          "m=19456,t=2,p=0", "m=4294967296,t=2,p=1", "m=-1,t=2,p=1", "m=19456,t=2", "t=2,m=19456,p=1",
          "m=19456,t=2,p=1,x=1", "m= 19456,t=2,p=1", ""})
        EXPECT_FALSE(with(costs)) << costs;
}

TEST(Passwords, AHashOfCryptThatAsksForTooMuchIsNone) {
    const auto sha = [](const std::string& rounds) { return isHash("$6$" + rounds + kSha512.substr(3)); };
    EXPECT_TRUE(sha("rounds=5000$"));
    EXPECT_TRUE(sha("rounds=1000000$"));
    for (const auto* rounds : {"rounds=1000001$", "rounds=999999999$", "rounds=99999999999$"})
        EXPECT_FALSE(sha(rounds)) << rounds;
    const auto yescrypt = [](const std::string& costs) {
        return isHash("$y$" + costs + kYescrypt.substr(6));
    };
    EXPECT_TRUE(yescrypt("j9T"));
    EXPECT_TRUE(yescrypt("jDT"));  // 256 MiB, mkpasswd -R 9
    for (const auto* costs : {"jET", "jFT", "jzT", "jDU", "j9..", "jz", ""})
        EXPECT_FALSE(yescrypt(costs)) << costs;
    const auto digest = std::string(43, 'a');
    // Valid, but of a kind whose cost is not looked at.
    EXPECT_FALSE(isHash("$2b$31$" + std::string(22, 'a') + digest.substr(0, 31)));
    EXPECT_FALSE(isHash("$7$CU..../....saltsalt$" + digest));
}

TEST(Passwords, ABrokenHashIsNone) {
    const auto good = hashPassword("secret1");
    for (std::size_t length = 0; length < good.size() - 1; ++length)
        EXPECT_FALSE(isHash(good.substr(0, length))) << length;
    for (const auto& bad :
         {"$argon2i" + good.substr(9), "$argon2id$v=16" + good.substr(14), good + "$", good + " ",
          good + std::string(200, 'a'), std::string("$argon2id$"), std::string()})
        EXPECT_FALSE(isHash(bad)) << bad;
}

}  // namespace
}  // namespace axon::users
