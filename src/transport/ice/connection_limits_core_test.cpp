// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/connection_limits_core.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

namespace axon::transport {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using namespace std::chrono_literals;
using Seen = ConnectionLimitsCore::Seen;
using Peer = ConnectionLimitsCore::Peer;

constexpr ConnectionBounds kBounds{
    .strangers_of_one_address = 3, .strangers = 5, .to_log_in = 10s, .silence = 60s};

class Limits : public testing::Test {
  protected:
    struct Looked : ConnectionLimitsCore::Verdict {
        std::vector<std::uint64_t> close;
    };
    Looked look() {
        Looked its;
        static_cast<ConnectionLimitsCore::Verdict&>(its) =
            core.look(connections, clock.now(), [&](std::uint64_t id) {
                if (spared.contains(id)) return false;
                its.close.push_back(id);
                return true;
            });
        return its;
    }
    void come(std::uint64_t id, const std::string& address = "10.0.0.1") {
        connections.push_back({id, address, Peer::Stranger, {}});
    }

    ManualClock clock;
    ConnectionLimitsCore core{kBounds};
    std::vector<Seen> connections;
    std::set<std::uint64_t> spared;
};

TEST_F(Limits, WhoHasNoSessionInTimeIsClosedOnceAndNamed) {
    come(1);
    EXPECT_TRUE(look().strangers);
    clock.advance(10s);
    EXPECT_THAT(look().close, IsEmpty());
    clock.advance(1ms);
    const auto verdict = look();
    EXPECT_THAT(verdict.close, ElementsAre(1));
    EXPECT_THAT(verdict.notes, ElementsAre("1 connection from 10.0.0.1 was closed: no session in 10 s"));
    EXPECT_FALSE(verdict.strangers);
    EXPECT_THAT(look().close, IsEmpty()) << "it is there until Ice has seen its end";
    EXPECT_THAT(look().notes, IsEmpty());
}

TEST_F(Limits, ASessionStaysHoweverOldItIs) {
    come(1);
    look();
    connections[0].peer = Peer::HasSession;
    clock.advance(1h);
    EXPECT_THAT(look().close, IsEmpty());
    EXPECT_FALSE(look().strangers);
}

TEST_F(Limits, OfTooManyFromOneAddressTheOldestGoAndOthersAreNotHurt) {
    come(1, "10.0.0.2");
    look();
    for (std::uint64_t id = 10; id < 15; ++id) come(id);
    const auto verdict = look();
    EXPECT_THAT(verdict.close, ElementsAre(10, 11));
    EXPECT_THAT(
        verdict.notes,
        ElementsAre(HasSubstr(
            "2 connections from 10.0.0.1 were closed: more than 3 of one address without a session")));
    EXPECT_TRUE(verdict.strangers);
}

TEST_F(Limits, SessionsDoNotCountAsStrangersOfTheirAddress) {
    for (std::uint64_t id = 1; id < 20; ++id) {
        come(id);
        connections.back().peer = Peer::HasSession;
    }
    for (std::uint64_t id = 20; id < 23; ++id) come(id);
    EXPECT_THAT(look().close, IsEmpty());
}

TEST_F(Limits, OfTooManyInAllTheOldestOfTheAddressThatHasMostGoes) {
    for (std::uint64_t id = 1; id < 3; ++id) come(id, "10.0.0.1");
    come(3, "10.0.0.2");
    for (std::uint64_t id = 4; id < 7; ++id) come(id, "10.0.0.3");
    const auto verdict = look();
    EXPECT_THAT(verdict.close, ElementsAre(4));
    EXPECT_THAT(verdict.notes, ElementsAre(HasSubstr("of all addresses")));
}

TEST_F(Limits, OfAddressesWithOneConnectionEachTheOldestGoesAndNotWhoeverIsFirstInTheAlphabet) {
    for (std::uint64_t id = 1; id <= 5; ++id) come(id, "10.0.0." + std::to_string(10 + id));
    look();
    come(6, "10.0.0.1");
    EXPECT_THAT(look().close, ElementsAre(1));
}

TEST_F(Limits, ThisMachineIsOneAddressWhicheverItComesFrom) {
    for (std::uint64_t id = 1; id <= 4; ++id) come(id, "127.0.0." + std::to_string(id));
    EXPECT_THAT(look().close, ElementsAre(1));
}

TEST_F(Limits, WhoLogsInIsNoStrangerHoweverLongThatTakes) {
    come(1);
    look();
    connections[0].peer = Peer::Exempt;
    for (std::uint64_t id = 10; id < 15; ++id) come(id);
    EXPECT_THAT(look().close, ElementsAre(10, 11));
    clock.advance(9s);
    connections.resize(1);
    look();
    clock.advance(2s);
    EXPECT_THAT(look().close, IsEmpty());
    connections[0].peer = Peer::Stranger;  // refused
    EXPECT_THAT(look().close, ElementsAre(1));
}

TEST_F(Limits, AFloodIsToldAtOnceAndThenEveryTenSecondsWithFewNames) {
    std::uint64_t id = 0;
    std::size_t told = 0;
    for (int i = 0; i < 100; ++i) {
        for (int j = 0; j < 20; ++j) come(++id, "10.0." + std::to_string(j) + ".1");
        told += look().notes.size();
        clock.advance(100ms);
    }
    EXPECT_GT(told, 0U);
    EXPECT_LE(told, 20U);
    clock.advance(1s);
    const auto verdict = look();
    EXPECT_THAT(verdict.notes, Contains(HasSubstr("other addresses")));
}

TEST_F(Limits, TheBoundsLeaveMostOfFewDescriptorsToSessions) {
    const auto few = ConnectionBounds{}.fittingInto(400);
    EXPECT_EQ(few.strangers, 100U);
    EXPECT_EQ(few.strangers_of_one_address, 50U);
    const auto many = ConnectionBounds{}.fittingInto(1'000'000);
    EXPECT_EQ(many.strangers, ConnectionBounds{}.strangers);
    EXPECT_EQ(many.strangers_of_one_address, ConnectionBounds{}.strangers_of_one_address);
}

TEST_F(Limits, ASilentSessionIsClosed) {
    connections = {{1, "10.0.0.1", Peer::HasSession, 60s}, {2, "10.0.0.1", Peer::HasSession, 61s}};
    const auto verdict = look();
    EXPECT_THAT(verdict.silent, ElementsAre(2));
    EXPECT_THAT(verdict.close, IsEmpty()) << "its servant ends it";
    EXPECT_THAT(verdict.notes,
                ElementsAre(HasSubstr("nothing has come over a session's connection for 60 s")));
}

TEST_F(Limits, WhoLogsInAsItIsToBeClosedIsSparedAndWatchedAsBefore) {
    come(1);
    look();
    clock.advance(11s);
    spared = {1};  // it asks to log in at this moment
    const auto verdict = look();
    EXPECT_THAT(verdict.close, IsEmpty());
    EXPECT_THAT(verdict.notes, IsEmpty()) << "nothing was closed";
    spared.clear();
    connections = {{1, "10.0.0.1", Peer::HasSession, 61s}};
    EXPECT_THAT(look().silent, ElementsAre(1));
    connections = {{1, "10.0.0.1", Peer::Stranger, 61s}};
    EXPECT_THAT(look().close, IsEmpty()) << "it is being ended";
}

TEST_F(Limits, WhoIsRefusedAfterItWasSparedIsClosed) {
    come(1);
    look();
    clock.advance(11s);
    spared = {1};
    look();
    spared.clear();
    const auto verdict = look();
    EXPECT_THAT(verdict.close, ElementsAre(1));
    EXPECT_THAT(verdict.notes, ElementsAre("1 connection from 10.0.0.1 was closed: no session in 10 s"));
}

TEST_F(Limits, WhatIsGoneIsForgotten) {
    come(1);
    look();
    connections.clear();
    clock.advance(11s);
    EXPECT_FALSE(look().strangers);
    come(1);  // a number that is used again would be a new connection
    EXPECT_THAT(look().close, IsEmpty());
}

}  // namespace
}  // namespace axon::transport
