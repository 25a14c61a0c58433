// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <functional>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "lab/device.hpp"

namespace axon::lab {

/// A world in the terms of its user: metres and degrees, the room's corner at the origin, x to the right, y
/// up, z above the floor. Plain values; sceneOf() below turns them into a model. What has a name is called by
/// it in ground truth and by whoever moves it; names of tables, boxes and objects are unique in a world.
struct Box {
    std::string name{};   ///< empty: box, box2 ...
    double x = 0, y = 0;  ///< centre
    double z = 0;         ///< of its underside: a box on a table is a platform
    double dx = 0.5, dy = 0.5, height = 0.6;
    double theta = 0;
    bool glass = false;  ///< sonars see it, the laser looks through
};

struct Table {
    std::string name{};  ///< empty: table, table2 ...
    double x = 0, y = 0;
    double dx = 1.2, dy = 0.8, height = 0.74;
    double theta = 0;
};

/// A free body: it can be grasped, carried and knocked over.
struct Object {
    enum class Shape { Box, Cylinder };
    std::string name{};  ///< empty: object, object2 ...
    std::string colour = "red";
    Shape shape = Shape::Box;
    double x = 0, y = 0;
    std::optional<double>
        z;  ///< of its underside; none: on whatever table or box is there, else on the floor
    double dx = 0.028, dy = 0.028, dz = 0.08;  ///< a cylinder's diameter is dx
    double mass = 0.06;                        ///< kg
    double theta = 0;
};

struct RobotPlacement {
    std::string name = "PeopleBot";
    double x = 0, y = 0, theta = 0;
    std::optional<int> port;  ///< 0: one that is free; none: the next after the robot's before it
};

struct Wall {
    double x1 = 0, y1 = 0, x2 = 0, y2 = 0;
};

struct WorldDescription {
    double room_x = 8, room_y = 6;
    double room_left = 0, room_bottom = 0;     ///< the corner, other than the origin only where a map says so
    bool room_walls = true;                    ///< whether the room's rectangle has walls
    std::vector<Wall> walls;                   ///< further ones, from a map
    std::vector<std::array<double, 3>> homes;  ///< x, y, theta from a map: for robots without a place
    std::vector<Box> boxes;
    std::vector<Table> tables;
    std::vector<Object> objects;
    std::vector<RobotPlacement> robots;
    std::vector<DevicePlacement> devices;
};

/// What a user got wrong in describing a world; the message says what was expected.
class BadDescription : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// A room of 8 x 6 m with three boxes and a table along the walls; no robot yet.
WorldDescription defaultWorld();

/// "x=5,y=1.2,dx=0.6": keys are the members' names; what is not given keeps its default. Throw
/// BadDescription.
Box parseBox(std::string_view text);
Table parseTable(std::string_view text);
Object parseObject(std::string_view text);
DevicePlacement parseDevice(const DeviceKind& kind, std::string_view text);
/// Places that are not given follow from how many robots there are already.
RobotPlacement parseRobot(std::string_view text, std::size_t index);

/// A world from a file: one item a line, its keys after it, separated by blanks; from # on a line is a
/// comment.
///     room x=8 y=6
///     map file=corridors.map          walls from a Mapper3 map, beside the file; its frame is the world's,
///     its
///                                     homes are the places of robots that have none
///     table name=west x=0.6 y=3 dx=0.8 dy=3 height=0.66
///     box name=platform x=0.6 y=3.3 z=0.66 dx=0.12 dy=0.12 height=0.1
///     glass x=4 y=2 dx=1.5 theta=90    a pane: 20 mm thick and 2 m high where dy and height are not given
///     object name=red colour=red shape=box x=0.6 y=3.3 dx=0.028 dy=0.028 dz=0.08 mass=0.06
///     peoplebot name=PeopleBot x=2 y=3 theta=180 port=8101
///     cyton name=Cyton x=0.7 y=3 theta=0 port=8201       and likewise every other DeviceKind
/// Validated. Throws BadDescription with the file's name and the line. `read` gives the contents of a file
/// that the world names.
using ReadFile = std::function<std::string(const std::string& file)>;
WorldDescription parseWorld(std::string_view text, std::string_view name, const ReadFile& read);
/// The same from the disk; a map is looked for beside the file.
WorldDescription loadWorld(const std::string& path);

/// Gives names to what has none, and heights to what stands on something. For worlds that were put together
/// by hand; parseWorld() and Physics do it themselves.
void complete(WorldDescription& world);

/// Throws BadDescription where something stands outside the room or in something else, or the room is too
/// small.
void validate(const WorldDescription& world);

/// The colours that objects can have, as red, green and blue from 0 to 1; nothing for others.
std::optional<std::array<double, 3>> colourNamed(std::string_view name);

/// A world as a model, and what its parts are.
struct Scene {
    /// What a part of the model belongs to.
    struct Owner {
        enum class Kind { Floor, Fixed, Obstacle, Object, Robot, Device };
        Kind kind = Kind::Floor;
        std::size_t index = 0;  ///< in the world's description; of what stands fast in `fixed`
        unsigned front = 0;     ///< of a robot: its bumper segments, bit 0 is segment 1
        unsigned rear = 0;
    };

    std::string xml;  ///< MuJoCo's
    /// By the name of the geom: all that belong to no body, and the bumpers.
    std::map<std::string, Owner> geoms;
    /// By the name of the body that stands in the world: it and all that is below it. Everything that moves
    /// is in one of them.
    std::map<std::string, Owner> bodies;
    std::vector<std::string> fixed;    ///< names of walls, tables and boxes as ground truth tells them
    std::vector<DeviceModel> robots;   ///< PeopleBots, in the order of peoplebot::kMotors and so on
    std::vector<DeviceModel> devices;  ///< as their kinds describe them, without the MJCF
    std::vector<std::string> objects;  ///< bodies
    /// kObstacles spare boxes under the floor, each a mocap body and a geom.
    std::vector<std::pair<std::string, std::string>> obstacles;
};

/// The world, completed, as a model. Geometry groups say who sees what: 0 obstacles, 1 robot hulls and
/// devices and 2 objects are seen by range sensors, 3 is the floor and 4 wheels, casters, grippers and camera
/// heads, which are not; 5 is glass, which the laser does not see. Who renders must switch all groups on.
/// Besides the robots' cameras there is kOverview, which sees the whole room.
inline constexpr int kObstacles = 6;
inline constexpr const char* kOverview = "overview";
Scene sceneOf(const WorldDescription& world);

}  // namespace axon::lab
