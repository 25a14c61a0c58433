// SPDX-License-Identifier: GPL-2.0-or-later
// Navigation in physics: localisation from a noisy laser and slipping wheels, judged by ground truth.
#include <fmt/format.h>
#include <gmock/gmock.h>

#include <cstdlib>
#include <fstream>
#include <sstream>
#include <utility>
#include <vector>

#include "robots/peoplebot/navigation.hpp"
#include "robots/peoplebot/virtual_robot_test.hpp"

namespace axon::peoplebot {
namespace {

using Outcome = MotionStep::Outcome;
using ::testing::HasSubstr;

/// Feeds the localisation before the navigation asks it, as the application does.
struct Located {
    Navigation navigation;
    Localisation& localisation;
    const std::function<void(const arcos::RobotState&)> watch;
    std::string news;

    MotionStep step(const arcos::RobotState& robot, TimePoint now) {
        localisation.update(robot);
        watch(robot);
        const auto step = navigation.step(robot, now);
        if (const auto fresh = navigation.takeNews(); !fresh.empty()) news += "    " + fresh + "\n";
        if (std::getenv("AXON_NAVIGATION_TRACE") != nullptr) {
            const auto& pose = navigation.estimate().pose;
            fmt::print(
                "{:.1f} s at ({:.0f}, {:.0f}, {:.0f}) fit {:.2f} spread {:.0f} drives {:.0f} {:.0f} {}\n",
                toSeconds(now), pose.x_mm, pose.y_mm, pose.heading_deg, navigation.estimate().fit,
                navigation.estimate().spread_mm, step.forward_mm_s, step.left_deg_s, step.halt);
        }
        return step;
    }
    static double toSeconds(TimePoint time) {
        return std::chrono::duration<double>(time.time_since_epoch()).count();
    }
};

/// Two rooms, and a door in the wall between them, in whose middle the origin is.
struct Door {
    double width_mm;  // between the jambs
    double from_deg;  // where the robot comes from: off the wall's normal, to the left of the way through it
    double to_deg;    // and where it goes to, to the left
    double turned_deg;  // the building on the map
    double thick_mm;    // the wall
    double from_mm;     // from the door's middle to where the robot stands
    double to_mm;       // and to the goal

    mapper3::Point at(double x, double y) const {
        const auto pose = MapPose{0, 0, turned_deg}.then({x, y, 0});
        return {pose.x_mm, pose.y_mm};
    }
    MapPose robot() const {
        const double a = from_deg * std::numbers::pi / 180;
        return MapPose{0, 0, turned_deg}.then({-from_mm * std::cos(a), from_mm * std::sin(a), -from_deg});
    }
    std::string map() const {
        // The laboratory's walls are as thick to both sides of a map's lines.
        constexpr double kHalfWall_mm = 20;
        const double jamb = width_mm / 2 + kHalfWall_mm;
        const double face = thick_mm / 2;
        std::string lines;
        const auto line = [&](double x1, double y1, double x2, double y2) {
            const auto a = at(x1, y1);
            const auto b = at(x2, y2);
            lines += fmt::format("{:.0f} {:.0f} {:.0f} {:.0f}\n", a.x_mm, a.y_mm, b.x_mm, b.y_mm);
        };
        for (const double side : {-1.0, 1.0}) {
            line(-face, side * jamb, -face, side * 3500);
            line(face, side * jamb, face, side * 3500);
            line(-face, side * jamb, face, side * jamb);
            line(-4000, side * 3500, 4000, side * 3500);
            line(side * 4000, -3500, side * 4000, 3500);
        }
        const double b = to_deg * std::numbers::pi / 180;
        const auto goal = at(to_mm * std::cos(b), to_mm * std::sin(b));
        const auto home = robot();
        return fmt::format(
            "2D-Map\nCairn: Goal {:.0f} {:.0f} 0 \"\" ICON \"beyond\"\nCairn: RobotHome {:.0f} {:.0f} {:.2f} "
            "\"\" ICON \"\"\nLINES\n{}",
            goal.x_mm, goal.y_mm, home.x_mm, home.y_mm, home.heading_deg, lines);
    }
};

class NavigationPhysicsTest : public VirtualRobotTest {
  protected:
    void through(const Door& door) {
        const auto map = door.map();
        beginOn(map, lab::parseWorld("map file=door.map\npeoplebot\n", "door.lab",
                                     [&](const std::string& /*file*/) { return map; }));
    }
    /// The world of small.map.
    static lab::WorldDescription smallWorld() {
        lab::WorldDescription world;
        world.boxes = {{.x = 4, .y = 1.5, .dx = 0.2, .dy = 3, .height = 1.5},
                       {.x = 6.5, .y = 3.6, .dx = 3, .dy = 0.2, .height = 1.5},
                       {.x = 2.6, .y = 5.2, .dx = 1.6, .dy = 1.59, .height = 1.5}};
        world.robots = {{.x = 1.5, .y = 3}};
        return world;
    }
    void begin(const lab::WorldDescription& world, MapPose off = {},
               const std::string& map = "robots/peoplebot/testdata/small.map", double spread_mm = 150,
               double spread_deg = 6) {
        std::ostringstream text;
        text << std::ifstream(map).rdbuf();
        beginOn(text.str(), world, off, spread_mm, spread_deg);
    }
    void beginOn(const std::string& map, const lab::WorldDescription& world, MapPose off = {},
                 double spread_mm = 150, double spread_deg = 6) {
        plan_ = std::make_shared<const FloorPlan>(mapper3::parseMap(map, "map"));
        start(world, {.seed = 7, .noise = 1});
        run(0.5);  // the first scans
        const auto& home = (plan_->map().homes.empty() ? plan_->map().docks : plan_->map().homes).at(0);
        localisation_ = std::make_unique<Localisation>(
            plan_,
            Localisation::Start{.pose = {home.at.x_mm + off.x_mm, home.at.y_mm + off.y_mm,
                                         home.heading_deg.value_or(0) + off.heading_deg},
                                .spread_mm = spread_mm,
                                .spread_deg = spread_deg},
            robot());
    }
    /// To each goal of a world's map in turn; which could not be reached.
    std::vector<std::string> everyGoal(const std::string& world) {
        begin(lab::loadWorld("lab/worlds/" + world + ".lab"), {}, "lab/worlds/" + world + ".map");
        std::vector<std::string> refused;
        for (const auto& goal : plan_->map().goals) {
            auto reason = Navigation::objection({.destination = goal.name}, *plan_);
            if (reason.empty()) {
                const auto end = go(goal.name, 400);
                if (end.outcome == Outcome::Done) {
                    EXPECT_LT(arrival_mm_, 200) << goal.name;
                    EXPECT_LT(localisationError_mm(), 120) << goal.name;
                    continue;
                }
                reason = end.reason;
            }
            fmt::print("\"{}\" refused: {}\n", goal.name, reason);
            refused.push_back(goal.name);
        }
        EXPECT_EQ(touched(), "");
        EXPECT_EQ(bumps_, 0);
        return refused;
    }
    MotionStep go(const std::string& goal, double velocity = 300) {
        worst_mm_ = 0;
        Located motion{Navigation(
                           {.destination = goal, .velocity_mm_s = velocity}, plan_, rules_,
                           [this] { return localisation_->estimate(); }, lab_->now()),
                       *localisation_,
                       [this](const auto& /*robot*/) {
                           worst_mm_ = std::max(worst_mm_, localisationError_mm());
                           if (meanwhile_) meanwhile_();
                       },
                       ""};
        const auto begun = lab_->age();
        const auto end = perform(motion, std::chrono::seconds{240});
        const auto truth = lab_->truth(0);
        const auto at = plan_->map().goal(goal)->at;
        arrival_mm_ = std::hypot(truth.x_m * 1000 - at.x_mm, truth.y_m * 1000 - at.y_mm);
        localisation_->update(robot());
        fmt::print(
            "to \"{}\": {:.1f} s, arrival error {:.0f} mm, localisation error {:.0f} mm, {:.1f} deg (worst "
            "{:.0f} mm), nearest {:.0f} mm, {} plans, fit "
            "{:.2f} {}\n{}",
            goal, std::chrono::duration<double>(lab_->age() - begun).count(), arrival_mm_,
            localisationError_mm(),
            std::remainder(localisation_->estimate().pose.heading_deg - truth.theta_deg, 360), worst_mm_,
            nearest_mm_, motion.navigation.plans(), localisation_->estimate().fit, end.reason, motion.news);
        return end;
    }
    double localisationError_mm() {
        const auto pose = localisation_->estimate().pose;
        const auto truth = lab_->truth(0);
        return std::hypot(pose.x_mm - truth.x_m * 1000, pose.y_mm - truth.y_m * 1000);
    }

    std::shared_ptr<const fuzzy::Engine> rules_ = loadNavigationRules("robots/peoplebot/navigation.rules");
    std::shared_ptr<const FloorPlan> plan_;
    std::unique_ptr<Localisation> localisation_;
    std::function<void()> meanwhile_;  // at each news of the robot
    double worst_mm_ = 0;
    double arrival_mm_ = 0;
};

TEST_F(NavigationPhysicsTest, ReachesEveryReachableGoalOfTheMapAndRefusesTheOthers) {
    begin(smallWorld(), {100, -80, 4});
    for (const auto& goal : plan_->map().goals) {
        if (!Navigation::objection({.destination = goal.name}, *plan_).empty()) continue;
        const auto end = go(goal.name);
        if (goal.name == "walled in") {
            EXPECT_EQ(end.outcome, Outcome::Failed);
            EXPECT_THAT(end.reason, HasSubstr("cannot be reached: no way leads there"));
            continue;
        }
        EXPECT_EQ(end.outcome, Outcome::Done) << goal.name << ": " << end.reason;
        EXPECT_LT(arrival_mm_, 200) << goal.name;
        EXPECT_LT(localisationError_mm(), 120) << goal.name;
        if (goal.heading_deg) {
            EXPECT_NEAR(std::remainder(lab_->truth(0).theta_deg - *goal.heading_deg, 360), 0, 6) << goal.name;
        }
    }
    EXPECT_EQ(touched(), "");
    EXPECT_GT(nearest_mm_, 20);
}

TEST_F(NavigationPhysicsTest, GoesRoundABoxThatIsNotOnTheMap) {
    auto world = smallWorld();
    world.boxes.push_back({.x = 2.9, .y = 3.4, .dx = 0.5, .dy = 0.5, .height = 0.6});
    begin(world);
    const auto end = go("north east");
    EXPECT_EQ(end.outcome, Outcome::Done) << end.reason;
    EXPECT_LT(arrival_mm_, 200);
    EXPECT_EQ(touched(), "");
    EXPECT_GT(nearest_mm_, 20);
}

TEST_F(NavigationPhysicsTest, WhatIsPutBeforeItWhileItDrivesIsNotTouched) {
    begin(smallWorld());
    int put = 0;
    // At full speed, 0.6 m before its bumper, and once more on its way round.
    meanwhile_ = [&] {
        const auto truth = lab_->truth(0);
        if (put >= 2 || truth.speed_m_s < 0.35 || truth.x_m < 2.2 + 2.4 * put) return;
        const double a = truth.theta_deg * std::numbers::pi / 180;
        lab_->physics().addObstacle({.name = "put" + std::to_string(put++),
                                     .x = truth.x_m + 1.0 * std::cos(a),
                                     .y = truth.y_m + 1.0 * std::sin(a),
                                     .dx = 0.3,
                                     .dy = 0.3,
                                     .height = 0.8});
    };
    const auto end = go("north east", 400);
    EXPECT_GE(put, 1);
    EXPECT_EQ(touched(), "");
    EXPECT_TRUE(end.outcome == Outcome::Done || end.reason.find("blocked") != std::string::npos)
        << end.reason;
}

TEST_F(NavigationPhysicsTest, StopsBeforeABlockedDoorAndGivesUpWithTheReason) {
    auto world = smallWorld();
    world.boxes.push_back({.x = 4.55, .y = 3.25, .dx = 1.0, .dy = 0.3, .height = 0.6, .theta = 29});
    begin(world);
    const auto end = go("south east");
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_THAT(end.reason, HasSubstr("the way to \"south east\" is blocked"));
    EXPECT_EQ(touched(), "");
    EXPECT_GT(nearest_mm_, 20);
}

TEST_F(NavigationPhysicsTest, ReachesTheGoalsOfTheSmallRoomOfTheLaboratory) {
    EXPECT_THAT(everyGoal("room"), ::testing::UnorderedElementsAre("Booth", "Wet floor"));
}

TEST_F(NavigationPhysicsTest, InTheTransportLaboratoryItTurnsOnlyWhereTheOtherRobotLeavesRoom) {
    // The other robot stands half a metre from this goal: a robot on it that turns its back to the other
    // touches it.
    EXPECT_THAT(everyGoal("transport"),
                ::testing::AnyOf(::testing::IsEmpty(), ::testing::ElementsAre("West table 2")));
}

TEST_F(NavigationPhysicsTest, ReachesTheGoalsOfTheBuildingOfTheLaboratory) {
    if (std::getenv("AXON_LONG_TRIALS") == nullptr)
        GTEST_SKIP() << "takes half a minute; AXON_LONG_TRIALS=1 runs it";
    EXPECT_THAT(everyGoal("corridors"), ::testing::UnorderedElementsAre("Stairs", "Shaft"));
}

/// A building, and which of its goals nobody can reach.
using Building = std::pair<const char*, std::vector<std::string>>;
class NavigationInBuildingsTest : public NavigationPhysicsTest,
                                  public ::testing::WithParamInterface<Building> {};

TEST_P(NavigationInBuildingsTest, ReachesTheGoals) {
    if (std::getenv("AXON_LONG_TRIALS") == nullptr)
        GTEST_SKIP() << "all buildings take a minute; AXON_LONG_TRIALS=1 runs them";
    EXPECT_THAT(everyGoal(GetParam().first), ::testing::UnorderedElementsAreArray(GetParam().second));
}

INSTANTIATE_TEST_SUITE_P(Laboratory, NavigationInBuildingsTest,
                         ::testing::Values(Building{"offices", {}}, Building{"openplan", {}},
                                           Building{"ward", {}}, Building{"workshop", {"Pit"}},
                                           Building{"villa", {"Chimney"}}));

TEST_F(NavigationPhysicsTest, FurnitureBeforeAWallIsNotTakenForTheWall) {
    // A bookcase hides half of the wall that the robot drives towards; no other wall tells how far it has
    // come.
    begin(lab::loadWorld("lab/worlds/villa.lab"), {}, "lab/worlds/villa.map");
    const auto end = go("Library", 400);
    EXPECT_EQ(end.outcome, Outcome::Done) << end.reason;
    EXPECT_LT(arrival_mm_, 200);
    EXPECT_LT(localisationError_mm(), 120);
    EXPECT_EQ(touched(), "");
}

TEST_F(NavigationPhysicsTest, PassesDoorsThatItMeetsAtAnAngle) {
    // At the first two arcs of echoes from a jamb reach across its way; at the last the short way to what it
    // steers for leads it so near to a jamb that it stands before it.
    for (const Door& door : {Door{883, 60, 26, 12, 131, 2499, 1647}, Door{903, 55, 33, 0, 142, 1508, 1649},
                             Door{810, 57, 10, 0, 232, 1638, 1743}}) {
        through(door);
        const auto end = go("beyond", 400);
        EXPECT_EQ(end.outcome, Outcome::Done) << end.reason;
        EXPECT_LT(arrival_mm_, 200);
        EXPECT_EQ(touched(), "");
    }
}

TEST_F(NavigationPhysicsTest, FindsItselfFromARoughStart) {
    begin(smallWorld(), {300, -250, 14}, "robots/peoplebot/testdata/small.map", 350, 15);
    const auto end = go("north east");
    EXPECT_EQ(end.outcome, Outcome::Done) << end.reason;
    EXPECT_LT(arrival_mm_, 200);
    EXPECT_EQ(touched(), "");
}

TEST_F(NavigationPhysicsTest, AWrongStartIsNoticed) {
    begin(smallWorld(), {5000, 2000, 120});
    const auto end = go("west");
    EXPECT_EQ(end.outcome, Outcome::Failed);
    EXPECT_THAT(end.reason,
                ::testing::AnyOf(HasSubstr("does the robot stand there?"), HasSubstr("lost itself")));
    EXPECT_EQ(touched(), "");
}

TEST_F(NavigationPhysicsTest, WithoutALaserItDoesNotMove) {
    has_laser_ = false;
    begin(smallWorld());
    const auto end = go("west");
    EXPECT_THAT(end.reason, HasSubstr("the laser sends no readings"));
    EXPECT_NEAR(lab_->truth(0).x_m, 1.5, 0.01);
}

}  // namespace
}  // namespace axon::peoplebot
