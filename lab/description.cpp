// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/description.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <numbers>

#include "lab/peoplebot_geometry.hpp"

namespace axon::lab {
namespace {

using Fields = std::map<std::string, double*, std::less<>>;

double parseNumber(std::string_view what, std::string_view key, std::string_view text) {
    double value = 0;
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
    if (parsed.ec != std::errc{} || parsed.ptr != text.data() + text.size() || !std::isfinite(value)) {
        throw BadDescription(
            fmt::format("{}: {}={}: expected a number, for example {}=1.5", what, key, text, key));
    }
    return value;
}

/// Calls set(key, value) for each "key=value" of a comma-separated list.
template <class F>
void forEachPair(std::string_view what, std::string_view text, F&& set) {
    while (!text.empty()) {
        const auto comma = std::min(text.find(','), text.size());
        const auto pair = text.substr(0, comma);
        const auto equals = pair.find('=');
        if (equals == std::string_view::npos) {
            throw BadDescription(
                fmt::format("{}: \"{}\": expected key=value pairs, separated by commas", what, pair));
        }
        set(pair.substr(0, equals), pair.substr(equals + 1));
        text.remove_prefix(std::min(comma + 1, text.size()));
    }
}

void parseFields(std::string_view what, std::string_view text, const Fields& fields) {
    forEachPair(what, text, [&](std::string_view key, std::string_view value) {
        const auto field = fields.find(key);
        if (field == fields.end()) {
            std::string known;
            for (const auto& [name, number] : fields) known += (known.empty() ? "" : ", ") + name;
            throw BadDescription(fmt::format("{}: unknown key \"{}\": expected one of {}", what, key, known));
        }
        *field->second = parseNumber(what, key, value);
    });
}

/// The smallest distance of a point from a turned rectangle.
double distanceTo(double x, double y, double cx, double cy, double dx, double dy, double theta) {
    const double a = theta * std::numbers::pi / 180;
    const double u = std::cos(a) * (x - cx) + std::sin(a) * (y - cy);
    const double v = -std::sin(a) * (x - cx) + std::cos(a) * (y - cy);
    return std::hypot(std::max(0.0, std::abs(u) - dx / 2), std::max(0.0, std::abs(v) - dy / 2));
}

void requireInside(const WorldDescription& world, std::string_view what, double x, double y) {
    if (x >= 0 && y >= 0 && x <= world.room_x && y <= world.room_y) return;
    throw BadDescription(fmt::format("{} at x={}, y={} is outside of the room: expected 0 to {} and 0 to {}",
                                     what, x, y, world.room_x, world.room_y));
}

constexpr double metres(double mm) {
    return mm / 1000;
}

std::string robotXml(std::size_t index, const RobotPlacement& robot) {
    using namespace peoplebot;
    const double radius = metres(kWheelRadius_mm);
    const double bumper = metres(kHalfLength_mm - std::abs(kCentre_mm));  // from the axle to the front
    const double rear_centre = metres(2 * kCentre_mm);
    const double half_chord = bumper * std::sin(kBumperPitch_deg / 2 * std::numbers::pi / 180);
    const std::string r = fmt::format("r{}_", index);
    // The body's frame is at the height of the axle; heights below are above the floor, hence "- radius".
    std::string xml = fmt::format(
        R"(<body name="{0}base" pos="{1} {2} {3}" euler="0 0 {4}"><freejoint/>
<inertial pos="-0.03 0 0.22" mass="{5}" diaginertia="1.6 1.7 0.45"/>
<geom class="hull" type="box" pos="-0.045 0 {6}" size="0.19 0.14 0.09"/>
<geom class="hull" type="box" pos="-0.1 0 {7}" size="0.09 0.12 0.36"/>
<geom class="hull" type="box" pos="-0.045 0 {8}" size="0.2 0.17 0.035"/>
<geom class="caster" pos="-0.2 0 {9}"/>
<geom class="caster" pos="0.14 0 {10}"/>
)",
        r, robot.x, robot.y, radius, robot.theta, kMass_kg - 3, 0.15 - radius, 0.6 - radius,
        metres(kHeight_mm) - 0.035 - radius, 0.0375 - radius, 0.0375 - radius + 0.004);
    for (int side = 0; side < 2; ++side) {
        for (int segment = 0; segment < kBumperSegments; ++segment) {
            // Clockwise from the front left, the rear ones from the rear right.
            const double angle = (side == 0 ? 0 : 180) + (2 - segment) * kBumperPitch_deg;
            const double a = angle * std::numbers::pi / 180;
            xml += fmt::format(
                R"(<geom name="{}{}bumper{}" class="bumper" pos="{:.5f} {:.5f} {:.5f}" euler="0 0 {}" size="0.007 {:.5f} 0.04"/>
)",
                r, side == 0 ? "front" : "rear", segment + 1,
                (side == 0 ? 0 : rear_centre) + (bumper - 0.007) * std::cos(a),
                (bumper - 0.007) * std::sin(a), 0.1 - radius, angle, half_chord);
        }
    }
    for (const char* side : {"left", "right"}) {
        // Half of the track, 2 / DiffConvFactor (arcos_server.hpp).
        const double y = (side[0] == 'l' ? 1 : -1) / 0.006 / 1000;
        xml += fmt::format(
            R"(<body pos="0 {0:.5f} 0"><joint name="{1}{2}" type="hinge" axis="0 1 0" armature="0.05" damping="0.01" frictionloss="0.05"/>
<geom class="wheel" fromto="0 -0.018 0 0 0.018 0" size="{3}"/></body>
)",
            y, r, side, radius);
    }
    return xml + "</body>\n";
}

}  // namespace

WorldDescription defaultWorld() {
    WorldDescription world;
    world.boxes = {{.x = 5.2, .y = 1.0},
                   {.x = 6.4, .y = 5.2, .dx = 0.8, .dy = 0.4, .height = 1.2},
                   {.x = 3.4, .y = 5.4}};
    world.tables = {{.x = 1.0, .y = 5.4, .dx = 1.4, .dy = 0.8}};
    return world;
}

Box parseBox(std::string_view text) {
    Box box;
    parseFields("--box", text,
                {{"x", &box.x},
                 {"y", &box.y},
                 {"dx", &box.dx},
                 {"dy", &box.dy},
                 {"height", &box.height},
                 {"theta", &box.theta}});
    return box;
}

Table parseTable(std::string_view text) {
    Table table;
    parseFields("--table", text,
                {{"x", &table.x},
                 {"y", &table.y},
                 {"dx", &table.dx},
                 {"dy", &table.dy},
                 {"height", &table.height},
                 {"theta", &table.theta}});
    return table;
}

RobotPlacement parseRobot(std::string_view text, std::size_t index) {
    // In a column along the left wall, from the middle outwards: 3, 1.8, 4.2 ...
    RobotPlacement robot;
    const double step = 1.2 * static_cast<double>((index + 1) / 2);
    robot.x = 1.5;
    robot.y = 3 + (index % 2 == 0 ? step : -step);
    std::string rest;
    forEachPair("--robot", text, [&](std::string_view key, std::string_view value) {
        if (key == "name") {
            const bool plain = !value.empty() && value.size() <= 40 &&
                               std::all_of(value.begin(), value.end(), [](unsigned char c) {
                                   return c > 0x20 && c < 0x7F && c != '"' && c != '\\' && c != '=';
                               });
            if (!plain) {
                throw BadDescription(fmt::format(
                    "--robot: name={}: expected 1 to 40 visible characters without quotes", value));
            }
            robot.name = value;
        } else if (key == "port") {
            const double port = parseNumber("--robot", key, value);
            if (port < 0 || port > 65535 || port != std::floor(port)) {
                throw BadDescription(
                    fmt::format("--robot: port={}: expected 1 to 65535, or 0 for one that is free", value));
            }
            robot.port = static_cast<int>(port);
        } else {
            parseFields("--robot", fmt::format("{}={}", key, value),
                        {{"x", &robot.x}, {"y", &robot.y}, {"theta", &robot.theta}});
        }
    });
    return robot;
}

void validate(const WorldDescription& world) {
    if (world.room_x < 1 || world.room_y < 1 || world.room_x > 200 || world.room_y > 200) {
        throw BadDescription(
            fmt::format("a room of {} x {} m: expected sides from 1 to 200 m", world.room_x, world.room_y));
    }
    for (const auto& box : world.boxes) {
        requireInside(world, "a box", box.x, box.y);
        if (box.dx <= 0 || box.dy <= 0 || box.height <= 0)
            throw BadDescription("a box needs dx, dy and height above 0");
    }
    for (const auto& table : world.tables) {
        requireInside(world, "a table", table.x, table.y);
        if (table.dx <= 0.1 || table.dy <= 0.1 || table.height <= 0.1) {
            throw BadDescription("a table needs dx, dy and height above 0.1");
        }
    }
    const double swing = metres(peoplebot::kSwingRadius_mm);
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        const auto& robot = world.robots[i];
        const auto stuck = [&robot](std::string_view in) {
            return BadDescription(
                fmt::format("robot {} at x={}, y={} stands in {}: give it x= and y= with {} m of room around",
                            robot.name, robot.x, robot.y, in, metres(peoplebot::kSwingRadius_mm)));
        };
        requireInside(world, "robot " + robot.name, robot.x, robot.y);
        if (std::min({robot.x, robot.y, world.room_x - robot.x, world.room_y - robot.y}) < swing)
            throw stuck("a wall");
        for (const auto& b : world.boxes) {
            if (distanceTo(robot.x, robot.y, b.x, b.y, b.dx, b.dy, b.theta) < swing) throw stuck("a box");
        }
        for (const auto& t : world.tables) {
            if (distanceTo(robot.x, robot.y, t.x, t.y, t.dx, t.dy, t.theta) < swing) throw stuck("a table");
        }
        for (std::size_t k = 0; k < i; ++k) {
            if (std::hypot(robot.x - world.robots[k].x, robot.y - world.robots[k].y) < 2 * swing) {
                throw stuck("robot " + world.robots[k].name);
            }
        }
    }
}

std::string mjcf(const WorldDescription& world) {
    constexpr double kWall = 0.1;
    constexpr double kWallHeight = 2;
    std::string xml = R"(<mujoco model="axon-lab">
<compiler angle="degree" eulerseq="xyz"/>
<option timestep="0.004"/>
<default>
<default class="obstacle"><geom type="box" group="0" friction="0.5"/></default>
<default class="hull"><geom group="1" friction="0.4"/></default>
<!-- margin and gap: the switch closes 3 mm before the rubber bears, and stays closed when the robot rebounds a little -->
<default class="bumper"><geom type="box" group="1" friction="0.4" margin="0.003" gap="0.003"/></default>
<default class="wheel"><geom type="cylinder" group="4" friction="0.9" mass="1.5"/></default>
<!-- priority: otherwise the floor's friction applies to a frictionless caster, and the robot slips -->
<default class="caster"><geom type="sphere" size="0.0375" group="4" condim="1" priority="2"/></default>
</default>
<worldbody>
<geom name="floor" type="plane" size="0 0 1" group="3" friction="0.9"/>
)";
    const auto block = [&xml](double x, double y, double z, double hx, double hy, double hz, double theta) {
        xml += fmt::format(R"(<geom class="obstacle" pos="{} {} {}" size="{} {} {}" euler="0 0 {}"/>)"
                           "\n",
                           x, y, z, hx, hy, hz, theta);
    };
    const double w = world.room_x;
    const double h = world.room_y;
    block(w / 2, -kWall, kWallHeight / 2, w / 2 + kWall, kWall, kWallHeight / 2, 0);
    block(w / 2, h + kWall, kWallHeight / 2, w / 2 + kWall, kWall, kWallHeight / 2, 0);
    block(-kWall, h / 2, kWallHeight / 2, kWall, h / 2 + kWall, kWallHeight / 2, 0);
    block(w + kWall, h / 2, kWallHeight / 2, kWall, h / 2 + kWall, kWallHeight / 2, 0);
    for (const auto& box : world.boxes)
        block(box.x, box.y, box.height / 2, box.dx / 2, box.dy / 2, box.height / 2, box.theta);
    for (const auto& t : world.tables) {
        constexpr double kTop = 0.015;
        constexpr double kLeg = 0.025;
        block(t.x, t.y, t.height - kTop, t.dx / 2, t.dy / 2, kTop, t.theta);
        const double a = t.theta * std::numbers::pi / 180;
        for (const int sx : {-1, 1}) {
            for (const int sy : {-1, 1}) {
                const double u = sx * (t.dx / 2 - kLeg);
                const double v = sy * (t.dy / 2 - kLeg);
                block(t.x + std::cos(a) * u - std::sin(a) * v, t.y + std::sin(a) * u + std::cos(a) * v,
                      t.height / 2 - kTop, kLeg, kLeg, t.height / 2 - kTop, t.theta);
            }
        }
    }
    for (std::size_t i = 0; i < world.robots.size(); ++i) xml += robotXml(i, world.robots[i]);
    xml += "</worldbody>\n<actuator>\n";
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        for (const char* side : {"left", "right"}) {
            xml += fmt::format(
                R"(<velocity name="r{0}_{1}" joint="r{0}_{1}" kv="8" forcelimited="true" forcerange="-{2} {2}"/>)"
                "\n",
                i, side, peoplebot::kMotorTorque_nm);
        }
    }
    return xml + "</actuator>\n</mujoco>\n";
}

}  // namespace axon::lab
