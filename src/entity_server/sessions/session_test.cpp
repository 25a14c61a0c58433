// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/session.hpp"

#include <gtest/gtest.h>

#include <set>

#include "entity_server/sessions/due_sessions.hpp"

namespace axon::entity_server {
namespace {

using namespace std::chrono_literals;

class SessionTest : public testing::Test {
  protected:
    SessionRef open(std::uint64_t number = 1) {
        auto session = std::make_shared<Session>(number, "token", nullptr, 100);
        Record record;
        record.registration.heartbeat_busy_ms = 160;
        record.registration.heartbeat_idle_ms = 1600;
        session->record = std::make_shared<const Record>(std::move(record));
        session->liveness.setTimeouts(1s, 10s, clock.now());
        return session;
    }

    ManualClock clock;
};

TEST_F(SessionTest, HeartbeatsComeOnceInAPeriodAndAtItsSixteenTimes) {
    const auto session = open();
    session->restartHeartbeats(clock.now());
    int beats = 0;
    for (const auto end = clock.now() + 16s; clock.now() < end; clock.advance(1ms)) {
        const auto due = session->nextHeartbeat();
        if (const auto number = session->dueHeartbeat(clock.now())) {
            EXPECT_EQ(*number, ++beats);
            EXPECT_EQ(due.time_since_epoch() % 100ms, Duration{});
        }
    }
    EXPECT_EQ(beats, 10);
    EXPECT_FALSE(session->dueHeartbeat(clock.now() - 1h)) << "time that goes back asks for none";
}

TEST_F(SessionTest, ThoseThatJoinedTogetherAreServedInTurns) {
    std::set<TimePoint> times;
    for (std::uint64_t number = 1; number <= 32; ++number) {
        const auto session = open(number);
        session->restartHeartbeats(clock.now());
        EXPECT_LE(session->nextHeartbeat(), clock.now() + session->period());
        times.insert(session->nextHeartbeat());
    }
    EXPECT_EQ(times.size(), 16U);
}

TEST_F(SessionTest, ATaskShortensThePeriodAndAPauseCausesNoBurst) {
    const auto session = open();
    session->liveness.setBusy(true, clock.now());
    session->restartHeartbeats(clock.now());
    EXPECT_EQ(session->period(), 160ms);
    EXPECT_EQ(session->extraHeartbeat(), 1);
    clock.advance(1h);
    EXPECT_EQ(session->dueHeartbeat(clock.now()), 2);
    EXPECT_FALSE(session->dueHeartbeat(clock.now()));
    EXPECT_GT(session->nextHeartbeat(), clock.now());
}

TEST_F(SessionTest, PeopleAreWarnedOnceAMinuteOfOneThatIsNearlyLost) {
    const auto session = open();
    clock.advance(5s);
    EXPECT_FALSE(session->warning(clock.now())) << "half of what is allowed";
    clock.advance(1s);
    EXPECT_TRUE(session->warning(clock.now()));
    clock.advance(59s);
    EXPECT_FALSE(session->warning(clock.now()));
    clock.advance(1s);
    EXPECT_TRUE(session->warning(clock.now()));
}

TEST_F(SessionTest, TheTimeThatWasGivenLastCountsAndOneThatIsGoneHasNone) {
    DueSessions due;
    EXPECT_FALSE(due.next());
    EXPECT_EQ(due.take(clock.now()), nullptr);
    const auto late = open(1);
    const auto early = open(2);
    const auto gone = open(3);
    due.schedule(late, clock.now() + 2s);
    due.schedule(late, clock.now() + 9s);
    due.schedule(early, clock.now() + 5s);
    due.schedule(gone, clock.now() + 3s);
    due.schedule(open(4), clock.now() + 1s);  // ended at once
    gone->gone = true;
    EXPECT_LE(*due.next(), clock.now() + 5s);
    EXPECT_EQ(due.take(clock.now()), nullptr);
    clock.advance(10s);
    EXPECT_EQ(due.take(clock.now()), early);
    EXPECT_EQ(due.take(clock.now()), late);
    EXPECT_EQ(due.take(clock.now()), nullptr) << "it has none until it is scheduled again";
    EXPECT_FALSE(due.next());
}

}  // namespace
}  // namespace axon::entity_server
