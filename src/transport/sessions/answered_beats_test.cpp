// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/sessions/answered_beats.hpp"

#include <gtest/gtest.h>

namespace axon::transport {
namespace {

using namespace std::chrono_literals;

TEST(AnsweredBeats, AServerThatBeatsIsNotAsked) {
    ManualClock clock;
    AnsweredBeats beats(clock);
    for (int i = 0; i < 20; ++i) {
        beats.heard();
        clock.advance(50ms);
        EXPECT_FALSE(beats.ask());
        clock.advance(50ms);
        EXPECT_FALSE(beats.ask()) << "one that comes a little late";
    }
}

TEST(AnsweredBeats, AServerWithALongerWatchdogBeatsMoreSlowly) {
    ManualClock clock;
    AnsweredBeats beats(clock);
    beats.expect(100ms);
    beats.heard();
    clock.advance(200ms);
    EXPECT_FALSE(beats.ask());
    clock.advance(1ms);
    EXPECT_TRUE(beats.ask());
}

TEST(AnsweredBeats, AServerThatIsSilentIsAskedUntilItAnswersAndOnceAtATime) {
    ManualClock clock;
    AnsweredBeats beats(clock);
    EXPECT_TRUE(beats.ask()) << "nothing has been heard yet";
    beats.answered();
    beats.heard();
    clock.advance(101ms);
    EXPECT_TRUE(beats.ask());
    clock.advance(50ms);
    EXPECT_FALSE(beats.ask()) << "a second one would wait behind the first";
    beats.answered();
    EXPECT_TRUE(beats.ask()) << "an answer is no heartbeat: the server's own are what the robot needs";
}

}  // namespace
}  // namespace axon::transport
