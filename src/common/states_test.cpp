// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <string>

#include "common/axon/states.hpp"

namespace axon {
namespace {

TEST(EntityStates, AreTheThesisNineTokensInTheOrderOfTheContract) {
    std::string all;
    for (int state = 0; state <= static_cast<int>(EntityState::ERR); ++state)
        all += std::string(toString(static_cast<EntityState>(state))) + ' ';
    EXPECT_EQ(all, "UNAV INIT ENVCONN IDLE REG COLLAB SLAVE BUSY ERR ");
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
