// SPDX-License-Identifier: MIT
#include "entity_interfacer/stream_channels.hpp"

#include <gtest/gtest.h>

#include <atomic>

namespace axon {
namespace {

struct FakeChannel {
    std::atomic<bool> wanted{false};
};

struct TheStreamChannels : testing::Test {
    std::shared_ptr<FakeChannel> channel(const std::string& name) {
        return channels.channel(name, [] { return std::make_shared<FakeChannel>(); });
    }
    bool wanted(const std::string& name) { return channel(name)->wanted; }
    StreamChannels<FakeChannel> channels;
};

TEST_F(TheStreamChannels, AStreamHasOneChannelAndIsWantedUntilSomebodySaysOtherwise) {
    EXPECT_EQ(channel("camera"), channel("camera"));
    EXPECT_NE(channel("camera"), channel("laser"));
    EXPECT_TRUE(wanted("camera"));
}

TEST_F(TheStreamChannels, WhereNotAllAreWantedThoseAreThatWereNamed) {
    const auto camera = channel("camera");
    const auto laser = channel("laser");
    channels.switchTo(true, "camera");
    channels.switchTo(false, "");
    EXPECT_TRUE(camera->wanted);
    EXPECT_FALSE(laser->wanted);
    channels.switchTo(false, "camera");
    EXPECT_FALSE(camera->wanted);
    channels.switchTo(true, "");
    EXPECT_TRUE(laser->wanted);
}

TEST_F(TheStreamChannels, AChannelThatIsMadeLaterFollowsWhatWasSaidBefore) {
    channels.switchTo(false, "");
    channels.switchTo(true, "camera");
    EXPECT_TRUE(wanted("camera"));
    EXPECT_FALSE(wanted("laser"));
}

TEST_F(TheStreamChannels, ALinkBeginsWithAllOfThemAndForgetsWhatTheLastOneWanted) {
    channels.switchTo(false, "");
    channels.switchTo(true, "camera");
    const auto laser = channel("laser");
    channels.linkBegins();
    EXPECT_TRUE(laser->wanted);
    channels.switchTo(false, "");
    EXPECT_FALSE(wanted("camera"));
}

TEST_F(TheStreamChannels, NamesBeyondTheBoundAreNotWantedByName) {
    channels.switchTo(false, "");
    for (std::size_t i = 0; i < StreamChannels<FakeChannel>::kMax; ++i)
        channels.switchTo(true, std::to_string(i));
    channels.switchTo(true, "one too many");
    EXPECT_FALSE(wanted("one too many"));
    channels.switchTo(false, "0");
    channels.switchTo(true, "one too many");
    EXPECT_TRUE(wanted("one too many"));
}

}  // namespace
}  // namespace axon
