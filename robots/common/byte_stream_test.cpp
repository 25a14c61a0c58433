// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/byte_stream.hpp"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <vector>

#include "common/descriptor.hpp"

namespace axon::robots {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// The robot's end of a serial line.
class PseudoTerminal {
  public:
    PseudoTerminal() : master_(::posix_openpt(O_RDWR | O_NOCTTY)) {
        ::grantpt(descriptor());
        ::unlockpt(descriptor());
        std::array<char, 100> name{};
        ::ptsname_r(descriptor(), name.data(), name.size());
        path_ = name.data();
    }
    void hangUp() { master_.reset(); }
    int descriptor() const { return master_.get(); }
    const std::string& path() const { return path_; }

  private:
    Descriptor master_;
    std::string path_;
};

std::vector<int> readFrom(ByteStream& stream) {
    pollfd waiting{stream.descriptor(), POLLIN, 0};
    ::poll(&waiting, 1, 5000);
    std::array<std::uint8_t, 100> chunk{};
    const int got = stream.read(chunk);
    return {chunk.begin(), chunk.begin() + std::max(got, 0)};
}

TEST(SerialStreamTest, CarriesEveryByteUnchangedBothWays) {
    PseudoTerminal robot;
    auto opened = robotStreams(robot.path() + ":38400")(std::chrono::seconds{1});
    ASSERT_TRUE(opened) << opened.refusal().message;
    auto stream = std::move(opened).value();
    std::array<std::uint8_t, 100> chunk{};
    EXPECT_EQ(stream->read(chunk), 0);
    // What a line discipline would change: end of file, carriage return, line feed, interrupt, XOFF, the
    // eighth bit.
    const std::array<std::uint8_t, 6> bytes{0x04, 0x0D, 0x0A, 0x03, 0x13, 0xFA};
    ASSERT_EQ(::write(robot.descriptor(), bytes.data(), bytes.size()), 6);
    EXPECT_THAT(readFrom(*stream), ElementsAre(0x04, 0x0D, 0x0A, 0x03, 0x13, 0xFA));
    EXPECT_TRUE(stream->write(bytes));
    std::array<std::uint8_t, 6> back{};
    ASSERT_EQ(::read(robot.descriptor(), back.data(), back.size()), 6);
    EXPECT_EQ(back, bytes);
}

TEST(SerialStreamTest, ALineThatIsHungUpIsGone) {
    PseudoTerminal robot;
    auto stream = std::move(serialStreams(robot.path())(std::chrono::seconds{1})).value();
    robot.hangUp();
    std::array<std::uint8_t, 10> chunk{};
    EXPECT_EQ(stream->read(chunk), -1);
}

TEST(SerialStreamTest, TwoProgramsDoNotShareALine) {
    PseudoTerminal robot;
    const auto first = serialStreams(robot.path())(std::chrono::seconds{1});
    ASSERT_TRUE(first);
    const auto second = serialStreams(robot.path())(std::chrono::seconds{1});
    ASSERT_FALSE(second);
    EXPECT_THAT(second.refusal().message, HasSubstr("another program"));
}

TEST(SerialStreamTest, ItsSpeedIsToldAndChangedOnTheLineItself) {
    PseudoTerminal robot;
    const auto speedOfLine = [&robot] {
        termios line{};
        ::tcgetattr(robot.descriptor(), &line);
        return ::cfgetospeed(&line);
    };
    auto stream = std::move(serialStreams(robot.path())(std::chrono::seconds{1})).value();
    EXPECT_EQ(stream->speed().baud, kFirstSpeed);
    EXPECT_EQ(stream->speed().asked, 0);
    EXPECT_EQ(speedOfLine(), static_cast<speed_t>(B9600));
    EXPECT_TRUE(stream->setSpeed(38400));
    EXPECT_EQ(stream->speed().baud, 38400);
    EXPECT_EQ(speedOfLine(), static_cast<speed_t>(B38400));
    EXPECT_FALSE(stream->setSpeed(12345));
    EXPECT_EQ(stream->speed().baud, 38400);
    stream.reset();
    EXPECT_EQ(
        std::move(serialStreams(robot.path() + ":57600")(std::chrono::seconds{1})).value()->speed().asked,
        57600);
    EXPECT_EQ(speedOfLine(), static_cast<speed_t>(B57600));
}

TEST(SerialStreamTest, WhatIsNoSerialLineIsSaid) {
    const auto file = serialStreams("/dev/null")(std::chrono::seconds{1});
    ASSERT_FALSE(file);
    EXPECT_THAT(file.refusal().message, HasSubstr("not a serial line"));
    EXPECT_FALSE(serialStreams("/dev/no-such-line")(std::chrono::seconds{1}));
    EXPECT_THROW(serialStreams("/dev/ttyS0:12345"), std::invalid_argument);
    EXPECT_THROW(robotStreams("/dev/ttyS0:fast"), std::invalid_argument);
    EXPECT_THROW(robotStreams("nonsense"), std::invalid_argument);
}

}  // namespace
}  // namespace axon::robots
