// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/home.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "robots/peoplebot/body.hpp"

namespace axon::peoplebot {
namespace {

using ::testing::HasSubstr;

constexpr auto kRoom = "LINES\n0 0 8000 0\n8000 0 8000 6000\n8000 6000 0 6000\n0 6000 0 0\n";
constexpr auto kNiche = "2000 6000 2000 4800\n3000 6000 3000 4800\n2000 4800 3000 4800\n6500 0 6500 1500\n";

FloorPlan plan(const std::string& cairns, const std::string& walls = std::string(kRoom) + kNiche) {
    return FloorPlan(mapper3::parseMap("2D-Map\n" + cairns + walls, "map"));
}
/// What a laser sees of these walls from there.
arcos::LaserScan scanFrom(const FloorPlan& plan, const MapPose& pose) {
    arcos::LaserScan scan;
    const auto laser = pose.then({body::kLaserX_mm, 0, 0});
    for (int i = 0; i <= 180; ++i) {
        const double a = (laser.heading_deg - 90 + i) * std::numbers::pi / 180;
        int range = 0;
        while (plan.wallDistance_mm({laser.x_mm + range * std::cos(a), laser.y_mm + range * std::sin(a)}) >
               FloorPlan::kCell_mm)
            range += 20;
        scan.ranges_mm.push_back(static_cast<std::uint16_t>(range));
    }
    return scan;
}
void expectNear(const MapPose& is, const MapPose& expected) {
    EXPECT_NEAR(is.x_mm, expected.x_mm, 150);
    EXPECT_NEAR(is.y_mm, expected.y_mm, 150);
    EXPECT_NEAR(std::remainder(is.heading_deg - expected.heading_deg, 360), 0, 6);
}
std::string refusal(const FloorPlan& plan, const MapPose& moved, const MapPose& really) {
    try {
        startFromHome(plan, moved, scanFrom(plan, really));
    } catch (const std::invalid_argument& error) {
        return error.what();
    }
    return {};
}
constexpr auto kHome = "Cairn: RobotHome 1500 3000 0 \"\" ICON \"\"\n";

TEST(StartFromHome, ARobotThatWasPutDownThereIsThere) {
    const auto here = plan(kHome);
    const MapPose really{1450, 3100, -5};
    expectNear(startFromHome(here, {}, scanFrom(here, really)).pose, really);
}

TEST(StartFromHome, ItsWaySinceItWasConnectedCounts) {
    const auto here = plan(kHome);
    const MapPose really{5000, 2200, 150};
    // Its wheels slipped a little.
    expectNear(startFromHome(here, {3600, -900, 158}, scanFrom(here, really)).pose, really);
}

TEST(StartFromHome, ADockIsAHome) {
    const auto here = plan("Cairn: Dock 7200 4500 180 \"\" ICON \"Dock\"\n");
    expectNear(startFromHome(here, {}, scanFrom(here, {7200, 4500, 180})).pose, {7200, 4500, 180});
}

TEST(StartFromHome, OfSeveralHomesTheLaserTellsWhich) {
    const auto here = plan(std::string(kHome) + "Cairn: Dock 7200 4500 180 \"\" ICON \"Dock\"\n");
    expectNear(startFromHome(here, {}, scanFrom(here, {7200, 4500, 180})).pose, {7200, 4500, 180});
    expectNear(startFromHome(here, {}, scanFrom(here, {1500, 3000, 0})).pose, {1500, 3000, 0});
}

TEST(StartFromHome, ARobotThatIsElsewhereIsRefusedWithTheRemedy) {
    const auto here = plan(kHome);
    for (const MapPose really :
         {MapPose{5000, 2200, 150}, {1500, 3000, 90}, {7000, 5000, -90}, {3800, 5200, 20}}) {
        const auto why = refusal(here, {}, really);
        EXPECT_THAT(why, HasSubstr("nobody has said where the robot is")) << really.x_mm;
        EXPECT_THAT(
            why,
            HasSubstr("fix: give Start (X,Y,HEADING in mm, mm, degrees), or start the program with --at"));
    }
}

TEST(StartFromHome, HomesThatLookAlikeAreRefused) {
    const auto here = plan(
        "Cairn: RobotHome 1500 3000 0 \"\" ICON \"\"\nCairn: Dock 6500 3000 180 \"\" ICON \"\"\n", kRoom);
    EXPECT_THAT(refusal(here, {}, {1500, 3000, 0}), HasSubstr("the map's homes look alike"));
}

TEST(StartFromHome, HomesThatLookAlikeInTwoDirectionsAreRefused) {
    const auto here = plan(
        "Cairn: RobotHome 4000 3000 0 \"\" ICON \"\"\nCairn: Dock 4000 3000 180 \"\" ICON \"\"\n", kRoom);
    EXPECT_THAT(refusal(here, {}, {4000, 3000, 0}), HasSubstr("the map's homes look alike"));
}

TEST(StartFromHome, TwoNamesOfOneHomeAreOneHome) {
    const auto here = plan(std::string(kHome) + "Cairn: Dock 1600 3000 358 \"\" ICON \"\"\n");
    expectNear(startFromHome(here, {}, scanFrom(here, {1500, 3000, 0})).pose, {1500, 3000, 0});
}

TEST(StartFromHome, AMapWithoutAHomeIsRefused) {
    EXPECT_THAT(refusal(plan(""), {}, {1500, 3000, 0}),
                HasSubstr("the map has neither RobotHome nor Dock; fix: give Start"));
}

}  // namespace
}  // namespace axon::peoplebot
