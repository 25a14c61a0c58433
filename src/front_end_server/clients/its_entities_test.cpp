// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/its_entities.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::front_end_server {
namespace {

using testing::IsEmpty;
using testing::Pair;
using testing::UnorderedElementsAre;

TEST(ItsEntities, OneThatWasAskedForACheckOutStaysSoWhateverItIsAskedForNext) {
    ItsEntities entities;
    EXPECT_FALSE(entities.asked("a"));
    entities.ask("a", false, true);
    EXPECT_TRUE(entities.asked("a"));
    EXPECT_FALSE(entities.askedForCheckOut("a"));
    entities.ask("a", true, true);
    entities.ask("a", false, true);
    EXPECT_TRUE(entities.askedForCheckOut("a"));
}

TEST(ItsEntities, ACheckOutIsUnderWayUntilItIsGivenBackOrGivenUp) {
    ItsEntities entities;
    entities.ask("a", false, true, 1);
    EXPECT_FALSE(entities.wants("a"));
    EXPECT_EQ(entities.giveUp("a"), std::nullopt);
    entities.ask("a", true, true, 2);
    entities.ask("a", true, true, 3);
    EXPECT_TRUE(entities.wants("a"));
    entities.setHeld("a", false);
    EXPECT_TRUE(entities.wants("a")) << "it has not been granted yet";
    entities.setHeld("a", true);
    entities.setHeld("a", false);
    EXPECT_FALSE(entities.wants("a"));
    EXPECT_TRUE(entities.askedForCheckOut("a"));
    entities.ask("a", true, true, 4);
    EXPECT_EQ(entities.giveUp("a"), 4);
    EXPECT_FALSE(entities.wants("a"));
}

TEST(ItsEntities, TheyAreToldOnceOfTheClientsEndAndNobodyIsAskedAfterwards) {
    ItsEntities entities;
    entities.ask("a", true, true);
    entities.ask("b", false, true);
    EXPECT_THAT(entities.take(), UnorderedElementsAre(Pair("a", true), Pair("b", false)));
    EXPECT_FALSE(entities.ask("c", true, true));
    EXPECT_THAT(entities.take(), IsEmpty());
    EXPECT_FALSE(entities.asked("a"));
}

TEST(ItsEntities, NamesThatNobodyHasFillNothing) {
    ItsEntities entities;
    for (std::size_t i = 0; i < 1000; ++i)
        EXPECT_TRUE(entities.ask("nobody " + std::to_string(i), true, false)) << "the entity refuses it";
    EXPECT_TRUE(entities.asked("nobody 255"));
    EXPECT_FALSE(entities.asked("nobody 256"));
    entities.ask("nobody 0", true, false);
    EXPECT_TRUE(entities.ask("a", true, true));
    EXPECT_TRUE(entities.asked("a")) << "one that is there is noted all the same";
}

TEST(ItsEntities, OneThatIsJoiningIsNotedHoweverManyWereAsked) {
    ItsEntities entities;
    for (std::size_t i = 0; i < 2 * ItsEntities::kUnknown; ++i)
        entities.ask("known " + std::to_string(i), true, true);
    for (std::size_t i = 0; i < ItsEntities::kUnknown; ++i) {
        const auto name = "joining " + std::to_string(i);
        EXPECT_TRUE(entities.ask(name, true, false));
        EXPECT_TRUE(entities.askedForCheckOut(name)) << name;
    }
    entities.ask("one more", true, false);
    EXPECT_FALSE(entities.asked("one more"));
    entities.ask("joining 0", true, true);  // it has joined
    entities.ask("one more", true, false);
    EXPECT_TRUE(entities.asked("one more"));
}

TEST(ItsEntities, WhatIsHeldHasNothingToDoWithWhatWasAsked) {
    ItsEntities entities;
    entities.setHeld("a", false);
    EXPECT_FALSE(entities.holds("a"));
    entities.setHeld("a", true);
    entities.setHeld("a", true);
    entities.take();
    EXPECT_TRUE(entities.holds("a"));
    EXPECT_FALSE(entities.asked("a"));
    entities.setHeld("a", false);
    EXPECT_FALSE(entities.holds("a"));
}

}  // namespace
}  // namespace axon::front_end_server
