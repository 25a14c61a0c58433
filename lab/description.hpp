// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace axon::lab {

/// A world in the terms of its user: metres and degrees, the room's corner at the origin, x to the right, y
/// up, z above the floor. Plain values; mjcf() below turns them into a model.
struct Box {
    double x = 0, y = 0;  ///< centre
    double dx = 0.5, dy = 0.5, height = 0.6;
    double theta = 0;
};

struct Table {
    double x = 0, y = 0;
    double dx = 1.2, dy = 0.8, height = 0.74;
    double theta = 0;
};

struct RobotPlacement {
    std::string name = "PeopleBot";
    double x = 0, y = 0, theta = 0;
    std::optional<int> port;  ///< 0: one that is free; none: the next after the robot's before it
};

struct WorldDescription {
    double room_x = 8, room_y = 6;
    std::vector<Box> boxes;
    std::vector<Table> tables;
    std::vector<RobotPlacement> robots;
};

/// What a user got wrong in describing a world; the message says what was expected.
class BadDescription : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// The default world: a room of 8 x 6 m with three boxes and a table along the walls; no robot yet.
WorldDescription defaultWorld();

/// "x=5,y=1.2,dx=0.6": keys are the members' names; what is not given keeps its default. Throw
/// BadDescription.
Box parseBox(std::string_view text);
Table parseTable(std::string_view text);
/// Places that are not given follow from how many robots there are already.
RobotPlacement parseRobot(std::string_view text, std::size_t index);

/// Throws BadDescription where something stands outside the room or in something else, or the room is too
/// small.
void validate(const WorldDescription& world);

/// The world as MuJoCo's XML. Bodies, joints and geoms of robot k have names that begin with "r<k>_";
/// physics.cpp finds them by these names. Geometry groups say who sees what: 0 obstacles and 1 robot hulls
/// are seen by sonars, 3 is the floor and 4 wheels and casters, which are not.
std::string mjcf(const WorldDescription& world);

}  // namespace axon::lab
