// SPDX-License-Identifier: MIT
#include "common/neighbours.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::IsEmpty;

class NeighboursTest : public testing::Test {
  protected:
    bool topic(const std::string& instance = "one", const std::string& name = "fe1") {
        return neighbours.heard(Lane::Data, {name, instance, "signals of " + instance, 0}, clock.now());
    }
    bool straight(const std::string& instance = "one", const std::string& name = "fe1") {
        return neighbours.heard(Lane::Signal, {name, instance, "signals of " + instance, 0}, clock.now());
    }
    Neighbours::News news() { return neighbours.news(clock.now()); }
    /// Heard directly every 50 ms for so long.
    void live(Duration time) {
        for (const auto end = clock.now() + time; clock.now() < end; clock.advance(50ms)) straight();
    }

    ManualClock clock;
    Neighbours neighbours;
};

TEST_F(NeighboursTest, OneThatIsHeardArrivesAndIsReached) {
    EXPECT_TRUE(topic());
    const auto first = news();
    EXPECT_THAT(first.arrived, ElementsAre("fe1"));
    ASSERT_TRUE(first.reachable);
    ASSERT_EQ(first.reachable->size(), 1U);
    EXPECT_EQ(first.reachable->front().signals, "signals of one");
    EXPECT_FALSE(topic());
    const auto second = news();
    EXPECT_THAT(second.arrived, IsEmpty());
    EXPECT_FALSE(second.reachable);
}

TEST_F(NeighboursTest, SilenceOnTheDirectWayIsALossWithinTheWatchdogThoughTheTopicGoesOn) {
    topic();
    straight();
    neighbours.setBusy("fe1", true, clock.now());
    news();
    live(1s);
    EXPECT_THAT(news().lost, IsEmpty());
    clock.advance(199ms);  // the last sign of life was 50 ms ago
    topic();
    EXPECT_THAT(news().lost, IsEmpty());
    clock.advance(1ms);
    EXPECT_THAT(news().lost, ElementsAre("fe1"));
    EXPECT_FALSE(neighbours.serves("fe1:one:uuid"));
    EXPECT_TRUE(neighbours.lost("fe1"));
    EXPECT_THAT(news().lost, IsEmpty()) << "once";
    topic();
    EXPECT_THAT(news().arrived, IsEmpty()) << "signals do not get through";
    straight();
    EXPECT_THAT(news().arrived, ElementsAre("fe1"));
    EXPECT_TRUE(neighbours.serves("fe1:one:uuid"));
}

TEST_F(NeighboursTest, OneWhosePortRefusesIsLostWithTheNextHeartbeatThatIsMissing) {
    topic();
    EXPECT_FALSE(neighbours.refused("fe1", "signals of one")) << "only its announcements have come";
    straight();
    news();
    EXPECT_FALSE(neighbours.refused("fe1", "signals of another")) << "an address of before";
    EXPECT_FALSE(neighbours.refused("fe2", "signals of one")) << "nobody";
    clock.advance(25ms);
    EXPECT_TRUE(neighbours.refused("fe1", "signals of one"));
    EXPECT_FALSE(neighbours.refused("fe1", "signals of one")) << "nothing new";
    clock.advance(49ms);
    EXPECT_THAT(news().lost, IsEmpty());
    EXPECT_EQ(news().next, clock.now() + 1ms);
    clock.advance(1ms);
    EXPECT_THAT(news().lost, ElementsAre("fe1"));
    EXPECT_FALSE(neighbours.serves("fe1:one:uuid"));
    EXPECT_FALSE(neighbours.refused("fe1", "signals of one")) << "it is lost already";
    EXPECT_THAT(news().lost, IsEmpty());
    straight();
    EXPECT_THAT(news().arrived, ElementsAre("fe1")) << "it listens again";
    EXPECT_THAT(news().lost, IsEmpty());
}

TEST_F(NeighboursTest, OneThatCannotBeReachedAndSaysThatItLivesIsNotLost) {
    straight();
    neighbours.setBusy("fe1", true, clock.now());
    news();
    for (int i = 0; i < 20; ++i) {
        EXPECT_TRUE(neighbours.refused("fe1", "signals of one"));
        clock.advance(60ms);
        EXPECT_THAT(news().lost, IsEmpty());
        straight();
        EXPECT_THAT(news().arrived, IsEmpty());
    }
    clock.advance(249ms);
    EXPECT_THAT(news().lost, IsEmpty()) << "it has not refused since it was heard";
}

TEST_F(NeighboursTest, AnInstanceIsNotLostForThePortOfTheOneBeforeAtTheSameAddress) {
    const auto announce = [&](const char* instance) {
        return neighbours.heard(Lane::Signal, {"fe1", instance, "a fixed port", 0}, clock.now());
    };
    announce("one");
    news();
    EXPECT_TRUE(neighbours.refused("fe1", "a fixed port"));
    announce("two");
    const auto then = news();
    EXPECT_THAT(then.lost, ElementsAre("fe1")) << "the one before";
    EXPECT_THAT(then.arrived, ElementsAre("fe1"));
    EXPECT_TRUE(neighbours.refused("fe1", "a fixed port")) << "a late one";
    clock.advance(50ms);
    announce("two");
    clock.advance(100ms);
    EXPECT_THAT(news().lost, IsEmpty());
}

TEST_F(NeighboursTest, AnIdleOneHasLonger) {
    straight();
    clock.advance(1900ms);
    EXPECT_THAT(news().lost, IsEmpty());
    clock.advance(100ms);
    EXPECT_THAT(news().lost, ElementsAre("fe1"));
}

TEST_F(NeighboursTest, AnotherInstanceIsALossOfTheOneBeforeAndNeverTheOtherWayRound) {
    straight("one");
    news();
    EXPECT_TRUE(topic("two"));
    const auto changed = news();
    EXPECT_THAT(changed.lost, ElementsAre("fe1"));
    EXPECT_THAT(changed.arrived, ElementsAre("fe1"));
    EXPECT_FALSE(neighbours.serves("fe1:one:uuid"));
    EXPECT_TRUE(neighbours.serves("fe1:two:uuid"));
    EXPECT_FALSE(topic("one")) << "late, out of a queue";
    EXPECT_THAT(news().lost, IsEmpty());
    EXPECT_TRUE(neighbours.serves("fe1:two:uuid"));
}

TEST_F(NeighboursTest, OneThatWasLostAndComesBackAsAnotherInstanceIsNotLostTwice) {
    straight("one");
    news();
    clock.advance(2s);
    EXPECT_THAT(news().lost, ElementsAre("fe1"));
    topic("two");
    const auto back = news();
    EXPECT_THAT(back.lost, IsEmpty()) << "what came by the new one is there";
    EXPECT_THAT(back.arrived, ElementsAre("fe1"));
}

TEST_F(NeighboursTest, AClientOfAnInstanceThatNobodyHasHeardOfYetIsServed) {
    straight("one");
    news();
    clock.advance(5s);
    news();
    EXPECT_FALSE(neighbours.serves("fe1:one:uuid"));
    EXPECT_TRUE(neighbours.serves("fe1:two:uuid"));
    EXPECT_TRUE(neighbours.serves("fe9:one:uuid"));
    EXPECT_TRUE(neighbours.serves("uuid")) << "of the only front-end server";
    EXPECT_TRUE(neighbours.serves(""));
}

TEST_F(NeighboursTest, OneThatATaskHangsOnIsMissedThoughItWasNeverHeard) {
    neighbours.setBusy("fe1", true, clock.now());
    clock.advance(3s);
    EXPECT_THAT(news().lost, ElementsAre("fe1"));
    EXPECT_FALSE(neighbours.serves("fe1:one:uuid"));
}

TEST_F(NeighboursTest, OneThatIsAwaitedAndNeverHeardIsLost) {
    neighbours.await("fe1", clock.now());
    clock.advance(2999ms);
    neighbours.await("fe1", clock.now());
    EXPECT_THAT(news().lost, IsEmpty());
    clock.advance(1ms);
    EXPECT_THAT(news().lost, ElementsAre("fe1"));
}

TEST_F(NeighboursTest, WhoIsNotHeardIsNotReachedAndAtLastForgotten) {
    topic();
    news();
    clock.advance(3s);
    const auto gone = news();
    ASSERT_TRUE(gone.reachable);
    EXPECT_THAT(*gone.reachable, IsEmpty());
    clock.advance(60s);
    news();
    EXPECT_EQ(neighbours.size(), 0U);
}

TEST_F(NeighboursTest, TakesNoNonsenseAndNotAnyNumber) {
    EXPECT_FALSE(neighbours.heard(Lane::Data, {"", "one", "", 0}, clock.now()));
    EXPECT_FALSE(neighbours.heard(Lane::Data, {"fe:1", "one", "", 0}, clock.now()));
    EXPECT_FALSE(neighbours.heard(Lane::Data, {"fe1", "", "", 0}, clock.now()));
    EXPECT_FALSE(neighbours.heard(Lane::Data, {"fe1", std::string(1000, 'i'), "", 0}, clock.now()));
    EXPECT_FALSE(neighbours.heard(Lane::Data, {"fe1", "one", std::string(10'000, 's'), 0}, clock.now()));
    for (int i = 0; i < 1000; ++i) topic("one", "fe" + std::to_string(i));
    EXPECT_EQ(neighbours.size(), Neighbours::kMost);
}

TEST(ClientOrigin, IsTakenOffTheId) {
    EXPECT_EQ(originOf("fe1:ab:uuid").server, "fe1");
    EXPECT_EQ(originOf("fe1:ab:uuid").instance, "ab");
    EXPECT_EQ(uuidOf("fe1:ab:uuid"), "uuid");
    EXPECT_EQ(originOf("uuid").server, "");
    EXPECT_EQ(uuidOf("uuid"), "uuid");
    EXPECT_EQ(originOf("fe1:uuid").server, "");
    EXPECT_TRUE(isServerName("fe-1_a"));
    EXPECT_FALSE(isServerName(std::string(33, 'a')));
}

}  // namespace
}  // namespace axon
