// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users_agreement.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::users {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

struct UsersAgreementTest : testing::Test {
    std::string heard(const std::string& server, const std::string& theirs) {
        return agreement.heard(server, theirs, ours, clock.now());
    }
    ManualClock clock;
    UsersAgreement agreement;
    std::string ours = "11111111";
};

TEST_F(UsersAgreementTest, NothingIsSaidWhileACopyIsOnItsWay) {
    EXPECT_EQ(heard("fe1", ours), "");
    EXPECT_EQ(heard("fe1", "22222222"), "");
    clock.advance(UsersAgreement::kPatience - 1s);
    EXPECT_EQ(heard("fe1", "22222222"), "");
    ours = "22222222";
    EXPECT_EQ(heard("fe1", "22222222"), "");
    clock.advance(1h);
    EXPECT_EQ(heard("fe1", "33333333"), "") << "this difference is new";
}

TEST_F(UsersAgreementTest, ADifferenceIsToldOnceAndItsEnd) {
    heard("fe1", "22222222");
    heard("fe2", ours);
    clock.advance(UsersAgreement::kPatience);
    const auto line = heard("fe1", "33333333");
    EXPECT_THAT(line, HasSubstr("fe1 has other users than this server (fingerprints 33333333 and 11111111)"));
    EXPECT_THAT(line, HasSubstr("fix: "));
    EXPECT_EQ(heard("fe2", ours), "");
    clock.advance(1h);
    EXPECT_EQ(heard("fe1", "33333333"), "");
    EXPECT_EQ(heard("fe1", ours), "users: fe1 has the same users as this server again");
    EXPECT_EQ(heard("fe1", ours), "");
}

TEST_F(UsersAgreementTest, ServersWithoutEndCostNoMemoryWithoutEnd) {
    for (std::size_t i = 0; i < UsersAgreement::kMost; ++i) heard("fe" + std::to_string(i), "22222222");
    heard("one more", "22222222");
    clock.advance(UsersAgreement::kPatience);
    EXPECT_NE(heard("fe0", "22222222"), "");
    EXPECT_EQ(heard("one more", "22222222"), "");
}

}  // namespace
}  // namespace axon::users
