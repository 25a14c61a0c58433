// SPDX-License-Identifier: MIT
#include "common/entity_name.hpp"

#include <gtest/gtest.h>

#include "common/laboratory_name.hpp"

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

TEST(LaboratoryNames, ACertificatePermitsOneNameOrThoseOfOneLaboratory) {
    EXPECT_TRUE(certificatePermits("Arm", "Arm"));
    EXPECT_TRUE(certificatePermits("b/", "b/Arm"));
    EXPECT_TRUE(certificatePermits("b/Arm", "b/Arm"));
    for (const auto* name : {"b/", "b", "", "c/Arm", "bb/Arm", "B/Arm", "Arm"})
        EXPECT_FALSE(certificatePermits("b/", name)) << name;
    EXPECT_FALSE(certificatePermits("Arm", "Arm2"));
    EXPECT_FALSE(certificatePermits("/", "/Arm")) << "no laboratory has an empty name";
}

}  // namespace
}  // namespace axon
