// SPDX-License-Identifier: MIT
#include "common/queue_share.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

std::string sessionOf(const std::string& user, const std::string& rest) {
    return userPart(user) + "8" + rest.substr(0, 3) + "-9abc-" + rest;
}

TEST(QueueShare, AllSessionsOfAUserShareOnePartAtWhicheverServer) {
    const auto one = sessionOf("bob", "0123456789ab");
    const auto other = sessionOf("bob", "ba9876543210");
    ASSERT_EQ(one.size(), 36U);
    EXPECT_NE(one, other);
    EXPECT_EQ(senderKey(one), senderKey(other));
    EXPECT_EQ(senderKey(one), senderKey("fe1:0a1b2c3d:" + other));
    EXPECT_NE(senderKey(one), senderKey(sessionOf("ann", "0123456789ab")));
}

TEST(QueueShare, WhoChoosesItsIdItselfHasNobodysPart) {
    auto chosen = sessionOf("bob", "0123456789ab");
    chosen[kUserDigits] = '4';
    auto second = chosen;
    second.back() = '0';
    EXPECT_NE(senderKey(chosen), senderKey(sessionOf("bob", "0123456789ab")));
    EXPECT_NE(senderKey(chosen), senderKey(second));
    EXPECT_NE(senderKey(""), kServersOwn);
    EXPECT_NE(senderKey(userPart("bob") + "8"), senderKey(sessionOf("bob", "0123456789ab"))) << "no UUID";
}

TEST(QueueShare, TheBeginningOfAUsersIdsIsTheSameInEveryProgram) {
    EXPECT_EQ(userPart("ann"), "e6f79d19-fcb8-");
}

TEST(QueueShare, StopsCountForEachSession) {
    EXPECT_NE(sessionKey(sessionOf("bob", "0123456789ab")), sessionKey(sessionOf("bob", "ba9876543210")));
}

TEST(QueueShare, WhoHasTheWholeQueueCountsAsTheServer) {
    EXPECT_EQ(senderKey(sessionOf("bob", "0123456789ab"), QueueShare::Whole), kServersOwn);
}

}  // namespace
}  // namespace axon
