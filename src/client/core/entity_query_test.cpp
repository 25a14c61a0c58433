// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/entity_query.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::client {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::string wrong(std::string_view text) {
    const auto query = parseQuery(text);
    EXPECT_FALSE(query.ok()) << text;
    if (query.ok()) return {};
    EXPECT_EQ(query.refusal().code, RefusalCode::Malformed);
    EXPECT_THAT(query.refusal().message, HasSubstr("For example: 2 ROBOT/MOBILE"));
    return query.refusal().message;
}

TEST(EntityQueryTest, ReadsWhatPeopleWrite) {
    const auto query = parseQuery("2 ROBOT/MOBILE + 1 ROBOT/STATIONARY");
    ASSERT_TRUE(query.ok());
    EXPECT_THAT(query->items,
                ElementsAre(QueryItem{2, "ROBOT", "MOBILE", ""}, QueryItem{1, "ROBOT", "STATIONARY", ""}));
    EXPECT_EQ(query->count(), 3U);
    EXPECT_FALSE(query->needsServices());
}

TEST(EntityQueryTest, CountTypeAndServiceMayBeLeftOut) {
    EXPECT_THAT(parseQuery("robot")->items, ElementsAre(QueryItem{1, "ROBOT", "", ""}));
    EXPECT_THAT(parseQuery("3 mobile")->items, ElementsAre(QueryItem{3, "", "MOBILE", ""}));
    EXPECT_THAT(parseQuery("1 ROBOT with Range Finding+machine")->items,
                ElementsAre(QueryItem{1, "ROBOT", "", "Range Finding"}, QueryItem{1, "MACHINE", "", ""}));
    EXPECT_THAT(parseQuery("ROBOT with 'Pick + Place' + MACHINE")->items,
                ElementsAre(QueryItem{1, "ROBOT", "", "Pick + Place"}, QueryItem{1, "MACHINE", "", ""}));
    EXPECT_TRUE(parseQuery("robot with x")->needsServices());
}

TEST(EntityQueryTest, WhatIsWrittenIsReadAgain) {
    for (const char* text : {"2 ROBOT/MOBILE", "1 STATIONARY", "64 MACHINE with Gripping"}) {
        EXPECT_EQ(toText(parseQuery(text)->items.front()), text);
    }
}

TEST(EntityQueryTest, MistakesSayWhatWasExpected) {
    EXPECT_THAT(wrong(""), HasSubstr("found nothing"));
    EXPECT_THAT(wrong("2 ROBOT +"), HasSubstr("before and after each +"));
    EXPECT_THAT(wrong("2"), HasSubstr("a kind after the number"));
    EXPECT_THAT(wrong("0 ROBOT"), HasSubstr("1 to 64"));
    EXPECT_THAT(wrong("-1 ROBOT"), HasSubstr("\"-1\""));
    EXPECT_THAT(wrong("2x ROBOT"), HasSubstr("\"2x\""));
    EXPECT_THAT(wrong("99999999999999999999 ROBOT"), HasSubstr("how many"));
    EXPECT_THAT(wrong("ROBTO"), HasSubstr("did you mean \"ROBOT\""));
    EXPECT_THAT(wrong("MOBILE/ROBOT"), HasSubstr("before the /"));
    EXPECT_THAT(wrong("ROBOT/FLYING"), HasSubstr("MOBILE or STATIONARY after the /"));
    EXPECT_THAT(wrong("ROBOT MOBILE"), HasSubstr("\"MOBILE\""));
    EXPECT_THAT(wrong("ROBOT with"), HasSubstr("name of a service"));
    EXPECT_THAT(wrong("40 ROBOT + 40 MACHINE"), HasSubstr("64 entities at most"));
}

/// Candidates are "ROBOT/MOBILE" and so on.
Assignment assigned(const char* text, const std::vector<std::string>& candidates) {
    return assign(parseQuery(text).value(), candidates.size(), [&](const QueryItem& item, std::size_t i) {
        const auto slash = candidates[i].find('/');
        return (item.category.empty() || candidates[i].substr(0, slash) == item.category) &&
               (item.type.empty() || candidates[i].substr(slash + 1) == item.type);
    });
}

TEST(AssignmentTest, NobodyServesTwice) {
    const auto one = assigned("2 ROBOT/MOBILE", {"ROBOT/MOBILE"});
    EXPECT_THAT(one.chosen, ElementsAre(0));
    EXPECT_THAT(one.lacking, ElementsAre(1));
    EXPECT_FALSE(one.complete());
}

TEST(AssignmentTest, AWiderItemLeavesTheRareOneToWhoNeedsIt) {
    const auto both = assigned("1 ROBOT + 1 ROBOT/MOBILE", {"ROBOT/MOBILE", "ROBOT/STATIONARY"});
    EXPECT_TRUE(both.complete());
    EXPECT_THAT(both.chosen, ElementsAre(1, 0));
}

TEST(AssignmentTest, SaysWhichItemLacks) {
    const auto lacks = assigned("2 MOBILE + 1 STATIONARY", {"ROBOT/MOBILE", "MACHINE/MOBILE"});
    EXPECT_THAT(lacks.lacking, ElementsAre(0, 1));
    EXPECT_THAT(assigned("1 ROBOT", {}).lacking, ElementsAre(1));
}

}  // namespace
}  // namespace axon::client
