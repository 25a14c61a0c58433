// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/callback_queue.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <future>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

namespace axon::client {
namespace {

using ::testing::ElementsAre;
using ::testing::Pair;

/// A program that does not return from its first callback until it is told to.
class CallbackQueueTest : public ::testing::Test {
  protected:
    CallbackQueueTest() {
        std::promise<void> entered;
        auto inside = entered.get_future();
        queue.post(
            [this, &entered] {
                entered.set_value();
                back_.get_future().wait();
            },
            false);
        queue.wake();
        inside.wait();
    }
    bool post(int number, bool may_be_left_out) {
        return queue.post([this, number] { called.push_back(number); }, may_be_left_out);
    }
    /// It returns; everything that waits is called.
    void comeBack() {
        std::promise<void> last;
        auto done = last.get_future();
        ASSERT_TRUE(queue.post([&last] { last.set_value(); }, false));
        back_.set_value();
        done.wait();
    }

    std::vector<int> called;  // on its thread, until comeBack() has returned
    std::atomic<std::size_t> returned{0};
    std::promise<void> back_;
    CallbackQueue queue;  // last: its thread uses the others
};

TEST_F(CallbackQueueTest, WhenItIsFullTheOldestThatMayBeLeftOutIs) {
    EXPECT_TRUE(post(1, true));
    EXPECT_TRUE(post(2, true));
    for (std::size_t i = 2; i < CallbackQueue::kBound; ++i) EXPECT_TRUE(queue.post([] {}, false));
    EXPECT_TRUE(post(3, false));
    EXPECT_TRUE(post(4, true));
    EXPECT_EQ(queue.leftOut(), 2U);
    comeBack();  // itself one that must not be left out, so 4 is
    EXPECT_EQ(queue.leftOut(), 3U);
    EXPECT_THAT(called, ElementsAre(3));
}

TEST_F(CallbackQueueTest, WhatAClientHearsOfAtOnceWhenItJoinsFits) {
    for (int i = 0; i < 65536; ++i) ASSERT_TRUE(post(i, false));
    EXPECT_TRUE(post(-1, true));
    EXPECT_EQ(queue.leftOut(), 1U) << "a change may be left out, which this is no room for";
    comeBack();
    EXPECT_EQ(called.size(), 65536U);
}

TEST_F(CallbackQueueTest, BeyondThatTheProgramDoesNotReturn) {
    for (std::size_t i = 0; i < CallbackQueue::kMost; ++i)
        ASSERT_TRUE(queue.post([this] { ++returned; }, false));
    EXPECT_FALSE(post(1, false));
    EXPECT_TRUE(post(2, true));
    queue.wake();
    back_.set_value();
    while (returned < CallbackQueue::kMost) std::this_thread::yield();  // without any further news
    EXPECT_THAT(called, ElementsAre());
}

TEST_F(CallbackQueueTest, WhatACallbackThrowsEndsNothing) {
    queue.post([] { throw std::runtime_error("of the program's own"); }, false);
    post(1, false);
    comeBack();
    EXPECT_THAT(called, ElementsAre(1));
}

TEST(CallbacksWhereTheNewsCame, RunOnTheCallingThreadInTheirOrder) {
    std::vector<std::pair<int, std::thread::id>> called;
    CallbackQueue queue;  // last: its thread uses the others
    const auto note = [&](int number) { called.emplace_back(number, std::this_thread::get_id()); };
    queue.post([&] { note(1); }, false);
    queue.post(
        [&] {
            note(2);
            EXPECT_TRUE(queue.isThisThread());
            queue.post([&] { note(4); }, false);
            queue.wake();
        },
        true);
    queue.post([&] { note(3); }, false);
    EXPECT_FALSE(queue.isThisThread());
    queue.runHere();
    EXPECT_FALSE(queue.isThisThread());
    const auto here = std::this_thread::get_id();
    EXPECT_THAT(called, ElementsAre(Pair(1, here), Pair(2, here), Pair(3, here), Pair(4, here)));
}

TEST_F(CallbackQueueTest, WhileOneRunsAnotherThreadRunsNone) {
    post(1, false);
    queue.runHere();
    EXPECT_THAT(called, ElementsAre()) << "two callbacks at once, or the second before the first had ended";
    EXPECT_FALSE(queue.isThisThread());
    post(2, false);
    queue.wake();
    comeBack();
    EXPECT_THAT(called, ElementsAre(1, 2));
}

TEST(CallbacksWhereTheNewsCame, WhatIsTooMuchForTheCallerRunsOnTheOtherThread) {
    std::vector<std::thread::id> called;
    std::promise<void> last;
    CallbackQueue queue;
    for (std::size_t i = 0; i < CallbackQueue::kRunHere + 1; ++i)
        queue.post([&] { called.push_back(std::this_thread::get_id()); }, false);
    queue.post([&] { last.set_value(); }, false);
    queue.runHere();
    last.get_future().wait();
    ASSERT_EQ(called.size(), CallbackQueue::kRunHere + 1);
    const auto here = std::this_thread::get_id();
    EXPECT_EQ(std::count(called.begin(), called.end(), here),
              static_cast<std::ptrdiff_t>(CallbackQueue::kRunHere));
    EXPECT_NE(called.back(), here);
}

TEST(CallbacksWhereTheNewsCame, MoreThanTheCallerRunsIsACrowd) {
    CallbackQueue queue;
    for (std::size_t i = 0; i < CallbackQueue::kRunHere; ++i) queue.post([] {}, false);
    EXPECT_FALSE(queue.crowded());
    queue.post([] {}, false);
    EXPECT_TRUE(queue.crowded());
    queue.runHere();
}

TEST(CallbacksWhereTheNewsCame, ClosingWaitsForTheOneThatRuns) {
    std::promise<void> entered, back;
    std::atomic<bool> ended{false}, called_later{false};
    CallbackQueue queue;
    queue.post(
        [&] {
            entered.set_value();
            back.get_future().wait();
            ended = true;
        },
        false);
    std::thread reader([&] { queue.runHere(); });
    entered.get_future().wait();
    std::thread closer([&] {
        queue.close();
        EXPECT_TRUE(ended) << "closed while a callback ran";
    });
    back.set_value();
    closer.join();
    reader.join();
    queue.post([&] { called_later = true; }, false);
    queue.runHere();
    EXPECT_EQ(called_later, false) << "called after close()";
}

/// News from several threads, of which some run callbacks themselves: never two at once, each thread's own in
/// their order, and all of them.
TEST(CallbacksWhereTheNewsCame, OfManyThreadsOneAtATimeAndAllInOrder) {
    constexpr int kThreads = 4, kEach = 2000;
    std::atomic<int> inside{0}, called{0};
    std::array<int, kThreads> last{};
    std::promise<void> all;
    CallbackQueue queue;
    std::vector<std::thread> threads;
    for (int thread = 0; thread < kThreads; ++thread)
        threads.emplace_back([&, thread] {
            for (int number = 1; number <= kEach; ++number) {
                queue.post(
                    [&, thread, number] {
                        EXPECT_EQ(++inside, 1);
                        EXPECT_EQ(std::exchange(last[static_cast<std::size_t>(thread)], number), number - 1);
                        --inside;
                        if (++called == kThreads * kEach) all.set_value();
                    },
                    false);
                if (thread % 2 == 0)
                    queue.runHere();
                else
                    queue.wake();
            }
        });
    for (auto& thread : threads) thread.join();
    all.get_future().wait();
    EXPECT_EQ(called, kThreads * kEach);
}

}  // namespace
}  // namespace axon::client
