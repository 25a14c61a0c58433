// SPDX-License-Identifier: GPL-2.0-or-later
// Texts and raw data between the holder and the robot application, without the rest of the Entity Manager.
#include "entity_manager/core/streams/holder_channel.hpp"

#include <gtest/gtest.h>

#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

struct HolderChannels : testing::Test {
    HolderChannels() { head.sender = {"client", "Ada", Role::Operator}; }
    void hold() { turn.lease.emplace().holder = head.sender; }
    void passText(const std::string& text) {
        proto::ToEntity message;
        message.mutable_text()->set_text(text);
        channel.passText({Event::Text, &head, &message});
    }
    void passRaw(const std::string& block) {
        proto::ToEntity message;
        message.mutable_raw()->add_data(block);
        channel.passRaw({Event::Raw, &head, &message});
    }
    void textCame(const std::string& text) {
        proto::LinkText message;
        message.set_text(text);
        channel.textCame(message);
    }
    void rawCame(const std::string& block) {
        proto::LinkRaw message;
        message.add_data(block);
        channel.rawCame(message);
    }

    Header head;
    test::FakeTurn turn;
    HolderChannel channel{turn};
};

TEST_F(HolderChannels, ATextReachesTheApplicationWithTheNameOfItsSender) {
    passText("hello");
    ASSERT_EQ(turn.to_application.size(), 1U);
    EXPECT_EQ(turn.to_application[0].text().text(), "hello");
    EXPECT_EQ(turn.to_application[0].text().from(), "Ada");
}

TEST_F(HolderChannels, RawDataHasTheStopGenerationOfItsMomentAndNothingOfTheLast) {
    turn.stopped.generation = 4;
    passRaw("first");
    turn.stopped.generation = 5;
    head.sender.name = "Bob";
    passRaw("second");
    ASSERT_EQ(turn.to_application.size(), 2U);
    const auto& raw = turn.to_application[1].raw();
    ASSERT_EQ(raw.data_size(), 1);
    EXPECT_EQ(raw.data(0), "second");
    EXPECT_EQ(raw.from(), "Bob");
    EXPECT_EQ(turn.to_application[0].raw().stop_generation(), 4U);
    EXPECT_EQ(raw.stop_generation(), 5U);
}

TEST_F(HolderChannels, WhatTheLinkDoesNotTakeIsRefusedAsTooLarge) {
    turn.link_takes = false;
    passText("a long text");
    passRaw("a large block");
    EXPECT_TRUE(turn.to_application.empty());
    ASSERT_EQ(turn.refused.size(), 2U);
    for (const auto& refusal : turn.refused) EXPECT_EQ(refusal.code, RefusalCode::TooLarge);
}

TEST_F(HolderChannels, AfterRawDataThatWasTooLargeTheNextIsPassedAlone) {
    turn.link_takes = false;
    passRaw("a large block");
    turn.link_takes = true;
    passRaw("small");
    ASSERT_EQ(turn.to_application.size(), 1U);
    ASSERT_EQ(turn.to_application[0].raw().data_size(), 1);
    EXPECT_EQ(turn.to_application[0].raw().data(0), "small");
}

TEST_F(HolderChannels, RefusedRawDataIsAnsweredFiveTimesASecondAtMostAndAlwaysCounted) {
    const Refusal refusal{RefusalCode::NotHolder, "", {}};
    turn.clock.advance(1s);
    for (int i = 0; i < 3; ++i) channel.refuseRaw(head.sender, refusal);
    EXPECT_EQ(turn.replies.size(), 1U);
    EXPECT_EQ(turn.counted.raw_refused, 3U);
    turn.clock.advance(200ms);
    channel.refuseRaw(head.sender, refusal);
    EXPECT_EQ(turn.replies.size(), 2U);
}

TEST_F(HolderChannels, WhatTheApplicationSaysGoesToTheHolder) {
    hold();
    textCame("arrived");
    rawCame("image");
    ASSERT_EQ(turn.told.size(), 2U);
    EXPECT_EQ(turn.told[0].to.id, "client");
    EXPECT_EQ(turn.told[0].type, kMsgText);
    EXPECT_EQ(turn.told[0].message.text().text(), "arrived");
    EXPECT_EQ(turn.told[1].type, kMsgRaw);
    ASSERT_EQ(turn.told[1].message.raw().data_size(), 1);
    EXPECT_EQ(turn.told[1].message.raw().data(0), "image");
    EXPECT_EQ(turn.counted.undelivered, 0U);
}

TEST_F(HolderChannels, WithoutAHolderWhatTheApplicationSaysIsCountedAsUndelivered) {
    textCame("arrived");
    rawCame("image");
    EXPECT_TRUE(turn.told.empty());
    EXPECT_EQ(turn.counted.undelivered, 2U);
}

TEST_F(HolderChannels, WithoutASessionRawDataOfTheApplicationIsCountedAsUndelivered) {
    hold();
    turn.session = false;
    rawCame("image");
    EXPECT_TRUE(turn.told.empty());
    EXPECT_EQ(turn.counted.undelivered, 1U);
}

}  // namespace
}  // namespace axon::entity_manager
