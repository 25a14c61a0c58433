// SPDX-License-Identifier: GPL-2.0-or-later
#include "common/liveness.hpp"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

namespace axon {
namespace {

using namespace std::chrono_literals;

// The deadline.

TEST(Liveness, ExpiresExactlyAtItsTimeout) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now());
    peer.setBusy(true, clock.now());
    clock.advance(249ms);
    EXPECT_FALSE(peer.expired(clock.now()));
    clock.advance(1ms);
    EXPECT_TRUE(peer.expired(clock.now()));
    peer.heard(clock.now());
    EXPECT_FALSE(peer.expired(clock.now()));
}

TEST(Liveness, BecomingBusyStartsTheShortTimeoutAgain) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now());
    clock.advance(5s);
    peer.setBusy(true, clock.now());
    EXPECT_FALSE(peer.expired(clock.now()));
    clock.advance(100ms);
    peer.setBusy(true, clock.now());  // saying it again is no sign of life
    clock.advance(150ms);
    EXPECT_TRUE(peer.expired(clock.now()));
}

TEST(Liveness, AShortPauseIsNoSignOfLife) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now());
    peer.setBusy(true, clock.now());
    for (int task = 0; task < 3; ++task) {
        clock.advance(80ms);
        peer.setBusy(false, clock.now());
        clock.advance(100ms);  // does not count: the peer was not expected to beat fast
        peer.setBusy(true, clock.now());
    }
    clock.advance(9ms);
    EXPECT_FALSE(peer.expired(clock.now()));
    clock.advance(1ms);
    EXPECT_TRUE(peer.expired(clock.now()));
}

TEST(Liveness, AfterAPauseOfTheShortTimeoutItStartsAgain) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now());
    peer.setBusy(true, clock.now());
    clock.advance(200ms);
    peer.setBusy(false, clock.now());
    clock.advance(250ms);
    peer.setBusy(true, clock.now());
    clock.advance(249ms);
    EXPECT_FALSE(peer.expired(clock.now()));
}

TEST(Liveness, WhatIsHeardInAShortPauseCounts) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now());
    peer.setBusy(true, clock.now());
    clock.advance(200ms);
    peer.setBusy(false, clock.now());
    clock.advance(10ms);
    peer.heard(clock.now());
    clock.advance(10ms);
    peer.setBusy(true, clock.now());
    clock.advance(239ms);
    EXPECT_FALSE(peer.expired(clock.now()));
    clock.advance(11ms);
    EXPECT_TRUE(peer.expired(clock.now()));
}

TEST(Liveness, AShortPauseIsASignOfLifeWhereTheOwnerSaysSo) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now(), Liveness::ShortPause::Sign);
    EXPECT_EQ(peer.deadline(), clock.now() + 10s);
    clock.advance(9s);
    peer.setBusy(true, clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 250ms);
    clock.advance(200ms);
    peer.setBusy(true, clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 50ms);
    peer.setBusy(false, clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 9800ms);
    clock.advance(1ms);
    peer.setBusy(true, clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 250ms);
    EXPECT_EQ(peer.last(), clock.now() - 9201ms) << "nothing was heard";
}

TEST(Liveness, MarginFallsFromOneToZero) {
    ManualClock clock;
    Liveness peer(200ms, 10s, clock.now());
    peer.setBusy(true, clock.now());
    EXPECT_DOUBLE_EQ(peer.margin(clock.now()), 1.0);
    clock.advance(150ms);
    EXPECT_DOUBLE_EQ(peer.margin(clock.now()), 0.25);
    clock.advance(1s);
    EXPECT_DOUBLE_EQ(peer.margin(clock.now()), 0.0);
}

TEST(Liveness, APeerIsLateFromTheSamePartOfTheTimeoutOnForWhichOneIsWarned) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now());
    EXPECT_EQ(peer.lateFrom(), clock.now() + 6s);
    peer.setBusy(true, clock.now());
    EXPECT_EQ(peer.lateFrom(), clock.now() + 150ms);
    EXPECT_DOUBLE_EQ(peer.margin(peer.lateFrom()), 1 - Liveness::kWarnFrom);
}

TEST(Liveness, AnOlderSignOfLifeReplacesNoNewerOne) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now());
    const auto before = clock.now();
    clock.advance(1s);
    peer.heard(clock.now());
    peer.heard(before);
    EXPECT_EQ(peer.last(), clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 10s);
    clock.advance(300ms);
    peer.setBusy(true, clock.now());
    peer.heard(clock.now() - 1ms);  // it was on its way when the task began
    EXPECT_EQ(peer.deadline(), clock.now() + 250ms);
}

TEST(Liveness, OtherTimeoutsStartAgainAndAPauseGoesOn) {
    ManualClock clock;
    Liveness peer(250ms, 10s, clock.now());
    clock.advance(9s);
    peer.setTimeouts(100ms, 500ms, clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 500ms);
    EXPECT_EQ(peer.last(), clock.now() - 9s) << "nothing was heard";
    peer.setBusy(true, clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 100ms);
    peer.setTimeouts(200ms, 500ms, clock.now());
    EXPECT_EQ(peer.timeout(), 200ms) << "it is still busy";
}

TEST(Liveness, NoSignOfLifeIsLostWhereSeveralThreadsHear) {
    constexpr int kThreads = 4;
    constexpr int kSigns = 10000;
    const TimePoint begin = ManualClock().now();
    Liveness peer(250ms, 10s, begin);
    std::vector<std::thread> threads;
    for (int thread = 0; thread < kThreads; ++thread) {
        threads.emplace_back([&, thread] {
            for (int sign = 1; sign <= kSigns; ++sign) {
                const auto at = begin + (sign * kThreads + thread) * 1us;
                peer.heard(at);
                EXPECT_GE(peer.last(), at);
                EXPECT_GE(peer.deadline(), at + 250ms);
            }
        });
    }
    for (int task = 0; task < kSigns; ++task) peer.setBusy(task % 2 == 0, begin + task * 1us);
    for (auto& thread : threads) thread.join();
    EXPECT_EQ(peer.last(), begin + (kSigns * kThreads + kThreads - 1) * 1us);
}

// The gaps.

class LivenessGaps : public testing::Test {
  protected:
    LivenessGaps() { peer.setBusy(true, clock.now()); }
    void beats(Duration period, int how_many) {
        for (int i = 0; i < how_many; ++i) {
            clock.advance(period);
            peer.heard(clock.now());
        }
    }
    ManualClock clock;
    Liveness peer{250ms, 10s, clock.now()};
};

TEST_F(LivenessGaps, TheLongestOfTheLastMinuteIsRememberedAndThenForgotten) {
    beats(50ms, 10);
    beats(180ms, 1);
    beats(50ms, 1000);  // 50 s
    EXPECT_EQ(peer.longest(clock.now()).length, 180ms);
    EXPECT_EQ(peer.longest(clock.now()).allowed, 250ms);
    EXPECT_GE(peer.longest(clock.now()).part(), Liveness::kWarnFrom);
    EXPECT_EQ(describe(peer.longest(clock.now())),
              "180 ms of 250 ms allowed was its longest silence in the last minute");
    beats(50ms, 500);
    EXPECT_EQ(peer.longest(clock.now()).length, 50ms);
}

TEST_F(LivenessGaps, TheSilenceThatLastsCounts) {
    beats(50ms, 1);
    clock.advance(200ms);
    EXPECT_EQ(peer.longest(clock.now()).length, 200ms);
    EXPECT_EQ(peer.last(), clock.now() - 200ms);
}

TEST_F(LivenessGaps, EachIsMeasuredAgainstWhatWasAllowedThen) {
    peer.setBusy(false, clock.now());
    beats(2s, 3);
    EXPECT_DOUBLE_EQ(peer.longest(clock.now()).part(), 0.2);
    // A task begins in the middle of a long silence that was allowed.
    clock.advance(1900ms);
    peer.setBusy(true, clock.now());
    beats(50ms, 2);
    EXPECT_DOUBLE_EQ(peer.longest(clock.now()).part(), 0.2);
    EXPECT_EQ(peer.longest(clock.now()).allowed, 10s);
}

TEST_F(LivenessGaps, TheLargestPartOfWhatWasAllowedIsTheLongest) {
    beats(100ms, 1);
    peer.setBusy(false, clock.now());
    beats(3s, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 100ms) << "0.4 is more than 0.3";
    beats(5s, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 5s);
}

TEST_F(LivenessGaps, OneGoesOnWhereTheAllowanceStays) {
    clock.advance(100ms);
    peer.setTimeouts(250ms, 250ms, clock.now());
    peer.setBusy(false, clock.now());
    beats(50ms, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 150ms);
    clock.advance(100ms);
    peer.setTimeouts(1s, 1s, clock.now());
    beats(50ms, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 150ms) << "another one began";
}

TEST_F(LivenessGaps, WhatOnlyRenewsTheDeadlineEndsNone) {
    clock.advance(100ms);
    peer.renew(clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 250ms);
    EXPECT_EQ(peer.last(), clock.now() - 100ms);
    beats(100ms, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 200ms);
}

TEST_F(LivenessGaps, NoneIsMeasuredWhileTheyAreSuspendedAndTheDeadlineGoesOn) {
    beats(50ms, 1);
    peer.suspendGaps();
    clock.advance(200ms);
    peer.setBusy(false, clock.now());
    peer.setBusy(true, clock.now());  // changes nothing of that
    EXPECT_EQ(peer.longest(clock.now()).length, 50ms);
    EXPECT_EQ(peer.deadline(), clock.now() + 50ms);
    peer.heard(clock.now());
    EXPECT_EQ(peer.deadline(), clock.now() + 250ms);
    clock.advance(100ms);
    peer.resumeGaps(clock.now());
    beats(60ms, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 60ms);
    clock.advance(10ms);
    peer.resumeGaps(clock.now());  // they are not suspended
    beats(70ms, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 80ms);
}

TEST_F(LivenessGaps, NoneReachesFromOneConnectionIntoTheNext) {
    clock.advance(200ms);
    peer.restart(clock.now());
    EXPECT_EQ(peer.longest(clock.now()).part(), 0);
    EXPECT_EQ(peer.deadline(), clock.now() + 250ms);
    EXPECT_EQ(peer.last(), clock.now());
    beats(50ms, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 50ms);
}

TEST_F(LivenessGaps, AreMeasuredFromTheMomentOfANewConnectionOn) {
    peer.suspendGaps();
    peer.restart(clock.now());
    beats(50ms, 1);
    EXPECT_EQ(peer.longest(clock.now()).length, 50ms);
}

TEST(Liveness, WithoutTimeoutsNothingIsAGap) {
    ManualClock clock;
    Liveness peer;
    clock.advance(1s);
    peer.heard(clock.now());
    clock.advance(1h);
    EXPECT_EQ(peer.longest(clock.now()).part(), 0);
    peer.setTimeouts(250ms, 10s, clock.now());
    clock.advance(1s);
    EXPECT_EQ(peer.longest(clock.now()).length, 1s) << "from when on there were some";
}

}  // namespace
}  // namespace axon
