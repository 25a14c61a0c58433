// SPDX-License-Identifier: MIT
#include "common/frame.hpp"

#include <axon/link.pb.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "common/message_frame.hpp"

namespace axon {
namespace {

using namespace std::string_literals;

std::vector<std::string> allFrames(FrameReader& reader) {
    std::vector<std::string> frames;
    for (std::string payload; reader.next(payload);) frames.push_back(payload);
    return frames;
}

TEST(Frame, LengthIsFourBytesBigEndian) {
    std::string out;
    ASSERT_TRUE(appendFrame(out, std::string(0x0102, 'x')));
    EXPECT_EQ(out.substr(0, 4), "\0\0\1\2"s);
    EXPECT_EQ(out.size(), 4 + 0x0102U);
}

TEST(Frame, EmptyAndOversizePayloadsAreNotWritten) {
    std::string out;
    EXPECT_FALSE(appendFrame(out, ""));
    EXPECT_FALSE(appendFrame(out, std::string(kFrameMax + 1, 'x')));
    EXPECT_TRUE(out.empty());
    EXPECT_TRUE(appendFrame(out, std::string(kFrameMax, 'x')));
}

TEST(Frame, AMessageIsFramedAsItsBytesAre) {
    proto::EmToEi message;
    std::string none;
    EXPECT_FALSE(appendFrameOf(none, message)) << "it has no bytes";
    message.mutable_text()->set_text(std::string(300, 'x'));
    std::string expected = "before", out = expected;
    ASSERT_TRUE(appendFrame(expected, message.SerializeAsString()));
    ASSERT_TRUE(appendFrameOf(out, message));
    EXPECT_EQ(out, expected);
    message.mutable_text()->set_text(std::string(kFrameMax, 'x'));
    EXPECT_FALSE(appendFrameOf(out, message)) << "with its head it is larger than a frame";
    EXPECT_EQ(out, expected) << "and nothing was written";
}

TEST(Frame, EverySplitGivesTheSameFrames) {
    std::string stream;
    const std::vector<std::string> sent{"a", "\0\0\0\1"s, std::string(300, 'q'), "end"};
    for (const auto& payload : sent) appendFrame(stream, payload);
    for (std::size_t cut = 0; cut <= stream.size(); ++cut) {
        FrameReader reader;
        reader.feed(std::string_view(stream).substr(0, cut));
        auto got = allFrames(reader);
        reader.feed(std::string_view(stream).substr(cut));
        for (auto& frame : allFrames(reader)) got.push_back(frame);
        ASSERT_EQ(got, sent) << "cut at " << cut;
    }
}

TEST(Frame, ATruncatedFrameIsNeverDelivered) {
    std::string stream;
    appendFrame(stream, "payload");
    FrameReader reader;
    reader.feed(std::string_view(stream).substr(0, stream.size() - 1));
    std::string payload;
    EXPECT_FALSE(reader.next(payload));
    EXPECT_FALSE(reader.failed());
}

TEST(Frame, ZeroLengthAndOversizeFailForGood) {
    for (const auto& head : {"\0\0\0\0"s, "\0\x10\0\1"s, "\xFF\xFF\xFF\xFF"s}) {
        FrameReader reader;
        std::string stream;
        appendFrame(stream, "good");
        stream += head + "rest";
        reader.feed(stream);
        EXPECT_EQ(allFrames(reader), std::vector<std::string>{"good"});
        EXPECT_TRUE(reader.failed());
        EXPECT_NE(reader.error().find("expected"), std::string::npos);
        reader.feed("\0\0\0\1x"s);
        EXPECT_TRUE(allFrames(reader).empty());
    }
}

TEST(Frame, ALowerLimitHoldsUntilItIsRaised) {
    std::string stream;
    appendFrame(stream, std::string(100, 'x'));
    FrameReader strict(99);
    strict.feed(stream);
    EXPECT_TRUE(allFrames(strict).empty());
    EXPECT_TRUE(strict.failed());
    FrameReader wide(99);
    wide.setLimit(100);
    wide.feed(stream);
    EXPECT_EQ(allFrames(wide).size(), 1U);
}

/// As a socket would: at most `piece` bytes into the room.
std::size_t put(FrameReader& reader, std::string_view stream, std::size_t piece) {
    const auto room = reader.room();
    const auto count = std::min({piece, stream.size(), room.size()});
    std::copy_n(stream.begin(), count, room.begin());
    reader.filled(count);
    return count;
}

TEST(Frame, WhatIsPutIntoTheRoomIsReadAsWhatIsFed) {
    std::string stream;
    std::vector<std::string> sent;
    for (std::size_t i = 1; i < 300; ++i) {
        sent.push_back(std::string(i * i % 7001 + 1, static_cast<char>('a' + i % 26)));
        appendFrame(stream, sent.back());
    }
    for (const std::size_t piece : {1U, 3U, 4096U, 70'000U, 10'000'000U}) {
        FrameReader reader;
        std::vector<std::string> got;
        for (std::size_t at = 0; at < stream.size();) {
            at += put(reader, std::string_view(stream).substr(at), piece);
            while (const auto frame = reader.nextView()) got.emplace_back(*frame);
        }
        ASSERT_EQ(got, sent) << "in pieces of " << piece;
    }
}

TEST(Frame, TheRoomTakesTheRestOfTheFrameThatHasBegun) {
    std::string stream;
    appendFrame(stream, std::string(kFrameMax, 'x'));
    FrameReader reader;
    EXPECT_EQ(put(reader, stream, 5), 5U);
    EXPECT_FALSE(reader.nextView());
    EXPECT_GE(reader.room().size(), stream.size() - 5);
    FrameReader strict(4096);
    put(strict, stream, 5);
    EXPECT_LT(strict.room().size(), 100'000U) << "a frame that is too long gets no memory";
    EXPECT_FALSE(strict.nextView());
    EXPECT_TRUE(strict.failed());
    EXPECT_FALSE(strict.room().empty());
}

TEST(Frame, ReadsThatFillTheRoomAreFollowedByLargerOnes) {
    FrameReader reader;
    const auto first = reader.room().size();
    std::string stream;
    while (stream.size() < 4 * FrameReader::kReadMax) appendFrame(stream, std::string(1000, 'x'));
    for (std::size_t at = 0; at < stream.size();) {
        at += put(reader, std::string_view(stream).substr(at), stream.size());
        while (reader.nextView()) {
        }
    }
    EXPECT_GT(reader.room().size(), first);
    EXPECT_LE(reader.room().size(), 3 * FrameReader::kReadMax);
}

}  // namespace
}  // namespace axon
