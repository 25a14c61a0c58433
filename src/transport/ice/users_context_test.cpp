// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/users_context.hpp"

#include <gtest/gtest.h>

namespace axon::transport {
namespace {

TEST(UsersContext, HasAFingerprintAndNothingElseIsRead) {
    EXPECT_EQ(usersIn(usersContext("0123abcd")), "0123abcd");
    EXPECT_EQ(usersContext(""), Ice::Context());
    EXPECT_EQ(usersIn({}), "");
    for (const std::string& hostile :
         {std::string("forged\nline"), std::string("0123ABCD"), std::string(65, 'a'), std::string()})
        EXPECT_EQ(usersIn({{kContextUsers, hostile}}), "");
}

}  // namespace
}  // namespace axon::transport
