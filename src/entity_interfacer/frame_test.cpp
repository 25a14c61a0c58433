// SPDX-License-Identifier: MIT
#include "entity_interfacer/frame.hpp"

#include <gtest/gtest.h>

#include <vector>

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

}  // namespace
}  // namespace axon
