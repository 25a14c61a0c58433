// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/entities/missed_news.hpp"

#include <gtest/gtest.h>

namespace axon::front_end_server {
namespace {

using namespace std::chrono_literals;

TEST(MissedNews, AServerIsAskedWhenItHasPublishedMoreThanHasCome) {
    MissedNews news;
    ManualClock clock;
    EXPECT_TRUE(news.announced("es1", 7, clock.now())) << "it was there first";
    news.answered("es1");
    news.heard("es1");
    EXPECT_FALSE(news.announced("es1", 8, clock.now()));
    EXPECT_TRUE(news.announced("es1", 9, clock.now()));
}

TEST(MissedNews, AServerIsAskedAgainUntilItHasAnswered) {
    MissedNews news;
    ManualClock clock;
    EXPECT_TRUE(news.announced("es1", 7, clock.now()));
    clock.advance(899ms);
    EXPECT_FALSE(news.announced("es1", 7, clock.now()));
    clock.advance(1ms);
    EXPECT_TRUE(news.announced("es1", 7, clock.now()));
    news.answered("es1");
    clock.advance(1h);
    EXPECT_FALSE(news.announced("es1", 7, clock.now()));
}

TEST(MissedNews, WhoWasAskedForAnotherReasonIsAwaitedToo) {
    MissedNews news;
    ManualClock clock;
    news.asked("es1", clock.now());
    news.announced("es1", 0, clock.now());
    news.answered("es1");
    news.askedAll(clock.now());
    clock.advance(900ms);
    EXPECT_TRUE(news.announced("es1", 0, clock.now()));
}

TEST(MissedNews, NobodyFillsIt) {
    MissedNews news;
    for (std::size_t i = 0; i < Neighbours::kMost; ++i)
        EXPECT_TRUE(news.announced("es" + std::to_string(i), 0, {}));
    EXPECT_FALSE(news.announced("one more", 0, {}));
}

}  // namespace
}  // namespace axon::front_end_server
