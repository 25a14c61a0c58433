// SPDX-License-Identifier: GPL-2.0-or-later
// When the robot is latched, and what the next life finds of it. What a latch forbids is claimed in
// stops_test.cpp, and every order in which the power may be lost in power_loss_test.cpp.
#include "entity_manager/core/stops/latch.hpp"

#include <gtest/gtest.h>

#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

struct Latches : testing::Test {
    Latches() { Latch::beginFirstLife(storage); }
    /// Of a life that begins now.
    bool comesUpLatched() { return Latch(storage, false).isSet(); }
    test::MemoryStorage storage;
    Header head;
    Sender holder{"holder", "Ada", Role::Operator};
};

TEST_F(Latches, AStopOrALossLatchesAndAnOrderlyGoodByeDoesNot) {
    head.sender.id = "holder";
    Incident stop{Event::Stop, &head};
    stop.cause = StopCause::Requested;
    EXPECT_TRUE(mustLatch(stop, &holder));
    EXPECT_TRUE(mustLatch(stop, nullptr));
    stop.cause = StopCause::Released;
    EXPECT_FALSE(mustLatch(stop, &holder)) << "the server's stop for a client that leaves";
    head.sender.id = "another";
    EXPECT_TRUE(mustLatch(stop, &holder)) << "it is not its own robot";
    Incident lost{Event::LinkDown};
    lost.cause = StopCause::LinkLost;
    EXPECT_TRUE(mustLatch(lost, &holder));
}

TEST_F(Latches, AFirstLifeIsNotLatchedAndOneWithoutItsStateIs) {
    EXPECT_FALSE(comesUpLatched());
    EXPECT_TRUE(Latch(storage, true).isSet()) << "parts of the state are lost";
    storage.values.clear();
    EXPECT_TRUE(comesUpLatched()) << "what is in doubt is latched";
}

TEST_F(Latches, ALatchOutlivesTheProcessUntilSomebodyRearms) {
    Latch latch(storage, false);
    latch.set();
    latch.keep(false);
    EXPECT_TRUE(comesUpLatched());
    latch.release();
    EXPECT_TRUE(comesUpLatched()) << "the disk does not have it yet";
    latch.keep(false);
    EXPECT_FALSE(comesUpLatched());
}

TEST_F(Latches, ALifeThatWasBrokenOffUnderAHolderIsFollowedByALatchedOne) {
    Latch latch(storage, false);
    latch.granted();
    latch.keep(true);
    EXPECT_FALSE(latch.isSet());
    EXPECT_TRUE(comesUpLatched());
    latch.keep(false);
    EXPECT_FALSE(comesUpLatched()) << "it was free at the end";
}

TEST_F(Latches, ThatNobodyHoldsTheRobotIsKeptAfterTheLatch) {
    Latch latch(storage, false);
    latch.granted();
    latch.set();
    storage.writes.clear();
    latch.keep(false);
    ASSERT_EQ(storage.writes.size(), 2U);
    EXPECT_FALSE(storage.writes[0].value) << "the latch is a deletion";
    EXPECT_TRUE(storage.writes[1].value);
}

}  // namespace
}  // namespace axon::entity_manager
