// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/registration_check.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::entity_server {
namespace {

using testing::HasSubstr;

Registration robot() {
    Registration out;
    out.name = "Robot";
    return out;
}

RefusalCode codeOf(const Registration& registration) {
    return checkRegistration(registration, 0, 0).refusal().code;
}

TEST(RegistrationCheck, TakesAnEntityThatIsNotReadyAndHasNoProfileYet) {
    EXPECT_TRUE(checkRegistration(robot(), 0, 1024).ok());
    EXPECT_TRUE(checkRegistration(robot(), 1024, 1024).ok());
}

TEST(RegistrationCheck, ANameThatPeopleCallAnotherOneByIsRefusedWithOneThatIsNot) {
    auto its = robot();
    its.name = "PeopleBot#2";
    const auto refused = checkRegistration(its, 0, 0).refusal();
    EXPECT_EQ(refused.code, RefusalCode::BadName);
    ASSERT_THAT(refused.message, HasSubstr("such as 'PeopleBot 2'"));
    its.name = "PeopleBot 2";
    EXPECT_TRUE(checkRegistration(its, 0, 0).ok());
}

TEST(RegistrationCheck, RefusesTextsThatWouldMakeEveryListUnreadable) {
    for (auto text : {&Registration::name, &Registration::category, &Registration::type}) {
        auto its = robot();
        its.*text = "\xff";
        EXPECT_EQ(codeOf(its), RefusalCode::Malformed);
    }
    auto its = robot();
    its.category = std::string(1025, 'x');
    EXPECT_EQ(codeOf(its), RefusalCode::Malformed);
}

TEST(RegistrationCheck, RefusesPeriodsThatNobodyCanBeWatchedWith) {
    for (const int period : {-1, 0, 9, 60'001}) {
        auto its = robot();
        its.heartbeat_busy_ms = period;
        EXPECT_EQ(codeOf(its), RefusalCode::OutOfRange);
        its = robot();
        its.heartbeat_idle_ms = period;
        EXPECT_EQ(codeOf(its), RefusalCode::OutOfRange);
    }
}

TEST(RegistrationCheck, ATextOfAStatusIsCutAndMadeReadable) {
    std::string text = std::string(2000, 'x') + "\xff";
    makeValid(text);
    EXPECT_EQ(text, std::string(1024, 'x'));
    text = "a\xff";
    makeValid(text);
    EXPECT_NE(text, "a\xff");
}

}  // namespace
}  // namespace axon::entity_server
