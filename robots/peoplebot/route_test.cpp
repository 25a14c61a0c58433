// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/route.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <sstream>

namespace axon::peoplebot {
namespace {

using mapper3::Point;
using ::testing::HasSubstr;

class RouteTest : public ::testing::Test {
  protected:
    static mapper3::Map read() {
        std::ostringstream text;
        text << std::ifstream("robots/peoplebot/testdata/small.map").rdbuf();
        return mapper3::parseMap(text.str(), "small.map");
    }
    Point goal(const std::string& name) const { return plan_.map().goal(name)->at; }
    /// The least room along a route, without its ends.
    double leastRoom(const Route& route) const {
        double least = 1e9;
        for (std::size_t i = 1; i < route.points.size(); ++i) {
            const auto& a = route.points[i - 1];
            const auto& b = route.points[i];
            for (double part = 0; part <= 1; part += 0.01)
                least = std::min(least, plan_.room_mm({a.x_mm + part * (b.x_mm - a.x_mm),
                                                       a.y_mm + part * (b.y_mm - a.y_mm)}));
        }
        return least;
    }
    const FloorPlan plan_{read()};
    const Point home_{1500, 3000};
};

TEST(DistanceField, IsExact) {
    constexpr int kWidth = 17;
    constexpr int kHeight = 11;
    std::vector<std::uint8_t> cells(kWidth * kHeight);
    cells[3 * kWidth + 4] = cells[9 * kWidth + 15] = cells[0] = 1;
    const auto field = distancesToOccupied(cells, kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) {
            const double nearest =
                std::min({std::hypot(x - 4, y - 3), std::hypot(x - 15, y - 9), std::hypot(x, y)});
            EXPECT_NEAR(field[static_cast<std::size_t>(y * kWidth + x)], nearest, 1e-4);
        }
    }
}

TEST_F(RouteTest, EveryGoalIsReachedOrRefusedWithTheReason) {
    for (const auto& place : plan_.map().goals) {
        const auto objection = plan_.objection(place.name);
        if (place.name == "kept out") {
            EXPECT_THAT(objection, HasSubstr("lies in a forbidden area"));
            continue;
        }
        if (place.name == "at the wall") {
            EXPECT_THAT(objection, HasSubstr("the robot needs 310 mm"));
            continue;
        }
        EXPECT_EQ(objection, "");
        const auto answer = findRoute(plan_, home_, place.at);
        if (place.name == "walled in") {
            EXPECT_FALSE(answer.route);
            EXPECT_THAT(answer.reason, HasSubstr("no way leads there"));
            continue;
        }
        ASSERT_TRUE(answer.route) << place.name << ": " << answer.reason;
        EXPECT_EQ(answer.route->points.front(), home_);
        EXPECT_EQ(answer.route->points.back(), place.at);
        EXPECT_GE(leastRoom(*answer.route), kLeastRoom_mm - FloorPlan::kCell_mm) << place.name;
    }
}

TEST_F(RouteTest, AnUnknownGoalIsAnsweredWithThoseThereAre) {
    EXPECT_THAT(plan_.objection("moon"),
                HasSubstr("has no goal \"moon\": it has \"at the wall\", \"corner\", \"kept out\""));
}

TEST_F(RouteTest, AForbiddenLineIsGoneRound) {
    const auto answer = findRoute(plan_, {4600, 2600}, goal("nook"));
    ASSERT_TRUE(answer.route) << answer.reason;
    EXPECT_GT(answer.route->length_mm(), 2300) << "straight through the line it would be 1700";
    EXPECT_GE(leastRoom(*answer.route), kLeastRoom_mm - FloorPlan::kCell_mm);
}

TEST_F(RouteTest, RoomIsKeptWhereThereIsRoom) {
    const auto answer = findRoute(plan_, home_, goal("corner"));
    ASSERT_TRUE(answer.route) << answer.reason;
    EXPECT_GE(leastRoom(*answer.route), 450);
}

TEST_F(RouteTest, WhatWasSightedIsGoneRoundOrBlocks) {
    const std::vector<Point> box{{3000, 3000}, {3000, 3100}, {3000, 2900}};
    const auto free = findRoute(plan_, home_, {3600, 3600});
    const auto round = findRoute(plan_, home_, {3600, 3600}, box);
    ASSERT_TRUE(free.route && round.route);
    EXPECT_GE(round.route->length_mm(), free.route->length_mm());
    std::vector<Point> fence;
    for (int i = 0; i < 12; ++i) fence.push_back({4100 + i * 90.0, 3000 + i * 50.0});
    EXPECT_TRUE(findRoute(plan_, home_, goal("south east")).route);
    EXPECT_FALSE(findRoute(plan_, home_, goal("south east"), fence).route);
}

TEST_F(RouteTest, ARobotCloseToAWallGetsAwayFromItFirst) {
    const auto answer = findRoute(plan_, {260, 3000}, goal("corner"));
    ASSERT_TRUE(answer.route) << answer.reason;
    EXPECT_EQ(answer.route->points.front(), (Point{260, 3000}));
    EXPECT_GE(plan_.room_mm(answer.route->points.at(1)), kLeastRoom_mm);
    EXPECT_THAT(findRoute(plan_, {-9000, 0}, goal("corner")).reason, HasSubstr("not on the map"));
}

TEST(FloorPlanOf, AMapWithoutWallsOrTooLargeIsRefused) {
    EXPECT_THROW(FloorPlan(mapper3::parseMap("2D-Map\n", "empty")), mapper3::BadMap);
    mapper3::Map wide;
    wide.lines = {{{0, 0}, {1e6, 1e6}}};
    EXPECT_THROW(FloorPlan{wide}, mapper3::BadMap);
}

}  // namespace
}  // namespace axon::peoplebot
