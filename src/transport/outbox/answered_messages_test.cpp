// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/outbox/answered_messages.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::transport {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

class AnsweredMessagesTest : public testing::Test {
  protected:
    std::uint64_t send(std::size_t bytes) { return messages.onSend({Traffic::Control, bytes, kServersOwn}); }
    /// The sizes of those that have reached their consumer.
    std::vector<std::size_t> answer(std::uint64_t number) {
        std::vector<std::size_t> bytes;
        for (const auto& message : messages.onAnswer(number)) bytes.push_back(message.bytes);
        return bytes;
    }

    AnsweredMessages messages{1000};
};

TEST_F(AnsweredMessagesTest, OneAfterAnotherIsAnsweredEach) {
    for (std::uint64_t number = 1; number <= 200; ++number) {
        ASSERT_EQ(send(number), number);
        ASSERT_THAT(answer(number), ElementsAre(number));
    }
}

TEST_F(AnsweredMessagesTest, AnAnswerHoldsForAllBeforeItAndForNoneAfterIt) {
    EXPECT_EQ(send(1), 1U);
    EXPECT_EQ(send(2), 0U);
    EXPECT_EQ(send(3), 0U);
    EXPECT_THAT(answer(1), ElementsAre(1));
    EXPECT_EQ(send(4), 4U) << "no answer is awaited any more";
    EXPECT_EQ(send(5), 0U);
    EXPECT_THAT(answer(4), ElementsAre(2, 3, 4));
}

TEST_F(AnsweredMessagesTest, OfABurstOneIsAnsweredForSoManyBytes) {
    EXPECT_EQ(send(999), 1U);
    EXPECT_EQ(send(999), 0U);
    EXPECT_EQ(send(1), 3U);
    EXPECT_EQ(send(5000), 4U);
    EXPECT_EQ(send(1), 0U);
}

TEST_F(AnsweredMessagesTest, OfABurstOneIsAnsweredForSoManyMessages) {
    EXPECT_EQ(send(1), 1U);
    for (int i = 0; i < 63; ++i) ASSERT_EQ(send(1), 0U);
    EXPECT_EQ(send(1), 65U);
}

TEST_F(AnsweredMessagesTest, BeforeAnOrderlyEndEachIsAnswered) {
    EXPECT_EQ(send(1), 1U);
    EXPECT_EQ(send(1), 0U);
    messages.askAlways();
    EXPECT_EQ(send(1), 3U);
    EXPECT_EQ(send(1), 4U);
}

TEST_F(AnsweredMessagesTest, AnAnswerThatComesAfterALaterOneChangesNothing) {
    send(999);
    send(1);
    EXPECT_EQ(send(1000), 3U);
    EXPECT_THAT(answer(3), ElementsAre(999, 1, 1000));
    EXPECT_THAT(answer(1), IsEmpty());
    EXPECT_EQ(send(7), 4U);
    EXPECT_THAT(answer(4), ElementsAre(7));
}

}  // namespace
}  // namespace axon::transport
