// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/connection/send_queue.hpp"

#include <gtest/gtest.h>

namespace axon::client::test {
namespace {

TEST(SendQueueTest, AThreadSendsNoFurtherThanItsOwn) {
    SendQueue<int> queue;
    queue.put(1, 10);
    queue.put(2, 10);
    const auto mine = queue.last();
    queue.put(3, 10);  // somebody else, who does not stop putting
    EXPECT_EQ(queue.take(mine)->message, 1);
    EXPECT_EQ(queue.take(mine)->message, 2);
    EXPECT_FALSE(queue.take(mine));
    EXPECT_EQ(queue.take(queue.last())->message, 3);
    EXPECT_FALSE(queue.take(queue.last()));
}

TEST(SendQueueTest, BytesWaitUntilTheyAreSentOrForgotten) {
    SendQueue<int> queue;
    queue.put(1, 100);
    queue.put(2, 50);
    const auto taken = queue.take(queue.last());
    ASSERT_TRUE(taken);
    EXPECT_EQ(queue.waiting().bytes, 150U);
    queue.clear();
    EXPECT_EQ(queue.waiting().bytes, 100U) << "what is being sent still counts";
    queue.sent(taken->bytes);
    EXPECT_EQ(queue.waiting().bytes, 0U);
    EXPECT_EQ(queue.waiting().messages, 0U);
    queue.put(3, 1);
    EXPECT_EQ(queue.take(queue.last())->message, 3) << "numbers go on after it was cleared";
}

TEST(AdmissionTest, SeventeenMebibytesAreTooManyAndASingleOneIsNot) {
    constexpr std::size_t kMebibyte = 1024 * 1024;
    std::size_t bytes = 0;
    std::size_t admitted = 0;
    for (std::size_t i = 0; i < 17; ++i) {
        if (!admission(admitted, bytes, kMebibyte).ok()) continue;
        ++admitted;
        bytes += kMebibyte + kMessageOverhead;
    }
    EXPECT_EQ(admitted, 15U);
    EXPECT_EQ(admission(admitted, bytes, kMebibyte).code, RefusalCode::Overloaded);
    EXPECT_TRUE(admission(admitted, bytes, 1000).ok()) << "a small one still has room";
    EXPECT_EQ(admission(kWaitingMax, 0, 1).code, RefusalCode::Overloaded);
}

}  // namespace
}  // namespace axon::client::test
