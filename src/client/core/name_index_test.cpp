// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/name_index.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/testing/test_environment.hpp"

namespace axon::client::test {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

class NameIndexTest : public ::testing::Test {
  protected:
    NameIndexTest() {
        index.put(uuid(2), "PeopleBot");
        index.put(uuid(1), "PeopleBot");
        index.put(uuid(3), "Cyton");
    }
    std::string resolved(std::string_view text) {
        const auto id = index.resolve(text);
        return id ? id.value() : std::string(refusalName(id.refusal().code));
    }
    NameIndex index;
};

TEST_F(NameIndexTest, FindsByNameNumberUuidAndPrefix) {
    EXPECT_EQ(resolved("Cyton"), uuid(3));
    EXPECT_EQ(resolved("cyton"), uuid(3));
    EXPECT_EQ(resolved("PeopleBot#1"), uuid(1));
    EXPECT_EQ(resolved("PeopleBot#2"), uuid(2));
    EXPECT_EQ(resolved(uuid(2)), uuid(2));
    EXPECT_EQ(resolved(uuid(2).substr(0, 8)), uuid(2));
}

TEST_F(NameIndexTest, WhatIsNotReadyIsFoundWhereNothingReadyIsMeant) {
    index.put(uuid(4), "Cyton", false);
    index.put(uuid(5), "Greeter", false);
    EXPECT_EQ(resolved("Cyton"), uuid(3))
        << "an Entity Manager that waits for its application makes no name ambiguous";
    EXPECT_EQ(resolved("cyton"), uuid(3));
    EXPECT_EQ(index.label(uuid(3)), "Cyton");
    EXPECT_EQ(index.label(uuid(4)), uuid(4).substr(0, 8));
    EXPECT_EQ(resolved(index.label(uuid(4))), uuid(4));
    EXPECT_EQ(resolved("Greeter"), uuid(5));
    EXPECT_EQ(resolved("greeter"), uuid(5));
    EXPECT_EQ(index.label(uuid(5)), "Greeter");
    EXPECT_THAT(index.resolve("Greetr").refusal().message, HasSubstr("\"Greeter\""));
    // In doubt a stop stops.
    EXPECT_THAT(index.resolveAll("Cyton").value(), ElementsAre(uuid(3), uuid(4)));
    EXPECT_THAT(index.resolveAll("cyton").value(), ElementsAre(uuid(3), uuid(4)));

    index.put(uuid(4), "Cyton");  // it has become ready
    EXPECT_EQ(resolved("Cyton"), "AMBIGUOUS_ENTITY");
    EXPECT_EQ(index.label(uuid(4)), "Cyton#2");
    index.remove(uuid(5));
    EXPECT_EQ(resolved("Greeter"), "UNKNOWN_ENTITY");
}

TEST_F(NameIndexTest, AnAmbiguousNameIsRefusedWithTheCandidates) {
    const auto refusal = index.resolve("PeopleBot").refusal();
    EXPECT_EQ(refusal.code, RefusalCode::AmbiguousEntity);
    EXPECT_THAT(refusal.message, HasSubstr("PeopleBot#1"));
    EXPECT_THAT(refusal.message, HasSubstr(uuid(2)));
    EXPECT_EQ(resolved("0000"), "AMBIGUOUS_ENTITY");
    EXPECT_THAT(index.resolveAll("PeopleBot").value(), ElementsAre(uuid(1), uuid(2)));
}

TEST_F(NameIndexTest, UnknownNamesAreRefusedWithNearOnes) {
    const auto refusal = index.resolve("Citon").refusal();
    EXPECT_EQ(refusal.code, RefusalCode::UnknownEntity);
    EXPECT_THAT(refusal.message, HasSubstr("Cyton"));
    for (const auto* text : {"", "000", "PeopleBot#0", "PeopleBot#3", "PeopleBot#x", "#1", "#"}) {
        EXPECT_EQ(resolved(text), "UNKNOWN_ENTITY") << text;
    }
}

TEST_F(NameIndexTest, LabelsSayWhatAPersonWouldHaveToWrite) {
    EXPECT_EQ(index.label(uuid(3)), "Cyton");
    EXPECT_EQ(index.label(uuid(2)), "PeopleBot#2");
    index.remove(uuid(1));
    EXPECT_EQ(index.label(uuid(2)), "PeopleBot");
    index.put(uuid(2), "Renamed");
    EXPECT_EQ(resolved("PeopleBot"), "UNKNOWN_ENTITY");
    EXPECT_EQ(resolved("Renamed"), uuid(2));
}

}  // namespace
}  // namespace axon::client::test
