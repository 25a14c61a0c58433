// SPDX-License-Identifier: MIT
#include "common/other_servers.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon {
namespace {

using namespace std::chrono_literals;
using testing::Contains;
using testing::ElementsAre;
using testing::IsEmpty;

/// Writes down what a core would do.
class OtherServersTest : public testing::Test {
  protected:
    OtherServers::Kind kind(const std::string& name, bool waits = false) {
        const auto all = [this](const char* what, const auto& names) {
            std::string line = what;
            for (const auto& one : names) line += " " + one;
            lines.push_back(line);
        };
        OtherServers::Kind kind{name, {}};
        kind.reach = [this](const auto& reached) {
            lines.push_back("reach " + std::to_string(reached.size()));
        };
        kind.lost = [all](const auto& names) { all("lost", names); };
        kind.left = [all](const auto& names) { all("left", names); };
        kind.arrived = [this](const auto& server) { lines.push_back("arrived " + server); };
        kind.waits_for_announcement = waits;
        return kind;
    }
    void hear(OtherServers::Group& group, Lane lane, const std::string& name) {
        group.heard(lane, {name, "one", "signals of " + name, 0}, clock.now());
    }
    std::vector<std::string> turn(Duration later = {}) {
        clock.advance(later);
        next = servers.onTimer(clock.now());
        return std::exchange(lines, {});
    }

    ManualClock clock;
    SeededRandom random{1};
    std::vector<std::string> lines;
    TimePoint next;
    OtherServers servers{
        "me", random, [this](const std::string& line) { lines.push_back(line); },
        [this](Lane lane) { lines.emplace_back(lane == Lane::Signal ? "beat" : "announce"); }};
    OtherServers::Group& clients = servers.add(kind("front-end server"));
    OtherServers::Group& fellows = servers.add(kind("entity server", true));
};

TEST_F(OtherServersTest, LivesStraightEvery50MsAndByTheTopicEverySecond) {
    EXPECT_THAT(turn(), ElementsAre("beat", "announce"));
    EXPECT_EQ(next, clock.now() + 50ms);
    EXPECT_THAT(turn(49ms), IsEmpty());
    EXPECT_THAT(turn(1ms), ElementsAre("beat"));
    EXPECT_THAT(turn(950ms), ElementsAre("beat", "announce"));
}

TEST_F(OtherServersTest, WhoeverIsNewIsReachedAndHearsOfItAtOnce) {
    turn();
    hear(clients, Lane::Data, "fe1");
    EXPECT_THAT(turn(1ms), ElementsAre("reach 1", "beat", "front-end server fe1 is there", "arrived fe1"));
    hear(fellows, Lane::Data, "es2");
    EXPECT_THAT(turn(1ms),
                ElementsAre("reach 1", "beat", "announce", "entity server es2 is there", "arrived es2"));
}

TEST_F(OtherServersTest, WhatChangedIsAnnouncedWithTheNextBeat) {
    turn();
    servers.announceSoon();
    EXPECT_THAT(turn(1ms), IsEmpty());
    EXPECT_THAT(turn(49ms), ElementsAre("beat", "announce"));
    EXPECT_THAT(turn(50ms), ElementsAre("beat"));
}

TEST_F(OtherServersTest, ALossComesBeforeEverythingElseAndWhatMayTakeAWhileAfterIt) {
    hear(clients, Lane::Signal, "fe1");
    turn();
    EXPECT_THAT(turn(2s), ElementsAre("lost fe1", "beat", "announce", "left fe1"));
    EXPECT_TRUE(clients.lost("fe1"));
}

TEST_F(OtherServersTest, AServerIsWatchedCloselyWhileATaskHangsOnIt) {
    hear(clients, Lane::Signal, "fe1");
    hear(clients, Lane::Signal, "fe2");
    turn();
    clients.moveTask("", "fe1", clock.now());
    clients.moveTask("", "fe1", clock.now());
    clients.moveTask("fe1", "fe2", clock.now());
    clients.moveTask("fe2", "", clock.now());
    EXPECT_THAT(turn(250ms), Contains("lost fe1")) << "one of its two tasks still runs, and fe2 has none";
}

TEST_F(OtherServersTest, TheOnlyServerSaysNothing) {
    OtherServers alone("", random, {}, {});
    EXPECT_EQ(alone.onTimer(clock.now()), TimePoint::max());
}

}  // namespace
}  // namespace axon
