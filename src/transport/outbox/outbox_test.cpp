// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/outbox/outbox.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace axon::transport {
namespace {

/// An outbox in front of a way that is told by hand what became of each message.
class OutboxTest : public testing::Test {
  protected:
    void begin(Until until, std::size_t window_bytes = 100) {
        OutboxLimits limits;
        limits.window_bytes = window_bytes;
        limits.control_bytes = 1000;
        limits.control_messages = 2;
        outbox = std::make_shared<Outbox>(
            limits,
            [this](bool improper, const std::string& why) { ends.push_back((improper ? "! " : "") + why); },
            until);
    }
    void post(Traffic traffic) {
        const auto send = [this](SendCallbacks&& back) { ways.push_back(std::move(back)); };
        outbox->post(traffic, 100, send, [send] { return Outbox::Parcel(send); });
    }

    std::shared_ptr<Outbox> outbox;
    std::vector<SendCallbacks> ways;
    std::vector<std::string> ends;
};

TEST_F(OutboxTest, OnASocketAMessageHasLeftWhenItIsWritten) {
    begin(Until::Written);
    post(Traffic::Control);
    post(Traffic::Control);
    ASSERT_EQ(ways.size(), 1U);
    EXPECT_FALSE(ways[0].answered);
    ways[0].sent(true);
    EXPECT_EQ(ways.size(), 2U);
    ways[1].failed(nullptr);
    EXPECT_TRUE(ends.empty()) << "the connection that closes says so";
}

TEST_F(OutboxTest, WhatMayNotWaitLeavesNothingBehindWhereItWouldHaveTo) {
    begin(Until::Written);
    const auto send = [this](SendCallbacks&& back) { ways.push_back(std::move(back)); };
    EXPECT_TRUE(outbox->postAtOnce(Traffic::Control, 60, send));
    post(Traffic::Signal);  // of another thread: it passes everything, and fills the window
    EXPECT_FALSE(outbox->postAtOnce(Traffic::Control, 60, send));
    ASSERT_EQ(ways.size(), 2U);
    ways[0].sent(true);
    ways[1].sent(true);
    EXPECT_EQ(ways.size(), 2U) << "nothing had been queued";
    EXPECT_FALSE(outbox->closed());
    EXPECT_TRUE(outbox->postAtOnce(Traffic::Data, 60, send));
    outbox->close();
    EXPECT_FALSE(outbox->postAtOnce(Traffic::Data, 60, send));
}

TEST_F(OutboxTest, BehindARouterControlAndDataHaveLeftWhenTheyAreAnsweredAndSignalsWhenWritten) {
    begin(Until::Answered);
    for (const auto traffic : {Traffic::Control, Traffic::Data, Traffic::Signal}) post(traffic);
    ASSERT_EQ(ways.size(), 2U) << "the data waits, the signal does not";
    EXPECT_TRUE(ways[0].answered);
    EXPECT_FALSE(ways[0].sent);
    EXPECT_TRUE(ways[1].sent);
    EXPECT_FALSE(ways[1].answered);
    ways[1].sent(true);
    EXPECT_EQ(ways.size(), 2U);
    ways[0].answered();
    ASSERT_EQ(ways.size(), 3U);
    EXPECT_TRUE(ways[2].answered);
}

TEST_F(OutboxTest, BehindARouterAnAnswerHoldsForTheMessagesBeforeIt) {
    begin(Until::Answered, 1000);
    for (int i = 0; i < 4; ++i) post(Traffic::Control);
    ASSERT_EQ(ways.size(), 4U);
    EXPECT_TRUE(ways[0].answered);
    EXPECT_FALSE(ways[1].answered || ways[2].answered);
    EXPECT_TRUE(ways[3].answered) << "after a quarter of the window";
    EXPECT_EQ(outbox->counts().unsent_bytes, 400U);
    ways[0].answered();
    EXPECT_EQ(outbox->counts().unsent_bytes, 300U);
    ways[3].answered();
    EXPECT_EQ(outbox->counts().unsent_bytes, 0U);
    EXPECT_EQ(outbox->counts().sent, 4U);
}

TEST_F(OutboxTest, BehindARouterTheWindowOpensWithOneAnswer) {
    begin(Until::Answered, 1000);
    for (int i = 0; i < 12; ++i) post(Traffic::Control);
    ASSERT_EQ(ways.size(), 10U) << "two wait";
    std::size_t last = 0;
    for (std::size_t i = 0; i < ways.size(); ++i)
        if (ways[i].answered) last = i;
    ways[last].answered();
    EXPECT_EQ(ways.size(), 12U);
}

TEST_F(OutboxTest, BehindARouterAMessageThatDoesNotArriveEndsTheSessionOnce) {
    begin(Until::Answered);
    post(Traffic::Control);
    post(Traffic::Signal);
    ways[0].failed(nullptr);
    ways[1].failed(nullptr);
    EXPECT_EQ(ends, std::vector<std::string>{"what it is sent does not arrive"});
    post(Traffic::Control);
    EXPECT_EQ(ways.size(), 2U) << "closed";
}

TEST_F(OutboxTest, BehindARouterTheEndOfTheSessionSaysWhyAMessageDoesNotArrive) {
    begin(Until::Answered);
    post(Traffic::Control);
    ways[0].failed(std::make_exception_ptr(std::runtime_error("a reason")));
    ASSERT_EQ(ends.size(), 1U);
    EXPECT_NE(ends[0].find("what it is sent does not arrive: "), std::string::npos);
    EXPECT_NE(ends[0].find("a reason"), std::string::npos);
}

TEST_F(OutboxTest, BeforeAnOrderlyEndAllThatWaitsIsSentInItsOrder) {
    begin(Until::Written);
    for (int i = 0; i < 3; ++i) post(Traffic::Control);
    ASSERT_EQ(ways.size(), 1U);
    outbox->sendAll();
    EXPECT_EQ(ways.size(), 3U);
    post(Traffic::Control);
    EXPECT_EQ(ways.size(), 4U) << "the last word";
    EXPECT_TRUE(ends.empty());
}

TEST_F(OutboxTest, BehindARouterTheLastWordIsAnswered) {
    begin(Until::Answered, 1000);
    post(Traffic::Control);
    outbox->sendAll();
    post(Traffic::Control);
    ASSERT_EQ(ways.size(), 2U);
    EXPECT_TRUE(ways[1].answered);
}

TEST_F(OutboxTest, WhoReadsNothingIsDisconnectedForIt) {
    begin(Until::Answered);
    for (int i = 0; i < 4; ++i) post(Traffic::Control);
    EXPECT_EQ(ends, std::vector<std::string>{"! it does not read its messages"});
}

}  // namespace
}  // namespace axon::transport
