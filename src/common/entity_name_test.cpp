// SPDX-License-Identifier: MIT
#include "common/entity_name.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

TEST(EntityNames, AreNotWhatPeopleWriteForAnotherEntity) {
    for (const auto* name :
         {"Q", "PeopleBot", "Arm #", "Q#", "Q#two", "Q#2b", "2", "#", "C# robot", "00000001-1111"})
        EXPECT_TRUE(isEntityName(name)) << name;
    for (const auto* name : {"Q#2", "Q#0", "#1", "Q#1#12", "Q#99999999999999999999999",
                             "00000001-1111-4111-8111-111111111111", "0000000A-1111-4111-8111-111111111111"})
        EXPECT_FALSE(isEntityName(name)) << name;
}

}  // namespace
}  // namespace axon
