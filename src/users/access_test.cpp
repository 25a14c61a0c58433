// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/access.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "users/users.hpp"

namespace axon::users {
namespace {

using testing::HasSubstr;

const std::string kUuid = "7d0f8a3e-0000-4000-8000-000000000001";

Access of(const std::string& text) {
    return Users::parse(text, "f").access();
}
bool may(const Access& access, EntityRight right, const std::string& user, Role role,
         const std::string& name) {
    return access.allows(user, role, right, kUuid, name);
}

TEST(Access, WithoutALineEverybodyHasEveryRight) {
    const Access none;
    EXPECT_TRUE(none.empty());
    for (const auto right : kEntityRights) EXPECT_TRUE(may(none, right, "ann", Role::Observer, "arm-1"));
}

TEST(Access, ALineRestrictsOneRightOfTheEntitiesThatFit) {
    const auto access = of("@checkout arm-* ann @admin\n");
    for (const auto right : {EntityRight::CheckOut, EntityRight::Force}) {
        EXPECT_TRUE(may(access, right, "ann", Role::Operator, "arm-1"));
        EXPECT_TRUE(may(access, right, "boss", Role::Admin, "arm-1"));
        EXPECT_FALSE(may(access, right, "bob", Role::Operator, "arm-1"));
        EXPECT_TRUE(may(access, right, "bob", Role::Operator, "PeopleBot"));
    }
    EXPECT_TRUE(may(access, EntityRight::See, "bob", Role::Operator, "arm-1"));
    EXPECT_TRUE(may(access, EntityRight::Rearm, "bob", Role::Operator, "arm-1"));
}

TEST(Access, WhoDoesNotSeeAnEntityHasNoRightOverIt) {
    const auto access = of("@see arm-* ann\n@rearm arm-1 bob ann\n");
    for (const auto right : kEntityRights) {
        EXPECT_FALSE(may(access, right, "bob", Role::Admin, "arm-1"));
        EXPECT_TRUE(may(access, right, "ann", Role::Operator, "arm-1"));
    }
}

TEST(Access, TheFirstLineThatFitsCounts) {
    const auto access = of("@see arm-1 *\n@see arm-* ann\n@see * -\n");
    EXPECT_TRUE(may(access, EntityRight::See, "bob", Role::Observer, "arm-1"));
    EXPECT_FALSE(may(access, EntityRight::See, "bob", Role::Observer, "arm-2"));
    EXPECT_TRUE(may(access, EntityRight::See, "ann", Role::Observer, "arm-2"));
    EXPECT_FALSE(may(access, EntityRight::See, "ann", Role::Admin, "PeopleBot"));
}

TEST(Access, AnEntityIsNamedByItsUuidToo) {
    const auto access = of("@checkout " + kUuid + " ann\n");
    EXPECT_FALSE(may(access, EntityRight::CheckOut, "bob", Role::Operator, "any name"));
    EXPECT_TRUE(may(access, EntityRight::CheckOut, "ann", Role::Operator, "any name"));
}

TEST(Access, PatternsFitWholeNames) {
    EXPECT_TRUE(fits("*", ""));
    EXPECT_TRUE(fits("*", "anything"));
    EXPECT_TRUE(fits("a*c", "abbc"));
    EXPECT_TRUE(fits("a*b*c", "axxbyybc"));
    EXPECT_TRUE(fits("Left?arm", "Left arm"));
    EXPECT_TRUE(fits("**a**", "ba"));
    EXPECT_FALSE(fits("a*c", "abcd"));
    EXPECT_FALSE(fits("arm", "arm-1"));
    EXPECT_FALSE(fits("", "a"));
    EXPECT_FALSE(fits("?", ""));
    EXPECT_FALSE(fits("Arm", "arm"));
    // In a time that does not explode.
    EXPECT_FALSE(fits("*a*a*a*a*a*a*a*a*a*a*b", std::string(2000, 'a')));
}

TEST(Access, SaysWhatIsWrongWithALine) {
    const auto complaint = [](const std::string& line) -> std::string {
        try {
            of("# one\n" + line);
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return "accepted";
    };
    EXPECT_THAT(complaint("@stop arm-* ann"), HasSubstr("f:2: expected @see, @checkout, @force or @rearm"));
    EXPECT_THAT(complaint("@"), HasSubstr("expected @see"));
    EXPECT_THAT(complaint("@see arm-*"), HasSubstr("expected '@see ENTITY WHO …'"));
    EXPECT_THAT(complaint("@see arm-* ann *"), HasSubstr("alone"));
    EXPECT_THAT(complaint("@see arm-* - ann"), HasSubstr("alone"));
    EXPECT_THAT(complaint("@see arm-* @entity"), HasSubstr("expected users and roles"));
    EXPECT_THAT(complaint("@see arm-* a:b"), HasSubstr("expected users and roles"));
    EXPECT_THAT(complaint("@see " + std::string(257, 'x') + " ann"), HasSubstr("at most 256"));
    EXPECT_EQ(complaint("@see arm-* ann bob @operator # and why"), "accepted");
    std::string many;
    for (std::size_t i = 0; i <= Access::kRulesMax; ++i) many += "@see * *\n";
    EXPECT_THAT(complaint(many), HasSubstr("f:1002: expected at most 1000"));
}

TEST(Access, TheFingerprintIsThatOfTheLinesToo) {
    const auto print = [](const std::string& text) { return Users::parse(text, "f").fingerprint(); };
    EXPECT_NE(print("@see * ann\n"), print(""));
    EXPECT_NE(print("@see * ann\n@see a bob\n"), print("@see a bob\n@see * ann\n"));  // the order counts
    EXPECT_EQ(print("@see  * ann # why\n"), print("@see * ann\n"));
}

}  // namespace
}  // namespace axon::users
