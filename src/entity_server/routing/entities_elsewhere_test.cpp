// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/routing/entities_elsewhere.hpp"

#include <gtest/gtest.h>

#include "common/neighbours.hpp"

namespace axon::entity_server {
namespace {

std::string serverOf(const EntitiesElsewhere& elsewhere, const std::string& entity) {
    const auto data = elsewhere.serverOf(entity, Lane::Data);
    const auto signal = elsewhere.serverOf(entity, Lane::Signal);
    EXPECT_EQ(data == nullptr, signal == nullptr) << "both lanes know the same";
    return data ? *data : "nobody";
}

TEST(EntitiesElsewhere, TheServerThatSaidSoLastHasAnEntityUntilItSaysOtherwise) {
    EntitiesElsewhere elsewhere(10);
    elsewhere.learn("s1", {"a", "b"});
    elsewhere.learn("s2", {"a"});
    EXPECT_EQ(serverOf(elsewhere, "a"), "s2");
    elsewhere.learn("s1", {"b"});
    EXPECT_EQ(serverOf(elsewhere, "a"), "s2") << "it has not been the first one's for a while";
    EXPECT_EQ(serverOf(elsewhere, "b"), "s1");
    elsewhere.learn("s2", {});
    EXPECT_EQ(serverOf(elsewhere, "a"), "nobody");
}

TEST(EntitiesElsewhere, AServerThatIsGoneHasNoneAndOneThatNobodyKnowsLosesNone) {
    EntitiesElsewhere elsewhere(10);
    elsewhere.learn("s2", {});
    elsewhere.learn("s1", {"a", "a"});
    elsewhere.learn("s1", {});
    elsewhere.learn("s1", {});
    EXPECT_EQ(serverOf(elsewhere, "a"), "nobody");
}

TEST(EntitiesElsewhere, WhatIsBeyondItsBoundsIsNotLearnt) {
    EntitiesElsewhere elsewhere(2);
    elsewhere.learn("s1", {"a", "b"});
    elsewhere.learn("s1", {"c", "d", "e"});
    EXPECT_EQ(serverOf(elsewhere, "a"), "s1");
    EXPECT_EQ(serverOf(elsewhere, "c"), "nobody");
    for (std::size_t i = 1; i < Neighbours::kMost; ++i)
        elsewhere.learn("n" + std::to_string(i), {"e" + std::to_string(i)});
    elsewhere.learn("one more", {"z"});
    EXPECT_EQ(serverOf(elsewhere, "z"), "nobody");
    elsewhere.learn("s1", {});
    elsewhere.learn("one more", {"z"});
    EXPECT_EQ(serverOf(elsewhere, "z"), "one more");
}

}  // namespace
}  // namespace axon::entity_server
