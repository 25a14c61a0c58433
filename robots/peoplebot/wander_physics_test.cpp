// SPDX-License-Identifier: GPL-2.0-or-later
// Minutes of wandering in physics without touching anything, judged by ground truth.
#include <fmt/format.h>

#include <cstdlib>
#include <string>

#include "robots/peoplebot/virtual_robot_test.hpp"
#include "robots/peoplebot/wander.hpp"

namespace axon::peoplebot {
namespace {

class WanderPhysicsTest : public VirtualRobotTest {
  protected:
    void wander(const std::string& place, const lab::WorldDescription& world, unsigned seed) {
        start(world, {.seed = seed, .noise = 1});
        const char* wish = std::getenv("AXON_WANDER_SECONDS");
        const double seconds = wish != nullptr ? std::atof(wish) : 150;
        Wander motion({.velocity_mm_s = 300, .duration_s = seconds, .seed = seed},
                      loadWanderRules("robots/peoplebot/wander.rules"), robot(), lab_->now());
        const auto end = perform(motion, std::chrono::seconds{static_cast<int>(seconds) + 30});
        fmt::print("wander in {}: {:.0f} s, {:.1f} m, {} recoveries, nearest {:.0f} mm\n", place, seconds,
                   motion.travelled_mm() / 1000, motion.recoveries(), nearest_mm_);
        EXPECT_EQ(end.outcome, MotionStep::Outcome::Done) << end.reason;
        EXPECT_EQ(bumps_, 0);
        EXPECT_EQ(touched(), "");
        EXPECT_GT(nearest_mm_, 5);
        EXPECT_GT(motion.travelled_mm(), seconds * 60) << "it is to wander, not to turn on the spot";
    }
};

TEST_F(WanderPhysicsTest, InTheDefaultWorld) {
    auto world = lab::defaultWorld();
    world.robots = {lab::parseRobot("", 0)};
    wander("the default world", world, 1);
}

TEST_F(WanderPhysicsTest, InCorridorsWithDeadEnds) {
    lab::WorldDescription world;
    world.room_x = 9;
    world.room_y = 6;
    world.boxes = {{.x = 3, .y = 1.6, .dx = 6, .dy = 0.2, .height = 1.5},
                   {.x = 6, .y = 4.2, .dx = 6, .dy = 0.2, .height = 1.5},
                   {.x = 4.5, .y = 3.5, .dx = 0.2, .dy = 1.4, .height = 1.5},
                   {.x = 7.7, .y = 2.2, .dx = 0.3, .dy = 1.4, .height = 1.5}};
    world.robots = {{.x = 1.0, .y = 0.8}};
    wander("corridors", world, 2);
}

TEST_F(WanderPhysicsTest, AmongTablesWhichOnlyTheirSensorsSee) {
    lab::WorldDescription world;
    world.room_x = 7;
    world.room_y = 6;
    world.tables = {{.x = 2, .y = 4.5, .dx = 1.6, .dy = 0.8, .height = 0.7},
                    {.x = 5.2, .y = 2.2, .dx = 0.8, .dy = 1.6, .height = 0.66},
                    {.x = 2.2, .y = 1.5, .dx = 1.2, .dy = 0.8, .height = 0.74, .theta = 30}};
    world.robots = {{.x = 3.6, .y = 3.2}};
    wander("a room of tables", world, 3);
}

class WanderInWorldsTest : public WanderPhysicsTest, public testing::WithParamInterface<const char*> {};

TEST_P(WanderInWorldsTest, NothingIsTouched) {
    if (std::getenv("AXON_LONG_TRIALS") == nullptr)
        GTEST_SKIP() << "all worlds take a minute; AXON_LONG_TRIALS=1 runs them";
    wander(GetParam(), lab::loadWorld(std::string("lab/worlds/") + GetParam() + ".lab"), 4);
}

INSTANTIATE_TEST_SUITE_P(Laboratory, WanderInWorldsTest,
                         testing::Values("room", "corridors", "transport", "offices", "openplan", "ward",
                                         "workshop", "villa"));

}  // namespace
}  // namespace axon::peoplebot
