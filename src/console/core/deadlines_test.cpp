// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/deadlines.hpp"

#include <gtest/gtest.h>

namespace axon::console {
namespace {

using namespace std::chrono_literals;
using All = std::vector<int>;

TEST(Deadlines, ARequestThatIsNotCompleteIsLateHoweverManyBytesCome) {
    ManualClock clock;
    Deadlines deadlines(clock);
    deadlines.opened(7);
    clock.advance(14s);
    EXPECT_EQ(deadlines.late(), All{});
    clock.advance(1s);
    EXPECT_EQ(deadlines.late(), All{7});
    EXPECT_EQ(deadlines.late(), All{}) << "said once";
}

TEST(Deadlines, AnAnswerHasTwoMinutes) {
    ManualClock clock;
    Deadlines deadlines(clock);
    deadlines.opened(7);
    clock.advance(14s);
    deadlines.asked(7);
    clock.advance(119s);
    EXPECT_EQ(deadlines.late(), All{});
    clock.advance(1s);
    EXPECT_EQ(deadlines.late(), All{7});
}

TEST(Deadlines, TheNextRequestHasItsOwnTime) {
    ManualClock clock;
    Deadlines deadlines(clock);
    deadlines.opened(7);
    deadlines.asked(7);
    clock.advance(60s);
    deadlines.answered(7);
    clock.advance(14s);
    EXPECT_EQ(deadlines.late(), All{});
    EXPECT_EQ(deadlines.next(), clock.now() + 1s);
    clock.advance(1s);
    EXPECT_EQ(deadlines.late(), All{7});
}

TEST(Deadlines, AConnectionThatHasEndedIsNeverLate) {
    ManualClock clock;
    Deadlines deadlines(clock);
    deadlines.opened(7);
    deadlines.closed(7);
    clock.advance(1h);
    EXPECT_EQ(deadlines.late(), All{});
    EXPECT_EQ(deadlines.next(), TimePoint::max());
}

}  // namespace
}  // namespace axon::console
