// SPDX-License-Identifier: GPL-2.0-or-later
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <condition_variable>
#include <filesystem>
#include <mutex>

#include "lab/acts_server.hpp"
#include "lab/camera.hpp"
#include "lab/picture_server.hpp"

namespace axon::lab {
namespace {

using Kind = PictureRequest::Kind;

Picture plain(int width, int height, std::array<std::uint8_t, 3> colour) {
    Picture picture{width, height, {}};
    for (int i = 0; i < width * height; ++i)
        picture.rgb.insert(picture.rgb.end(), colour.begin(), colour.end());
    return picture;
}
void paint(Picture& picture, int left, int top, int right, int bottom, std::array<std::uint8_t, 3> colour) {
    for (int y = top; y <= bottom; ++y) {
        for (int x = left; x <= right; ++x)
            std::copy(colour.begin(), colour.end(), picture.rgb.begin() + 3 * (y * picture.width + x));
    }
}

TEST(PictureRequest, APathIsFoundWhenTheRequestIsWhole) {
    const std::string request = "GET /raw HTTP/1.1\r\nHost: x\r\n\r\n";
    for (std::size_t i = 0; i < request.size(); ++i)
        EXPECT_FALSE(parsePictureRequest(request.substr(0, i), false)) << i;
    EXPECT_EQ(parsePictureRequest(request, false)->kind, Kind::Raw);
    const auto kind = [](const std::string& path, bool overview) {
        return parsePictureRequest("GET " + path + " HTTP/1.1\r\n\r\n", overview)->kind;
    };
    EXPECT_EQ(kind("/stream", false), Kind::Stream);
    EXPECT_EQ(kind("/frame.jpg?1234", false), Kind::Jpeg);
    EXPECT_EQ(kind("/", false), Kind::Page);
    EXPECT_EQ(kind("/overview.png", false), Kind::NotFound);
    EXPECT_EQ(kind("/overview.png", true), Kind::Png);
    EXPECT_EQ(kind("/overview/stream", true), Kind::Stream);
    EXPECT_EQ(kind("/raw", true), Kind::NotFound);
}

TEST(PictureRequest, WhatIsNotAGetIsRefused) {
    EXPECT_EQ(parsePictureRequest("POST /raw HTTP/1.1\r\n\r\n", false)->kind, Kind::NotAllowed);
    EXPECT_EQ(parsePictureRequest("\r\n\r\n", false)->kind, Kind::NotAllowed);
    EXPECT_EQ(parsePictureRequest(std::string(9000, 'x'), false)->kind, Kind::NotAllowed);
}

TEST(PictureFiles, CarryWhatTheirNamesSay) {
    const auto picture = plain(16, 8, {200, 10, 20});
    const auto jpeg = encodeJpeg(picture);
    ASSERT_GT(jpeg.size(), 100U);
    EXPECT_EQ(jpeg[0], 0xFF);
    EXPECT_EQ(jpeg[1], 0xD8);
    const auto png = encodePng(picture);
    EXPECT_EQ(std::string(png.begin() + 1, png.begin() + 4), "PNG");
    const auto ppm = encodePpm(picture);
    EXPECT_EQ(std::string(ppm.begin(), ppm.begin() + 12), "P6\n16 8\n255\n");
    EXPECT_EQ(ppm.size(), 12U + 16 * 8 * 3);
    EXPECT_THROW(writePng("/no/such/folder/picture.png", picture), std::runtime_error);
}

TEST(Acts, BlobsAreFoundInTheirChannels) {
    auto picture = plain(320, 240, {120, 120, 120});
    paint(picture, 100, 80, 119, 159, {210, 15, 15});  // red
    paint(picture, 200, 40, 259, 99, {15, 40, 210});   // blue
    paint(picture, 20, 200, 39, 219, {15, 40, 210});   // blue, smaller
    const auto blobs = acts::findBlobs(picture);
    ASSERT_EQ(blobs[0].size(), 1U);
    EXPECT_EQ(blobs[0][0].area, 10 * 40);
    EXPECT_NEAR(blobs[0][0].x, 55, 1);
    EXPECT_NEAR(blobs[0][0].y, 60, 1);
    EXPECT_EQ(blobs[0][0].left, 50);
    EXPECT_EQ(blobs[0][0].right, 59);
    EXPECT_EQ(blobs[0][0].top, 40);
    EXPECT_EQ(blobs[0][0].bottom, 79);
    ASSERT_EQ(blobs[2].size(), 2U);
    EXPECT_GT(blobs[2][0].area, blobs[2][1].area);
    EXPECT_TRUE(blobs[1].empty());
    EXPECT_TRUE(blobs[31].empty());
}

/// Reads as ArACTS does.
int number(const std::vector<std::uint8_t>& bytes, std::size_t at, int digits) {
    int value = 0;
    for (int i = 0; i < digits; ++i) value = (value << 6) | (bytes[at + static_cast<std::size_t>(i)] - 1);
    return value;
}

TEST(Acts, TheAnswerReadsAsTheRealOne) {
    acts::Blobs blobs;
    blobs[0] = {{4000, 80, 60, 10, 150, 20, 110}, {5, 1, 2, 0, 3, 1, 4}};
    blobs[31] = {{12, 159, 119, 158, 159, 118, 119}};
    const auto bytes = acts::encode(blobs);
    ASSERT_EQ(bytes.size(), 128U + 3 * 16);
    for (const auto byte : bytes) {
        EXPECT_GE(byte, 1);
        EXPECT_LE(byte, 64);
    }
    EXPECT_EQ(number(bytes, 0, 2), 0);
    EXPECT_EQ(number(bytes, 2, 2), 2);
    EXPECT_EQ(number(bytes, 31 * 4, 2), 2);
    EXPECT_EQ(number(bytes, 31 * 4 + 2, 2), 1);
    EXPECT_EQ(number(bytes, 128, 4), 4000);
    EXPECT_EQ(number(bytes, 128 + 4, 2), 80);
    EXPECT_EQ(number(bytes, 128 + 10, 2), 150);
    EXPECT_EQ(number(bytes, 128 + 32 + 14, 2), 119);
}

TEST(Acts, AClientWaitsForTheFirstPicture) {
    ActsServer server;
    const std::vector<std::uint8_t> ask{'0', 'x', '0'};
    EXPECT_TRUE(server.receive(ask).empty());
    const auto picture = std::make_shared<const Picture>(plain(320, 240, {0, 0, 0}));
    EXPECT_EQ(server.newPicture(picture).size(), 2U * 128);
    EXPECT_TRUE(server.newPicture(picture).empty());
    EXPECT_EQ(server.receive(std::vector<std::uint8_t>{'0'}).size(), 128U);
    EXPECT_FALSE(server.quit());
    EXPECT_TRUE(server.receive(std::vector<std::uint8_t>{'1'}).empty());
    EXPECT_TRUE(server.quit());
}

/// A robot that looks along x at a red block a metre ahead, at the height of its camera.
WorldDescription worldWithABlock(bool block = true) {
    WorldDescription world;
    world.robots = {{.name = "PeopleBot", .x = 2, .y = 3, .theta = 0, .port = {}}};
    world.boxes = {{.name = "stand", .x = 3.4, .y = 3, .dx = 0.3, .dy = 0.3, .height = 0.9}};
    if (block)
        world.objects = {
            {.name = "block", .colour = "red", .x = 3.4, .y = 3, .dx = 0.12, .dy = 0.12, .dz = 0.25}};
    return world;
}

TEST(Cameras, SeeWhatStandsInFrontOfThem) {
    for (const bool block : {true, false}) {
        Physics physics(worldWithABlock(block));
        for (int i = 0; i < 50; ++i) physics.step();
        Cameras cameras(physics, 1, [](std::size_t, SharedPicture, Duration) {});
        Picture picture;
        cameras.take(0, {}, [&](Picture taken) { picture = std::move(taken); }).get();
        ASSERT_EQ(picture.width, 320);
        ASSERT_EQ(picture.height, 240);
        ASSERT_EQ(picture.rgb.size(), 320U * 240 * 3);
        const auto blobs = acts::findBlobs(picture);
        if (!block) {
            EXPECT_TRUE(blobs[0].empty());
            continue;
        }
        ASSERT_FALSE(blobs[0].empty());
        // Straight ahead; 12 cm at 1.3 m are 4.5 of 45 degrees.
        EXPECT_NEAR(blobs[0][0].x, 80, 8);
        EXPECT_NEAR(blobs[0][0].right - blobs[0][0].left, 18, 7);
        EXPECT_GT(blobs[0][0].bottom - blobs[0][0].top, blobs[0][0].right - blobs[0][0].left);
    }
}

TEST(Cameras, WhoeverTakesAPictureIsToldThatItCouldNotBeUsed) {
    Physics physics(worldWithABlock());
    Cameras cameras(physics, 1, [](std::size_t, SharedPicture, Duration) {});
    auto taken =
        cameras.take(0, {}, [](const Picture& picture) { writePng("/no/such/folder/p.png", picture); });
    EXPECT_THROW(taken.get(), std::runtime_error);
    EXPECT_FALSE(cameras.failure()) << "the next picture is drawn all the same";
}

TEST(Cameras, DrawOnlyWhatSomebodyWatchesAndOnePerPeriod) {
    Physics physics(worldWithABlock());
    std::mutex mutex;
    std::vector<Duration> ages;
    Cameras cameras(physics, 1, [&](std::size_t view, SharedPicture, Duration age) {
        const std::lock_guard lock(mutex);
        EXPECT_EQ(view, 0U);
        ages.push_back(age);
    });
    Duration age{};
    const auto pass = [&](int steps) {
        for (int i = 0; i < steps; ++i) {
            physics.step();
            cameras.offer(age += Physics::kPeriod, true);
        }
    };
    pass(250);
    EXPECT_EQ(cameras.drawn(), 0U);
    cameras.watch(0, true);
    pass(250);
    cameras.watch(0, false);
    auto last = cameras.take(0, {}, [](const Picture&) {});  // drawn after all that were ordered before
    while (last.wait_for(std::chrono::milliseconds{1}) != std::future_status::ready) cameras.offer(age, true);
    EXPECT_GE(cameras.drawn(), 11U);
    EXPECT_LE(cameras.drawn(), 12U);
    pass(100);
    const std::lock_guard lock(mutex);
    ASSERT_GE(ages.size(), 10U);
    for (std::size_t i = 2; i < ages.size(); ++i) EXPECT_EQ(ages[i] - ages[i - 1], Cameras::kPeriod);
    EXPECT_EQ(cameras.leftOut(), 0U);
}

}  // namespace
}  // namespace axon::lab
