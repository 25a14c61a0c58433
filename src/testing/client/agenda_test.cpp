// SPDX-License-Identifier: GPL-2.0-or-later
#include "testing/client/agenda.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <string>
#include <thread>

#include "support/loopback.hpp"

namespace axon::testing {
namespace {

using namespace std::chrono_literals;

TEST(Agenda, WhatIsPlannedHappensInTheOrderOfItsTimesAndThenOfThePlanning) {
    Agenda agenda(Passing::InAdvance, [] {});
    std::string happened;
    agenda.in(2s, [&] { happened += 'c'; });
    agenda.in(1s, [&] { happened += 'a'; });
    agenda.in(1s, [&] { happened += 'b'; });
    agenda.in(3s, [&] { happened += 'd'; });
    EXPECT_EQ(happened, "");
    agenda.advance(2s);
    EXPECT_EQ(happened, "abc");
    EXPECT_EQ(agenda.now(), 2s);
}

TEST(Agenda, AnEventIsAtItsOwnTimeAndMayPlanAnotherOne) {
    Agenda agenda(Passing::InAdvance, [] {});
    std::vector<Duration> times;
    std::function<void()> again = [&] {
        times.push_back(agenda.now());
        if (times.size() < 4) agenda.in(500ms, again);
    };
    agenda.in(500ms, again);
    agenda.advance(10s);
    EXPECT_EQ(times, (std::vector<Duration>{500ms, 1s, 1500ms, 2s}));
    EXPECT_EQ(agenda.now(), 10s);
}

TEST(Agenda, WhatSettlingPlansForTheSameTimeHappensBeforeTimePasses) {
    Agenda* self = nullptr;
    std::vector<Duration> times;
    int settled = 0;
    Agenda agenda(Passing::InAdvance, [&] {
        if (++settled == 2) self->in(0s, [&] { times.push_back(self->now()); });
    });
    self = &agenda;
    agenda.in(1s, [] {});
    agenda.advance(5s);
    EXPECT_EQ(times, std::vector<Duration>{1s});
}

TEST(Agenda, WhatIsCancelledDoesNotHappen) {
    Agenda agenda(Passing::InAdvance, [] {});
    int happened = 0;
    const auto number = agenda.in(1s, [&] { ++happened; });
    EXPECT_NE(number, 0U);
    agenda.cancel(number);
    agenda.cancel(number);
    agenda.cancel(0);
    agenda.advance(2s);
    EXPECT_EQ(happened, 0);
}

TEST(Agenda, NegativeTimeIsNoTime) {
    Agenda agenda(Passing::InAdvance, [] {});
    int happened = 0;
    agenda.in(-1s, [&] { ++happened; });
    agenda.advance(-1s);
    EXPECT_EQ(happened, 1);
    EXPECT_EQ(agenda.now(), 0s);
}

TEST(Agenda, TimeThatPassesAtOnceTakesNoneOfTheRealOne) {
    Agenda agenda(Passing::AtOnce, [] {});
    std::atomic<int> happened{0};
    agenda.in(24h, [&] { agenda.in(24h, [&] { ++happened; }); });
    EXPECT_TRUE(test::waitUntil([&] { return happened == 1; }));
    EXPECT_EQ(agenda.now(), 48h);
}

TEST(Agenda, WhileItIsHeldNothingBegins) {
    for (int round = 0; round < 200; ++round) {
        Agenda agenda(Passing::AtOnce, [] {});
        std::atomic<int> turn{0};
        int said = 0, happened = 0;
        {
            const Agenda::Hold hold(agenda);
            agenda.in(1h, [&] { happened = ++turn; });
            std::this_thread::yield();
            said = ++turn;
        }
        ASSERT_TRUE(test::waitUntil([&] { return turn == 2; }));
        agenda.end();
        ASSERT_LT(said, happened);
    }
}

TEST(Agenda, AfterItsEndNothingHappens) {
    Agenda agenda(Passing::InAdvance, [] {});
    int happened = 0;
    agenda.in(1s, [&] { ++happened; });
    agenda.end();
    agenda.in(1s, [&] { ++happened; });
    agenda.advance(5s);
    EXPECT_EQ(happened, 0);
}

}  // namespace
}  // namespace axon::testing
