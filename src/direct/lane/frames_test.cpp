// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/frames.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "common/frame.hpp"

namespace axon::direct::lane {
namespace {

Header header() {
    Header head;
    head.sender = {"somebody", "else", Role::Operator};
    head.entity = "not sent";
    head.msg_type = kMsgTask;
    head.held = {3, -7};
    head.stop_generation = -1;
    head.sequence = (std::int64_t{1} << 53U) - 1;
    head.sent_at_us = 123'456'789'012;
    return head;
}

/// The frame without its length, which is checked.
std::string framed(Keeping keeping, const Header& head, const std::string& content) {
    const auto bytes = headOf(keeping, head, content.size());
    EXPECT_TRUE(bytes);
    FrameReader reader(kMessageFrameMax);
    reader.feed(std::string(bytes->view()) + content + std::string("\0\0\0\1x", 5));
    std::string frame, next;
    EXPECT_TRUE(reader.next(frame));
    EXPECT_TRUE(reader.next(next) && next == "x") << "the length is right";
    return frame;
}

TEST(LaneFrames, AMessageIsReadAsItWasWritten) {
    for (const auto keeping : {Keeping::Kept, Keeping::Droppable}) {
        const auto frame = framed(keeping, header(), "content");
        const auto message = messageIn(frame);
        ASSERT_TRUE(message);
        EXPECT_EQ(message->keeping, keeping);
        EXPECT_EQ(message->content, "content");
        Header head;
        head.sender.id = "the connection's";
        head.entity = "the connection's too";
        message->into(head);
        EXPECT_EQ(head.sender.id, "the connection's");
        EXPECT_EQ(head.entity, "the connection's too");
        EXPECT_EQ(head.msg_type, header().msg_type);
        EXPECT_EQ(head.held, header().held);
        EXPECT_EQ(head.stop_generation, header().stop_generation);
        EXPECT_EQ(head.sequence, header().sequence);
        EXPECT_EQ(head.sent_at_us, header().sent_at_us);
    }
}

TEST(LaneFrames, NeitherContentNorTypeNeedBeThere) {
    Header head;
    const auto frame = framed(Keeping::Kept, head, "");
    EXPECT_EQ(frame.size(), kFixedHead);
    const auto message = messageIn(frame);
    ASSERT_TRUE(message);
    EXPECT_TRUE(message->msg_type.empty() && message->content.empty());
}

TEST(LaneFrames, WhatIsTooLargeIsNotWritten) {
    auto head = header();
    EXPECT_TRUE(headOf(Keeping::Kept, head, kMessageMax));
    EXPECT_FALSE(headOf(Keeping::Kept, head, kMessageMax + 1));
    head.msg_type = std::string(kTypeMax, 't');
    EXPECT_TRUE(headOf(Keeping::Kept, head, 1));
    head.msg_type += 't';
    EXPECT_FALSE(headOf(Keeping::Kept, head, 1));
}

TEST(LaneFrames, EveryTruncationOfAHeadIsImproper) {
    const auto frame = framed(Keeping::Kept, header(), "");
    for (std::size_t size = 0; size < frame.size(); ++size)
        EXPECT_FALSE(messageIn(std::string_view(frame).substr(0, size))) << size;
}

TEST(LaneFrames, OtherKindsAreNoMessages) {
    auto frame = framed(Keeping::Kept, header(), "content");
    for (int kind = 0; kind < 256; ++kind) {
        frame[0] = static_cast<char>(kind);
        EXPECT_EQ(messageIn(frame).has_value(), kind == 5 || kind == 6) << kind;
    }
}

TEST(LaneFrames, NumbersThatNoSenderHasAreImproper) {
    for (const std::size_t at : {13U, 21U}) {
        auto frame = framed(Keeping::Kept, header(), "content");
        frame[at] = '\x80';
        EXPECT_FALSE(messageIn(frame)) << "negative";
        frame[at] = '\0';
        frame[at + 1] = '\x20';
        EXPECT_FALSE(messageIn(frame)) << "2^53";
    }
    auto head = header();
    head.sequence = std::numeric_limits<std::int64_t>::min();
    EXPECT_EQ(messageIn(framed(Keeping::Kept, head, "")).value().sequence, 0) << "as on a lane of Ice";
}

TEST(LaneFrames, ATypeThatReachesBeyondTheFrameIsImproper) {
    auto frame = framed(Keeping::Kept, header(), "");
    frame[kFixedHead - 1] = static_cast<char>(std::string_view(kMsgTask).size() + 1);
    EXPECT_FALSE(messageIn(frame));
}

TEST(LaneFrames, FieldsThatAreNotThereReadAsNothingFromThenOn) {
    Fields fields("abc");
    EXPECT_EQ(fields.number(2), 0x6162U);
    EXPECT_EQ(fields.number(2), 0U);
    EXPECT_TRUE(fields.take(1).empty()) << "although one is left";
    EXPECT_FALSE(fields.good() || fields.done());
}

}  // namespace
}  // namespace axon::direct::lane
