// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/ownership/wait_list.hpp"

#include <gtest/gtest.h>

#include "entity_manager/core/ownership/hand_over.hpp"

namespace axon::entity_manager {
namespace {

Claim claimOf(const std::string& client, const std::string& request) {
    return {{client, client + "@lab", Role::Operator}, request, {}};
}

struct Waiting : testing::Test {
    ManualClock clock;
    WaitList list;
    std::size_t join(const std::string& client, const std::string& request) {
        const auto claim = claimOf(client, request);
        EXPECT_TRUE(list.mayJoin(claim.client, request).ok());
        return list.join(claim, clock.now());
    }
    std::size_t placeOf(const std::string& client, const std::string& request) {
        return list.placeOf(claimOf(client, request).client, request);
    }
};

TEST_F(Waiting, PlacesAreInTheOrderOfArrivalAndAskingAgainKeepsThem) {
    EXPECT_EQ(join("client1", "r1"), 1U);
    EXPECT_EQ(join("client2", "r2"), 2U);
    EXPECT_EQ(join("client1", "r1"), 1U);
    EXPECT_EQ(list.size(), 2U);
    EXPECT_EQ(placeOf("client2", "r1"), 0U) << "a request is known by its client too";
    EXPECT_EQ(list.pop().client.id, "client1");
    EXPECT_EQ(list.first().client.id, "client2");
}

TEST_F(Waiting, AClientHasOnePlace) {
    join("client1", "r1");
    EXPECT_EQ(list.mayJoin({"client1", "", Role::Operator}, "r2").code, RefusalCode::Duplicate);
    EXPECT_TRUE(list.mayJoin({"client1", "", Role::Operator}, "r1").ok());
}

TEST_F(Waiting, TheListTakesNoMoreThanItsBoundButRefreshesThoseInIt) {
    for (std::size_t i = 0; i < WaitList::kMax; ++i) join("c" + std::to_string(i), "r");
    EXPECT_EQ(list.mayJoin({"late", "", Role::Operator}, "r").code, RefusalCode::Overloaded);
    EXPECT_TRUE(list.mayJoin({"c0", "", Role::Operator}, "r").ok());
}

TEST_F(Waiting, WhoIsNotHeardOfWithinItsTimeIsGivenUpAndTheOthersMoveUp) {
    join("client1", "r1");
    clock.advance(std::chrono::seconds{5});
    join("client2", "r2");
    ASSERT_TRUE(list.nextExpiry());
    EXPECT_EQ(*list.nextExpiry() - clock.now(), std::chrono::seconds{10});
    clock.set(*list.nextExpiry() - Duration{1});
    EXPECT_TRUE(list.expire(clock.now()).empty());
    EXPECT_TRUE(list.takeChanges().empty());
    clock.advance(Duration{1});
    const auto gone = list.expire(clock.now());
    ASSERT_EQ(gone.size(), 1U);
    EXPECT_EQ(gone[0].client.id, "client1");
    const auto changes = list.takeChanges();
    ASSERT_EQ(changes.size(), 1U);
    EXPECT_EQ(changes[0].first.client.id, "client2");
    EXPECT_EQ(changes[0].second, 1U);
    EXPECT_TRUE(list.takeChanges().empty()) << "told once";
}

TEST_F(Waiting, ForgettingAClientLeavesTheOthers) {
    join("client1", "r1");
    join("client2", "r2");
    EXPECT_TRUE(list.forget("client3").empty());
    EXPECT_EQ(list.forget("client1").size(), 1U);
    EXPECT_EQ(placeOf("client2", "r2"), 1U);
    EXPECT_FALSE(list.leave({"client2", "", Role::Operator}, "r9"));
    EXPECT_TRUE(list.leave({"client2", "", Role::Operator}, "r2"));
    EXPECT_TRUE(list.empty());
    EXPECT_FALSE(list.nextExpiry());
}

TEST(HandOver, OneQuestionAtATimeAndSilenceEndsItAtItsTime) {
    ManualClock clock;
    HandOver hand_over;
    EXPECT_TRUE(hand_over.mayAsk("client1@lab").ok());
    EXPECT_FALSE(hand_over.expire(clock.now()));
    hand_over.ask(claimOf("client2", "r2"), false, "please", {std::chrono::seconds{3}, true}, clock.now());
    const auto refusal = hand_over.mayAsk("client1@lab");
    EXPECT_EQ(refusal.code, RefusalCode::Reserved);
    EXPECT_NE(refusal.message.find("client2@lab asks client1@lab"), std::string::npos) << refusal.message;
    EXPECT_EQ(refusal.holder, "client1@lab");
    EXPECT_TRUE(hand_over.isOpenFor({"client2", "", Role::Operator}, "r2"));
    EXPECT_FALSE(hand_over.isOpenFor({"client3", "", Role::Operator}, "r2"));
    clock.advance(std::chrono::seconds{3} - Duration{1});
    EXPECT_FALSE(hand_over.expire(clock.now()));
    clock.advance(Duration{1});
    const auto question = hand_over.expire(clock.now());
    ASSERT_TRUE(question);
    EXPECT_TRUE(question->yield);
    EXPECT_FALSE(hand_over.open());
}

}  // namespace
}  // namespace axon::entity_manager
