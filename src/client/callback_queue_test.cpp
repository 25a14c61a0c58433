// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/callback_queue.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <future>
#include <stdexcept>
#include <vector>

namespace axon::client {
namespace {

using ::testing::ElementsAre;

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
    for (std::size_t i = 0; i < CallbackQueue::kMost; ++i) ASSERT_TRUE(queue.post([] {}, false));
    EXPECT_FALSE(post(1, false));
    EXPECT_TRUE(post(2, true));
    back_.set_value();
}

TEST_F(CallbackQueueTest, WhatACallbackThrowsEndsNothing) {
    queue.post([] { throw std::runtime_error("of the program's own"); }, false);
    post(1, false);
    comeBack();
    EXPECT_THAT(called, ElementsAre(1));
}

}  // namespace
}  // namespace axon::client
