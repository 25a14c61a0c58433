// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/holdings.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::front_end_server {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::Pair;

TEST(Holdings, TellWhetherAClientMustBeWatchedCloselyFromNowOn) {
    Holdings holdings;
    EXPECT_TRUE(holdings.set("c1", "e1", false));
    EXPECT_FALSE(holdings.set("c1", "e1", false));
    EXPECT_FALSE(holdings.busy("c1"));
    EXPECT_TRUE(holdings.set("c1", "e2", true));
    EXPECT_TRUE(holdings.busy("c1"));
    EXPECT_FALSE(holdings.busy("c2"));
    EXPECT_TRUE(holdings.set("c1", "e2", false));
    EXPECT_FALSE(holdings.busy("c1"));
}

TEST(Holdings, WhatIsLetGoOfIsHeldNoLonger) {
    Holdings holdings;
    holdings.set("c1", "e1", true);
    holdings.set("c1", "e2", false);
    holdings.erase("c1", "e1");
    holdings.erase("c2", "e2");
    EXPECT_FALSE(holdings.has("c1", "e1"));
    EXPECT_THAT(holdings.of("c1"), ElementsAre(Pair("e2", false)));
    holdings.erase("c1", "e2");
    EXPECT_THAT(holdings.of("c1"), IsEmpty());
}

}  // namespace
}  // namespace axon::front_end_server
