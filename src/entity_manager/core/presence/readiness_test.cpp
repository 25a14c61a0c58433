// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/presence/readiness.hpp"

#include <gtest/gtest.h>

namespace axon::entity_manager {
namespace {

TEST(Readinesses, WithoutAnythingFoundTheEntityWaitsForItsApplicationByName) {
    const Readiness readiness("pilot");
    EXPECT_EQ(readiness.whyNot(EntityState::UNAV), "waiting for the robot application \"pilot\"");
}

TEST(Readinesses, WhatTheSearchHasFoundIsSaidUntilTheApplicationIsNoLongerLookedFor) {
    Readiness readiness("pilot");
    readiness.sought("another application listens");
    EXPECT_EQ(readiness.whyNot(EntityState::UNAV), "another application listens");
    readiness.sought({});
    EXPECT_EQ(readiness.whyNot(EntityState::UNAV), "waiting for the robot application \"pilot\"");
}

TEST(Readinesses, WhyTheLinkEndedComesBeforeWhatTheSearchHasFound) {
    Readiness readiness("pilot");
    readiness.notReady("the link is down");
    EXPECT_EQ(readiness.whyNot(EntityState::UNAV), "the link is down");
    readiness.sought("nobody listens");
    EXPECT_EQ(readiness.whyNot(EntityState::UNAV), "the link is down; nobody listens");
}

TEST(Readinesses, WhatTheSearchHasFoundIsNoReasonOnceAnApplicationIsLinked) {
    Readiness readiness("pilot");
    readiness.sought("nobody listens");
    EXPECT_EQ(readiness.whyNot(EntityState::INIT), "");
    readiness.notReady("the services profile is missing");
    EXPECT_EQ(readiness.whyNot(EntityState::INIT), "the services profile is missing");
    EXPECT_EQ(readiness.whyNot(EntityState::ERR), "the services profile is missing");
}

TEST(Readinesses, AReasonOutlivesUnavAndErrAndNoOtherState) {
    Readiness readiness("pilot");
    readiness.notReady("the profile is wrong");
    readiness.stateIs(EntityState::ERR);
    readiness.stateIs(EntityState::UNAV);
    EXPECT_EQ(readiness.whyNot(EntityState::UNAV), "the profile is wrong");
    readiness.stateIs(EntityState::INIT);
    EXPECT_EQ(readiness.whyNot(EntityState::UNAV), "waiting for the robot application \"pilot\"");
}

TEST(Readinesses, AnEntityThatIsReadyHasNoReason) {
    Readiness readiness("pilot");
    readiness.notReady("the link is down");
    for (const auto state : {EntityState::ENVCONN, EntityState::IDLE, EntityState::REG, EntityState::BUSY})
        EXPECT_EQ(readiness.whyNot(state), "");
}

}  // namespace
}  // namespace axon::entity_manager
