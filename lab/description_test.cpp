// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/description.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

namespace axon::lab {
namespace {

std::string complaint(const std::function<void()>& action) {
    try {
        action();
    } catch (const BadDescription& error) {
        return error.what();
    }
    return "";
}

TEST(WorldDescription, RobotsAreParsedAndWhatIsMissingHasAPlace) {
    const auto robot = parseRobot("name=Left,x=2,y=3.5,theta=-90,port=9000", 0);
    EXPECT_EQ(robot.name, "Left");
    EXPECT_EQ(robot.x, 2);
    EXPECT_EQ(robot.y, 3.5);
    EXPECT_EQ(robot.theta, -90);
    EXPECT_EQ(robot.port, 9000);
    WorldDescription world = defaultWorld();
    for (std::size_t i = 0; i < 4; ++i) {
        world.robots.push_back(parseRobot("", i));
        EXPECT_EQ(world.robots.back().name, "PeopleBot");
        EXPECT_FALSE(world.robots.back().port);
    }
    EXPECT_NO_THROW(validate(world));
}

TEST(WorldDescription, MistakesAreNamedWithWhatWasExpected) {
    using ::testing::HasSubstr;
    EXPECT_THAT(complaint([] { parseBox("x=1,colour=red"); }),
                HasSubstr("expected one of dx, dy, height, name, theta, x, y, z"));
    EXPECT_THAT(complaint([] { parseBox("x=1m"); }), HasSubstr("expected a number"));
    EXPECT_THAT(complaint([] { parseBox("x=nan"); }), HasSubstr("expected a number"));
    EXPECT_THAT(complaint([] { parseRobot("2,3", 0); }), HasSubstr("key=value"));
    EXPECT_THAT(complaint([] { parseRobot("port=65536", 0); }), HasSubstr("1 to 65535"));
    EXPECT_THAT(complaint([] { parseRobot("name=a b", 0); }), HasSubstr("visible characters"));
}

TEST(WorldDescription, NothingStandsInAnythingElse) {
    using ::testing::HasSubstr;
    auto world = defaultWorld();
    world.robots = {{.x = 0.2, .y = 3}};
    EXPECT_THAT(complaint([&] { validate(world); }), HasSubstr("stands in a wall"));
    world.robots = {{.x = 5.2, .y = 1.3}};
    EXPECT_THAT(complaint([&] { validate(world); }), HasSubstr("stands in a box"));
    world.robots = {{.x = 3, .y = 3}, {.name = "Right", .x = 3.2, .y = 3}};
    EXPECT_THAT(complaint([&] { validate(world); }), HasSubstr("robot Right"));
    world.robots = {{.x = 9, .y = 3}};
    EXPECT_THAT(complaint([&] { validate(world); }), HasSubstr("outside of the room"));
}

}  // namespace
}  // namespace axon::lab
