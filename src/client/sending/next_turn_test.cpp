// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/sending/next_turn.hpp"

#include <gtest/gtest.h>

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;

TEST(NextTurnTest, OnlyWhatIsDueEarlierWakesAndOnlyOnce) {
    const TimePoint now{1000s};
    NextTurn turn;
    EXPECT_EQ(turn.end(now + 10s), now + 10s);
    EXPECT_FALSE(turn.mustWakeFor(now + 10s));
    EXPECT_TRUE(turn.mustWakeFor(now + 9s));
    EXPECT_FALSE(turn.mustWakeFor(now + 9s)) << "it has been woken for that already";
    EXPECT_TRUE(turn.mustWakeFor(now + 8s));
}

TEST(NextTurnTest, AThreadThatIsAwakeIsNotWoken) {
    const TimePoint now{1000s};
    NextTurn turn;
    turn.begin();
    EXPECT_FALSE(turn.mustWakeFor(now - 1s));
    turn.end(now + 10s);
    EXPECT_TRUE(turn.mustWakeFor(now + 1s));
}

TEST(NextTurnTest, OneThatHasNotBeenGivenATimeIsWokenForWhateverIsDue) {
    NextTurn turn;
    EXPECT_FALSE(turn.mustWakeFor(TimePoint::max()));
    EXPECT_TRUE(turn.mustWakeFor(TimePoint{1000s}));
}

}  // namespace
}  // namespace axon::client::test
