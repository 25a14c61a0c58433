// SPDX-License-Identifier: MIT
#include <axon/status.pb.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "common/axon/states.hpp"

namespace axon {
namespace {

TEST(EntityStates, BeginWithTheThesisNineTokens) {
    std::string all;
    for (const auto state : kEntityStates) all += std::string(toString(state)) + ' ';
    EXPECT_THAT(all, ::testing::StartsWith("UNAV INIT ENVCONN IDLE REG COLLAB SLAVE BUSY ERR "));
}

TEST(EntityStates, AreThoseOfTheContractInItsOrder) {
    int number = 0;
    for (const auto state : kEntityStates) {
        EXPECT_EQ(static_cast<int>(state), number);
        EXPECT_EQ(proto::EntityState_Name(static_cast<proto::EntityState>(++number)), toString(state));
    }
    EXPECT_EQ(proto::EntityState_ARRAYSIZE, number + 1) << "the contract has more";
}

TEST(EntityStates, OfAnEntityThatCanBeHeldAreIdleAndRegAndWhatWorks) {
    for (const auto state : {EntityState::UNAV, EntityState::INIT, EntityState::ENVCONN, EntityState::ERR})
        EXPECT_EQ(availability(state), Availability::Away) << toString(state);
    for (const auto state : {EntityState::IDLE, EntityState::REG})
        EXPECT_EQ(availability(state), Availability::Ready) << toString(state);
    for (const auto state : {EntityState::COLLAB, EntityState::SLAVE, EntityState::BUSY})
        EXPECT_EQ(availability(state), Availability::Working) << toString(state);
}

TEST(EntityStates, ANumberThatIsNoneIsAway) {
    const auto unknown = static_cast<EntityState>(200);
    EXPECT_STREQ(toString(unknown), "?");
    EXPECT_EQ(availability(unknown), Availability::Away);
}

}  // namespace
}  // namespace axon
