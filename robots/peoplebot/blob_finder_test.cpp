// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/blob_finder.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>
#include <random>

namespace axon::peoplebot {
namespace {

using Rgb = std::array<double, 3>;

CameraPicture plain(const Rgb& colour, int width = 320, int height = 240) {
    CameraPicture picture{1, {}, width, height, {}};
    for (int i = 0; i < width * height; ++i) {
        for (const double c : colour) picture.rgb.push_back(static_cast<std::uint8_t>(c));
    }
    return picture;
}
void paint(CameraPicture& picture, int left, int top, int width, int height, const Rgb& colour) {
    for (int y = top; y < top + height; ++y) {
        for (int x = left; x < left + width; ++x) {
            for (std::size_t c = 0; c < 3; ++c)
                picture.rgb[static_cast<std::size_t>(y * picture.width + x) * 3 + c] =
                    static_cast<std::uint8_t>(colour[c]);
        }
    }
}
/// Weaker light, one side darker than the other, and the sensor's noise.
void light(CameraPicture& picture, double brightness, unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> noise(0, 4);
    for (std::size_t i = 0; i < picture.rgb.size(); ++i) {
        const auto x = static_cast<double>(i / 3 % static_cast<std::size_t>(picture.width)) / picture.width;
        picture.rgb[i] = static_cast<std::uint8_t>(
            std::clamp(picture.rgb[i] * brightness * (0.8 + 0.2 * x) + noise(random), 0.0, 255.0));
    }
}

const std::map<Colour, Rgb> kPaint{{Colour::Red, {200, 25, 25}},
                                   {Colour::Orange, {235, 120, 20}},
                                   {Colour::Yellow, {230, 210, 30}},
                                   {Colour::Green, {30, 160, 50}},
                                   {Colour::Blue, {25, 60, 200}}};
const Rgb kWall{190, 185, 175};
const Rgb kWood{170, 130, 95};

TEST(BlobFinder, EachColourFindsItsObjectAndNoOtherInAnyLight) {
    for (const double brightness : {1.0, 0.6, 0.35}) {
        auto picture = plain(kWall);
        paint(picture, 0, 120, 320, 120, kWood);
        int left = 20;
        for (const auto& [colour, rgb] : kPaint) {
            paint(picture, left, 100, 14, 40, rgb);
            left += 55;
        }
        light(picture, brightness, 5);
        left = 20;
        for (const auto& [colour, rgb] : kPaint) {
            const auto blobs = findBlobs(picture, colour);
            ASSERT_EQ(blobs.size(), 1U) << toString(colour) << " at " << brightness;
            EXPECT_NEAR(blobs[0].x, left + 6.5, 1) << toString(colour);
            EXPECT_NEAR(blobs[0].bottom, 139, 1);
            EXPECT_NEAR(blobs[0].area, 14 * 40, 60);
            left += 55;
        }
    }
}

TEST(BlobFinder, TheLargestComesFirstAndTheInsignificantNotAtAll) {
    auto picture = plain(kWall);
    paint(picture, 10, 10, 10, 10, kPaint.at(Colour::Red));
    paint(picture, 100, 10, 20, 20, kPaint.at(Colour::Red));
    paint(picture, 200, 10, 5, 5, kPaint.at(Colour::Red));
    paint(picture, 0, 200, 320, 1, kPaint.at(Colour::Red));
    const auto blobs = findBlobs(picture, Colour::Red);
    ASSERT_EQ(blobs.size(), 2U);
    EXPECT_EQ(blobs[0].left, 100);
    EXPECT_EQ(blobs[0].width(), 20);
    EXPECT_EQ(blobs[1].left, 10);
    EXPECT_EQ(findBlobs(picture, Colour::Red, 20).size(), 3U);
}

TEST(BlobFinder, NoiseShadowsAndPaleThingsHaveNoColour) {
    for (const auto& background : {kWall, kWood, Rgb{20, 20, 25}, Rgb{250, 250, 250}}) {
        auto picture = plain(background);
        std::mt19937 random(3);
        for (int i = 0; i < 400; ++i)  // salt
            paint(picture, static_cast<int>(random() % 319), static_cast<int>(random() % 239), 1, 1,
                  kPaint.at(Colour::Red));
        light(picture, 0.9, 7);
        for (const auto& [colour, rgb] : kPaint)
            EXPECT_TRUE(findBlobs(picture, colour).empty()) << toString(colour);
    }
}

TEST(BlobFinder, ColoursAreAlsoChannels) {
    EXPECT_EQ(parseColour("1"), Colour::Red);
    EXPECT_EQ(parseColour("2"), Colour::Green);
    EXPECT_EQ(parseColour("3"), Colour::Blue);
    EXPECT_EQ(parseColour("4"), Colour::Yellow);
    EXPECT_EQ(parseColour("5"), Colour::Orange);
    for (const auto* none : {"0", "6", "11", "-1", ""}) EXPECT_FALSE(parseColour(none)) << none;
}

TEST(BlobFinder, ColoursHaveNamesInAnyCase) {
    EXPECT_EQ(parseColour("Red"), Colour::Red);
    EXPECT_EQ(parseColour("YELLOW"), Colour::Yellow);
    EXPECT_FALSE(parseColour("pink"));
    EXPECT_EQ(
        knownColours(),
        "red, orange, yellow, green or blue (or their channels, 1 red, 2 green, 3 blue, 4 yellow, 5 orange)");
}

}  // namespace
}  // namespace axon::peoplebot
