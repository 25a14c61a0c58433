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

WorldDescription parse(std::string_view text) {
    return parseWorld(text, "a.lab", [](const std::string& file) -> std::string {
        if (file == "walls.map") {
            return "2D-Map\nNumLines: 4\n"
                   "Cairn: RobotHome 1000 2000 90 \"\" ICON \"\"\n"
                   "Cairn: Sim.BoxObstacle 0 0 0 \"\" ICON \"\" 3000 1000 3400 1200\n"
                   "LINES\n-1000 0 5000 0\n-1000 0 -1000 4000\n5000 0 5000 4000\n-1000 4000 5000 4000\n";
        }
        throw BadDescription(file + ": cannot be read");
    });
}
std::string complaintOf(std::string_view text) {
    return complaint([&] { parse(text); });
}

TEST(World, ADeviceOfAKindThatThereIsNotIsRefused) {
    auto world = defaultWorld();
    world.devices = {{.kind = "loom", .name = "Loom", .x = 3, .y = 3}};
    EXPECT_THAT(complaint([&] { validate(world); }), ::testing::HasSubstr("kind \"loom\""));
}

TEST(World, EveryDeviceHasNamesOfItsOwnInTheModel) {
    auto world = defaultWorld();
    world.devices = {{.kind = "cyton", .name = "A", .x = 2, .y = 2},
                     {.kind = "cyton", .name = "B", .x = 3, .y = 2}};
    const auto scene = sceneOf(world);
    ASSERT_EQ(scene.devices.size(), 2U);
    EXPECT_NE(scene.devices[0].root, scene.devices[1].root);
    EXPECT_EQ(scene.bodies.at(scene.devices[1].root).index, 1U);
    for (const auto& joint : scene.devices[1].joints)
        EXPECT_THAT(scene.xml, ::testing::HasSubstr('"' + joint + '"'));
}

TEST(WorldFile, EveryKindOfItemIsReadAndTheRestHasDefaults) {
    const auto world = parse(R"(# a laboratory
room x=8 y=6
	table name=west x=0.6 y=3 dx=0.8 dy=3 height=0.66   # with an arm
cyton name=Arm x=0.7 y=3 theta=90 port=8205
box name=platform x=0.7 y=3.3 z=0.66 dx=0.12 dy=0.12 height=0.1
object name=red x=0.7 y=3.3
object colour=blue shape=cylinder x=4 y=3 dx=0.04 dz=0.1 mass=0.1 theta=10
peoplebot x=2 y=3 theta=180 port=0
peoplebot name=Right x=3 y=5
)");
    EXPECT_EQ(world.room_x, 8);
    ASSERT_EQ(world.tables.size(), 1U);
    EXPECT_EQ(world.tables[0].name, "west");
    ASSERT_EQ(world.devices.size(), 1U);
    EXPECT_EQ(world.devices[0].kind, "cyton");
    EXPECT_EQ(world.devices[0].z, 0.66) << "on the table";
    EXPECT_EQ(world.devices[0].port, 8205);
    ASSERT_EQ(world.objects.size(), 2U);
    EXPECT_NEAR(*world.objects[0].z, 0.76, 1e-9) << "on the platform on the table";
    EXPECT_EQ(world.objects[0].colour, "red");
    EXPECT_EQ(world.objects[1].name, "object2");
    EXPECT_EQ(world.objects[1].shape, Object::Shape::Cylinder);
    EXPECT_EQ(world.objects[1].z, 0);
    ASSERT_EQ(world.robots.size(), 2U);
    EXPECT_EQ(world.robots[0].port, 0);
    EXPECT_EQ(world.robots[1].name, "Right");
}

TEST(WorldFile, AMapGivesTheWallsAndTheRoom) {
    const auto world = parse("peoplebot x=-0.5 y=2\nmap file=walls.map\n");
    EXPECT_EQ(world.walls.size(), 4U);
    EXPECT_FALSE(world.room_walls);
    EXPECT_EQ(world.room_left, -1);
    EXPECT_EQ(world.room_x, 6);
    EXPECT_EQ(world.room_y, 4);
    ASSERT_EQ(world.boxes.size(), 1U);
    EXPECT_NEAR(world.boxes[0].x, 3.2, 1e-9);
    EXPECT_NEAR(world.boxes[0].dy, 0.2, 1e-9);
    const auto at_home = parse("map file=walls.map\npeoplebot\n").robots.at(0);
    EXPECT_EQ(at_home.x, 1);
    EXPECT_EQ(at_home.theta, 90);
}

TEST(WorldFile, MistakesAreToldWithFileAndLine) {
    using ::testing::HasSubstr;
    EXPECT_THAT(
        complaintOf("room x=8 y=6\nchair x=1\n"),
        ::testing::AllOf(HasSubstr("a.lab:2: \"chair\": expected one of box, "), HasSubstr(", cyton, ")));
    EXPECT_THAT(complaintOf("\n\nbox x=1m\n"), HasSubstr("a.lab:3: box: x=1m: expected a number"));
    EXPECT_THAT(complaintOf("table x=1 y=1 colour=red\n"),
                HasSubstr("a.lab:1: table: unknown key \"colour\""));
    EXPECT_THAT(complaintOf("table x=1 x=2\n"), HasSubstr("x= twice"));
    EXPECT_THAT(complaintOf("table x\n"), HasSubstr("key=value pairs, separated by blanks"));
    EXPECT_THAT(complaintOf("object x=1 y=1 colour=pink\n"),
                HasSubstr("a.lab:1: object object: colour=pink"));
    EXPECT_THAT(complaintOf("object shape=ball\n"), HasSubstr("expected box or cylinder"));
    EXPECT_THAT(complaintOf("map file=none.map\n"), HasSubstr("a.lab:1: none.map: cannot be read"));
    EXPECT_THAT(complaintOf("map\n"), HasSubstr("expected file=NAME.map"));
    EXPECT_THAT(complaintOf("cyton x=1 y=1 port=-1\n"), HasSubstr("1 to 65535"));
}

TEST(WorldFile, WhatStandsInSomethingIsToldWithTheLineThatMadeItSo) {
    using ::testing::HasSubstr;
    EXPECT_THAT(complaintOf("peoplebot x=2 y=2\nroom x=8 y=6\nbox x=2.3 y=2\npeoplebot x=4 y=4\n"),
                HasSubstr("a.lab:3: robot PeopleBot at x=2, y=2 stands in a box"));
    EXPECT_THAT(complaintOf("table name=a x=1 y=1\nbox name=a x=3 y=3\n"),
                HasSubstr("a.lab:2: two things are called a"));
    EXPECT_THAT(complaintOf("map file=walls.map\npeoplebot x=4.9 y=2\n"),
                HasSubstr("a.lab:2: robot PeopleBot"));
    EXPECT_THAT(complaintOf("object x=9 y=1\n"), HasSubstr("outside of the room"));
    EXPECT_THAT(complaintOf("cyton x=1 y=1\ncyton name=Other x=1.1 y=1\n"),
                HasSubstr("arm Other stands in arm Cyton"));
}

TEST(WorldFile, TheWorldsOfTheRepositoryAreRight) {
    for (const char* file :
         {"transport", "figure", "room", "corridors", "offices", "openplan", "ward", "workshop", "villa"})
        EXPECT_NO_THROW(loadWorld(std::string("lab/worlds/") + file + ".lab")) << file;
    EXPECT_THAT(complaint([] { loadWorld("lab/worlds/none.lab"); }), ::testing::HasSubstr("cannot be read"));
}

}  // namespace
}  // namespace axon::lab
