// SPDX-License-Identifier: GPL-2.0-or-later
#include "common/watchdog.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

using namespace std::chrono_literals;

TEST(Watchdog, ExpiresExactlyAtItsTimeout) {
    ManualClock clock;
    Watchdog dog(250ms, 10s, clock.now());
    dog.setBusy(true, clock.now());
    clock.advance(249ms);
    EXPECT_FALSE(dog.expired(clock.now()));
    clock.advance(1ms);
    EXPECT_TRUE(dog.expired(clock.now()));
    dog.feed(clock.now());
    EXPECT_FALSE(dog.expired(clock.now()));
}

TEST(Watchdog, BecomingBusyStartsTheShortTimeoutAnew) {
    ManualClock clock;
    Watchdog dog(250ms, 10s, clock.now());
    clock.advance(5s);
    dog.setBusy(true, clock.now());
    EXPECT_FALSE(dog.expired(clock.now()));
    clock.advance(100ms);
    dog.setBusy(true, clock.now());  // saying it again is no sign of life
    clock.advance(150ms);
    EXPECT_TRUE(dog.expired(clock.now()));
}

TEST(Watchdog, AShortPauseIsNoSignOfLife) {
    ManualClock clock;
    Watchdog dog(250ms, 10s, clock.now());
    dog.setBusy(true, clock.now());
    for (int task = 0; task < 3; ++task) {
        clock.advance(80ms);
        dog.setBusy(false, clock.now());
        clock.advance(100ms);  // does not count: the peer was not expected to beat fast
        dog.setBusy(true, clock.now());
    }
    clock.advance(9ms);
    EXPECT_FALSE(dog.expired(clock.now()));
    clock.advance(1ms);
    EXPECT_TRUE(dog.expired(clock.now()));
}

TEST(Watchdog, AfterAPauseOfTheShortTimeoutItStartsAnew) {
    ManualClock clock;
    Watchdog dog(250ms, 10s, clock.now());
    dog.setBusy(true, clock.now());
    clock.advance(200ms);
    dog.setBusy(false, clock.now());
    clock.advance(250ms);
    dog.setBusy(true, clock.now());
    clock.advance(249ms);
    EXPECT_FALSE(dog.expired(clock.now()));
}

TEST(Watchdog, WhatIsHeardInAShortPauseCounts) {
    ManualClock clock;
    Watchdog dog(250ms, 10s, clock.now());
    dog.setBusy(true, clock.now());
    clock.advance(200ms);
    dog.setBusy(false, clock.now());
    clock.advance(10ms);
    dog.feed(clock.now());
    clock.advance(10ms);
    dog.setBusy(true, clock.now());
    clock.advance(239ms);
    EXPECT_FALSE(dog.expired(clock.now()));
    clock.advance(11ms);
    EXPECT_TRUE(dog.expired(clock.now()));
}

TEST(Watchdog, MarginFallsFromOneToZero) {
    ManualClock clock;
    Watchdog dog(200ms, 10s, clock.now());
    dog.setBusy(true, clock.now());
    EXPECT_DOUBLE_EQ(dog.margin(clock.now()), 1.0);
    clock.advance(150ms);
    EXPECT_DOUBLE_EQ(dog.margin(clock.now()), 0.25);
    clock.advance(1s);
    EXPECT_DOUBLE_EQ(dog.margin(clock.now()), 0.0);
}

}  // namespace
}  // namespace axon
