// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/mapper3/map.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

namespace axon::mapper3 {
namespace {

using ::testing::HasSubstr;

constexpr auto kMap = R"(2D-Map 
MinPos: -100 -100
MaxPos: 5000 4000
NumPoints: 2
PointsAreSorted: true
Resolution: 20
LineMinPos: 0 0
LineMaxPos: 5000 4000
NumLines: 2
LinesAreSorted: true
OriginLatLongAlt: 42.8 -71.5 72.0
MapInfo: SectorType Name=Quiet "Label=Quiet place" Shape=Plain Color0=0x888888
Cairn: Goal 1000 1000 45.0 "" ICON "Room 1"
Cairn: GoalWithHeading 2000 1000 -90.000000 "the door" ICON "Door"
Cairn: RobotHome 100 200 0.000000 "" ICON ""
Cairn: Dock 300 200 180 "" ICON "Dock"
Cairn: ForbiddenLine 0 0 0.0 "" ICON "" 3000 0 3000 4000
Cairn: ForbiddenArea 0 0 45.000000 "" ICON "Stairs" 1000 -500 2000 500
Cairn: Sim.BoxObstacle 0 0 0 "" ICON "" 4000 3000 4500 3500
Cairn: Quiet 0 0 0 "" ICON "here" 0 0 10 10 "and more"
RouteInfo: something newer
LINES
0 0 5000 0
5000 0 5000 4000
REFLECTORS
17 18 19
DATA
0 20
-40 60
)";

std::string complaint(std::string_view text) {
    try {
        parseMap(text, "a.map");
    } catch (const BadMap& error) {
        return error.what();
    }
    return "";
}

TEST(Mapper3, AGoalIsFoundInUpperOrLowerCaseIfOnlyOneIsMeant) {
    Map map;
    map.goals.resize(3);
    map.goals[0].name = "Door";
    map.goals[1].name = "DOOR";
    map.goals[2].name = "Desk";
    EXPECT_EQ(map.goal("Door"), &map.goals[0]);
    EXPECT_EQ(map.goal("DOOR"), &map.goals[1]);
    EXPECT_EQ(map.goal("door"), nullptr) << "it may mean two goals";
    EXPECT_EQ(map.goal("dESK"), &map.goals[2]);
    EXPECT_EQ(map.goal("Desk 2"), nullptr);
    EXPECT_EQ(map.goal(""), nullptr);
}

TEST(Mapper3, EveryKindOfEntryIsRead) {
    const auto map = parseMap(kMap, "a.map");
    EXPECT_EQ(map.lines, (std::vector<Line>{{{0, 0}, {5000, 0}}, {{5000, 0}, {5000, 4000}}}));
    EXPECT_EQ(map.points, (std::vector<Point>{{0, 20}, {-40, 60}}));
    EXPECT_EQ(map.resolution_mm, 20);
    ASSERT_EQ(map.goals.size(), 2U);
    ASSERT_NE(map.goal("Room 1"), nullptr);
    EXPECT_FALSE(map.goal("Room 1")->heading_deg);
    EXPECT_EQ(map.goal("Door")->heading_deg, -90);
    EXPECT_EQ(map.goal("Window"), nullptr);
    EXPECT_EQ(map.goal("room 1"), map.goal("Room 1"));
    ASSERT_EQ(map.homes.size(), 1U);
    EXPECT_EQ(map.homes[0].at, (Point{100, 200}));
    EXPECT_EQ(map.docks.at(0).heading_deg, 180);
    EXPECT_EQ(map.forbidden_lines.size(), 1U);
    ASSERT_EQ(map.forbidden_areas.size(), 1U);
    EXPECT_EQ(map.obstacles.size(), 1U);
    ASSERT_EQ(map.others.size(), 1U);
    EXPECT_EQ(map.others[0].type, "Quiet");
    EXPECT_EQ(map.bounds(), (Line{{-40, 0}, {5000, 4000}}));
}

TEST(Mapper3, AForbiddenAreaIsTurnedAboutTheOrigin) {
    const auto area = parseMap(kMap, "a.map").forbidden_areas.at(0);
    EXPECT_EQ(area.name, "Stairs");
    EXPECT_TRUE(area.contains({1060, 1060}));  // 1500 along the diagonal
    EXPECT_FALSE(area.contains({1500, 0}));
    EXPECT_FALSE(area.contains({500, 500}));
    const auto corners = area.corners();
    ASSERT_EQ(corners.size(), 4U);
    EXPECT_NEAR(corners[2].x_mm, (2000 - 500) * 0.70711, 1);
    EXPECT_NEAR(corners[2].y_mm, (2000 + 500) * 0.70711, 1);
}

TEST(Mapper3, TheShortestMapIsOneLine) {
    const auto map = parseMap("2D-Map", "a.map");
    EXPECT_TRUE(map.lines.empty());
    EXPECT_EQ(map.bounds(), Line{});
    EXPECT_TRUE(parseMap("2D-Map\r\nLINES\r\n0 0 1 1\r\n", "a.map").lines.size() == 1);
}

TEST(Mapper3, WhatIsWrongIsRefusedWithItsLine) {
    EXPECT_THAT(complaint(""), HasSubstr("a.map:1: expected \"2D-Map\""));
    EXPECT_THAT(complaint("3D-Map\n"), HasSubstr("a.map:1: "));
    EXPECT_THAT(complaint("2D-Map\n1 2 3 4\n"), HasSubstr("a.map:2: numbers before LINES"));
    EXPECT_THAT(complaint("2D-Map\nLINES\n1 2 3\n"), HasSubstr("a.map:3: \"1 2 3\": expected x1 y1 x2 y2"));
    EXPECT_THAT(complaint("2D-Map\nLINES\n1 2 3 4 5\n"), HasSubstr("a.map:3"));
    EXPECT_THAT(complaint("2D-Map\nDATA\n1 a\n"), HasSubstr("a.map:3: a point: \"a\": expected a number"));
    EXPECT_THAT(complaint("2D-Map\nNumLines: 2\nLINES\n1 2 3 4\n"),
                HasSubstr("NumLines promises 2, but there are 1"));
    EXPECT_THAT(complaint("2D-Map\nNumPoints: -1\n"), HasSubstr("a.map:2"));
    EXPECT_THAT(complaint("2D-Map\nNumPoints:\n"), HasSubstr("expected one number"));
    EXPECT_THAT(complaint("2D-Map\nMinPos: 1\n"), HasSubstr("expected x y"));
    EXPECT_THAT(complaint("2D-Map\nLINES\nLINES\n"), HasSubstr("a.map:3: a second LINES"));
    EXPECT_THAT(complaint("2D-Map\nLINES\n1e300 0 0 0\n"), HasSubstr("out of all proportion"));
}

TEST(Mapper3, ABadCairnIsRefusedWithItsLine) {
    EXPECT_THAT(complaint("2D-Map\nCairn: Goal 1 2 0 \"\" ICON\n"), HasSubstr("a.map:2: Cairn: 6 words"));
    EXPECT_THAT(complaint("2D-Map\nCairn: Goal 1 2 0 \"\" ICON \"x\n"), HasSubstr("a quote without an end"));
    EXPECT_THAT(complaint("2D-Map\nCairn: Goal 1 2 0 \"\" ICON \"\"\n"), HasSubstr("without a name"));
    EXPECT_THAT(complaint("2D-Map\nCairn: Goal x 2 0 \"\" ICON \"a\"\n"),
                HasSubstr("x: \"x\": expected a number"));
    EXPECT_THAT(complaint("2D-Map\nCairn: ForbiddenArea 1 2 0 \"\" ICON \"\"\n"),
                HasSubstr("needs x1 y1 x2 y2"));
    EXPECT_THAT(complaint("2D-Map\nCairn: ForbiddenLine 1 2 0 \"\" ICON \"\" 1 2 3\n"),
                HasSubstr("needs x1 y1"));
    EXPECT_THAT(complaint("2D-Map\nCairn: Goal 1 2 0 \"\" ICON a\nCairn: Goal 3 2 0 \"\" ICON a\n"),
                HasSubstr("a.map:3: Cairn: there is a goal \"a\" in line 2 already"));
}

TEST(Mapper3, CutAnywhereAMapIsReadOrRefusedButNeverMore) {
    const std::string_view whole = kMap;
    for (std::size_t size = 0; size < whole.size(); ++size) {
        try {
            parseMap(whole.substr(0, size), "a.map");
        } catch (const BadMap& error) {
            EXPECT_THAT(error.what(), HasSubstr("a.map:"));
        }
    }
}

}  // namespace
}  // namespace axon::mapper3
