// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/collaboration/farewells.hpp"

#include <gtest/gtest.h>

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

proto::FromMaster end(bool stop) {
    proto::FromMaster message;
    message.set_run_id("run");
    message.mutable_end()->set_stop(stop);
    return message;
}

struct TheFarewells : testing::Test {
    TimePoint now{1h};
    Farewells farewells{250ms};
};

TEST_F(TheFarewells, AnEndIsFollowedByBeatsUntilItIsAnswered) {
    farewells.sent("b", end(false), 50ms, now);
    EXPECT_TRUE(farewells.takeDue(now + 49ms).empty());
    EXPECT_EQ(farewells.nextDeadline(), now + 50ms);
    const auto due = farewells.takeDue(now + 50ms);
    ASSERT_EQ(due.size(), 1U);
    EXPECT_EQ(due[0].first, "b");
    EXPECT_TRUE(due[0].second.has_beat());
    EXPECT_EQ(due[0].second.run_id(), "run");

    farewells.answered("b", "another run");
    farewells.answered("c", "run");
    EXPECT_EQ(farewells.nextDeadline(), now + 100ms) << "that was somebody else's answer";
    farewells.answered("b", "run");
    EXPECT_EQ(farewells.nextDeadline(), TimePoint::max());
}

TEST_F(TheFarewells, AStopIsSaidAgainForTwiceTheWatchdog) {
    farewells.sent("b", end(true), 200ms, now);
    const auto due = farewells.takeDue(now + 200ms);
    ASSERT_EQ(due.size(), 1U);
    EXPECT_TRUE(due[0].second.end().stop());
    EXPECT_EQ(farewells.takeDue(now + 499ms).size(), 1U);
    EXPECT_TRUE(farewells.takeDue(now + 500ms + 200ms).empty()) << "who has not heard it misses the beats";
    EXPECT_EQ(farewells.nextDeadline(), TimePoint::max());
}

TEST_F(TheFarewells, WhoCannotBeReachedIsTakenLeaveOfNoMore) {
    farewells.sent("b", end(false), 50ms, now);
    farewells.sent("c", end(false), 60ms, now);
    farewells.unreachable("b");
    EXPECT_EQ(farewells.nextDeadline(), now + 60ms);
}

TEST_F(TheFarewells, AboveTheBoundNothingIsRepeated) {
    for (std::size_t i = 0; i <= Farewells::kMax; ++i)
        farewells.sent(std::to_string(i), end(false), 50ms, now);
    EXPECT_EQ(farewells.takeDue(now + 50ms).size(), Farewells::kMax);
}

}  // namespace
}  // namespace axon::entity_manager
