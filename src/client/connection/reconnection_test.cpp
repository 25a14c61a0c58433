// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/connection/reconnection.hpp"

#include <gtest/gtest.h>

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;

TEST(ReconnectionTest, NothingIsDueWhileTheSessionStands) {
    Reconnection reconnection;
    EXPECT_FALSE(reconnection.isDue(TimePoint{1000s}));
    EXPECT_EQ(reconnection.at(), TimePoint::max());
}

TEST(ReconnectionTest, ItWaitsTwiceAsLongAfterEachFailureUpToTheLongest) {
    TimePoint now{1000s};
    Reconnection reconnection;
    reconnection.ask();
    EXPECT_FALSE(reconnection.isDue(now));
    EXPECT_EQ(reconnection.at(), now + Reconnection::kFirst);
    for (const Duration wait : {200ms, 400ms, 800ms, 1600ms, 2000ms, 2000ms}) {
        now = reconnection.at();
        ASSERT_TRUE(reconnection.isDue(now));
        reconnection.failed(now);
        EXPECT_EQ(reconnection.at(), now + wait);
        EXPECT_FALSE(reconnection.isDue(now + wait - 1ms));
    }
}

TEST(ReconnectionTest, AfterASessionItBeginsWithTheShortestWait) {
    TimePoint now{1000s};
    Reconnection reconnection;
    reconnection.ask();
    static_cast<void>(reconnection.isDue(now));
    reconnection.failed(now);
    reconnection.succeeded();
    EXPECT_FALSE(reconnection.isDue(now + 1h));
    reconnection.ask();
    EXPECT_FALSE(reconnection.isDue(now + 1h));
    EXPECT_EQ(reconnection.at(), now + 1h + Reconnection::kFirst);
}

}  // namespace
}  // namespace axon::client::test
