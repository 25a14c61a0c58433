// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/visitors.hpp"

#include <gtest/gtest.h>

#include <set>
#include <vector>

namespace axon::console {
namespace {

using namespace std::chrono_literals;

class VisitorsTest : public testing::Test {
  protected:
    ManualClock clock;
    SeededRandom random{1};
    Visitors visitors{clock, random};
};

TEST_F(VisitorsTest, AKeyIsWhoLoggedInUntilLogOut) {
    const auto key = visitors.enter("anna");
    EXPECT_EQ(key.size(), 32U);
    EXPECT_EQ(visitors.userOf(key), "anna");
    visitors.leave(key);
    EXPECT_FALSE(visitors.userOf(key));
    visitors.leave(key);
}

TEST_F(VisitorsTest, AKeyEndsAfterTwelveHours) {
    const auto key = visitors.enter("anna");
    clock.advance(12h - 1s);
    EXPECT_TRUE(visitors.userOf(key));
    clock.advance(1s);
    EXPECT_FALSE(visitors.userOf(key));
}

TEST_F(VisitorsTest, ATicketIsGoodOnce) {
    const auto ticket = visitors.ticket("anna");
    EXPECT_EQ(visitors.redeem(ticket), "anna");
    EXPECT_FALSE(visitors.redeem(ticket));
}

TEST_F(VisitorsTest, KeysAndTicketsOfAUserAreForgottenAndNobodyElses) {
    const auto key = visitors.enter("anna"), other = visitors.enter("anna"), bobs = visitors.enter("bob");
    const auto ticket = visitors.ticket("anna"), bobs_ticket = visitors.ticket("bob");
    visitors.ticket("carl");
    EXPECT_EQ(visitors.users(), (std::vector<std::string>{"anna", "bob", "carl"}));
    visitors.forget("anna");
    visitors.forget("anna");
    EXPECT_FALSE(visitors.userOf(key));
    EXPECT_FALSE(visitors.userOf(other));
    EXPECT_FALSE(visitors.redeem(ticket));
    EXPECT_EQ(visitors.userOf(bobs), "bob");
    EXPECT_EQ(visitors.redeem(bobs_ticket), "bob");
    clock.advance(Visitors::kTicket);
    EXPECT_EQ(visitors.users(), (std::vector<std::string>{"bob"}));
    EXPECT_EQ(visitors.userOf(visitors.enter("anna")), "anna");
}

TEST_F(VisitorsTest, ATicketIsGoodForHalfAMinute) {
    const auto ticket = visitors.ticket("anna");
    clock.advance(30s);
    EXPECT_FALSE(visitors.redeem(ticket));
}

TEST_F(VisitorsTest, AKeyIsNoTicketAndATicketNoKey) {
    EXPECT_FALSE(visitors.redeem(visitors.enter("anna")));
    EXPECT_FALSE(visitors.userOf(visitors.ticket("anna")));
}

TEST_F(VisitorsTest, WhatWasNeverGivenIsNobodys) {
    visitors.enter("anna");
    for (const auto& key :
         {std::string(), std::string("0"), std::string(32, '0'), std::string(100'000, 'a')}) {
        EXPECT_FALSE(visitors.userOf(key));
        EXPECT_FALSE(visitors.redeem(key));
    }
}

TEST_F(VisitorsTest, AUserWhoLogsInEndlesslyLosesTheOldestVisitsAndNobodyElses) {
    const auto others = visitors.enter("bernd");
    std::vector<std::string> keys;
    for (std::size_t i = 0; i <= Visitors::kVisitsOfOneMax; ++i) keys.push_back(visitors.enter("anna"));
    EXPECT_FALSE(visitors.userOf(keys.front()));
    EXPECT_TRUE(visitors.userOf(keys[1]));
    EXPECT_TRUE(visitors.userOf(others));
}

TEST_F(VisitorsTest, AllTogetherAreBounded) {
    const auto first = visitors.ticket("user0");
    for (std::size_t i = 1; i <= Visitors::kTicketsMax; ++i) visitors.ticket("user" + std::to_string(i));
    EXPECT_FALSE(visitors.redeem(first));
}

TEST_F(VisitorsTest, NoTwoKeysAreTheSame) {
    std::set<std::string> keys;
    for (int i = 0; i < 1000; ++i) keys.insert(visitors.enter("user" + std::to_string(i)));
    EXPECT_EQ(keys.size(), 1000U);
}

}  // namespace
}  // namespace axon::console
