// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/description.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <map>
#include <numbers>
#include <set>
#include <sstream>
#include <utility>
#include <variant>

#include "lab/gripper_control.hpp"
#include "lab/peoplebot_geometry.hpp"
#include "robots/arcos/vcc4.hpp"
#include "robots/mapper3/map.hpp"

namespace axon::lab {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

double parseNumber(std::string_view what, std::string_view key, std::string_view text) {
    double value = 0;
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
    if (parsed.ec != std::errc{} || parsed.ptr != text.data() + text.size() || !std::isfinite(value)) {
        throw BadDescription(
            fmt::format("{}: {}={}: expected a number, for example {}=1.5", what, key, text, key));
    }
    return value;
}

int parsePort(std::string_view what, std::string_view key, std::string_view text) {
    const double port = parseNumber(what, key, text);
    if (port < 0 || port > 65535 || port != std::floor(port)) {
        throw BadDescription(
            fmt::format("{}: port={}: expected 1 to 65535, or 0 for one that is free", what, text));
    }
    return static_cast<int>(port);
}

std::string parseName(std::string_view what, std::string_view key, std::string_view text) {
    const bool plain =
        !text.empty() && text.size() <= 40 && std::all_of(text.begin(), text.end(), [](unsigned char c) {
            return c > 0x20 && c < 0x7F && c != '"' && c != '\\' && c != '=';
        });
    if (!plain) {
        throw BadDescription(
            fmt::format("{}: {}={}: expected 1 to 40 visible characters without quotes", what, key, text));
    }
    return std::string(text);
}

/// Where the value of a key goes.
struct Port {
    std::optional<int>* value;
};
using Target = std::variant<double*, std::optional<double>*, std::string*, Port, Object::Shape*>;
using Fields = std::map<std::string, Target, std::less<>>;

void parseValue(std::string_view what, std::string_view key, std::string_view text, const Target& target) {
    if (const auto* number = std::get_if<double*>(&target)) {
        **number = parseNumber(what, key, text);
    } else if (const auto* optional = std::get_if<std::optional<double>*>(&target)) {
        **optional = parseNumber(what, key, text);
    } else if (const auto* name = std::get_if<std::string*>(&target)) {
        **name = parseName(what, key, text);
    } else if (const auto* port = std::get_if<Port>(&target)) {
        *port->value = parsePort(what, key, text);
    } else {
        if (text != "box" && text != "cylinder")
            throw BadDescription(fmt::format("{}: {}={}: expected box or cylinder", what, key, text));
        *std::get<Object::Shape*>(target) = text == "box" ? Object::Shape::Box : Object::Shape::Cylinder;
    }
}

/// "key=value" pairs, separated by commas or, in files, by blanks.
void parseFields(std::string_view what, std::string_view text, char separator, const Fields& fields) {
    std::set<std::string, std::less<>> seen;
    while (!text.empty()) {
        const auto end = std::min(text.find(separator), text.size());
        const auto pair = text.substr(0, end);
        text.remove_prefix(std::min(end + 1, text.size()));
        if (pair.empty() && separator == ' ') continue;
        const auto equals = pair.find('=');
        if (equals == std::string_view::npos) {
            throw BadDescription(fmt::format("{}: \"{}\": expected key=value pairs, separated by {}", what,
                                             pair, separator == ' ' ? "blanks" : "commas"));
        }
        const auto key = pair.substr(0, equals);
        const auto field = fields.find(key);
        if (field == fields.end()) {
            std::string known;
            for (const auto& [name, target] : fields) known += (known.empty() ? "" : ", ") + name;
            throw BadDescription(fmt::format("{}: unknown key \"{}\": expected one of {}", what, key, known));
        }
        if (!seen.emplace(key).second) throw BadDescription(fmt::format("{}: {}= twice", what, key));
        parseValue(what, key, pair.substr(equals + 1), field->second);
    }
}

Fields fieldsOf(Box& b) {
    return {{"name", &b.name}, {"x", &b.x},   {"y", &b.y},           {"z", &b.z},
            {"dx", &b.dx},     {"dy", &b.dy}, {"height", &b.height}, {"theta", &b.theta}};
}
Fields fieldsOf(Table& t) {
    return {{"name", &t.name}, {"x", &t.x},           {"y", &t.y},        {"dx", &t.dx},
            {"dy", &t.dy},     {"height", &t.height}, {"theta", &t.theta}};
}
Fields fieldsOf(Object& o) {
    return {{"name", &o.name}, {"colour", &o.colour}, {"shape", &o.shape}, {"x", &o.x},
            {"y", &o.y},       {"z", &o.z},           {"dx", &o.dx},       {"dy", &o.dy},
            {"dz", &o.dz},     {"mass", &o.mass},     {"theta", &o.theta}};
}
Fields fieldsOf(RobotPlacement& r) {
    return {{"name", &r.name}, {"x", &r.x}, {"y", &r.y}, {"theta", &r.theta}, {"port", Port{&r.port}}};
}
Fields fieldsOf(DevicePlacement& d) {
    return {{"name", &d.name}, {"x", &d.x},         {"y", &d.y},
            {"z", &d.z},       {"theta", &d.theta}, {"port", Port{&d.port}}};
}

template <class Item>
Item parsed(std::string_view what, std::string_view text, char separator, Item item = {}) {
    parseFields(what, text, separator, fieldsOf(item));
    return item;
}

DevicePlacement usualPlacement(const DeviceKind& kind) {
    return {.kind = kind.word, .name = kind.label};
}

RobotPlacement robotAt(std::size_t index) {
    // In a column along the left wall, from the middle outwards: 3, 1.8, 4.2 ...
    RobotPlacement robot;
    const double step = 1.2 * static_cast<double>((index + 1) / 2);
    robot.x = 1.5;
    robot.y = 3 + (index % 2 == 0 ? step : -step);
    return robot;
}

std::set<std::string> withDeviceWords(std::set<std::string> words) {
    for (const auto& kind : deviceKinds()) words.insert(kind.word);
    return words;
}

const DeviceKind& kindOf(const DevicePlacement& device) {
    if (const auto* kind = deviceKind(device.kind)) return *kind;
    throw BadDescription(fmt::format("{} is of the kind \"{}\": expected one of {}", device.name, device.kind,
                                     fmt::join(withDeviceWords({}), ", ")));
}

/// The smallest distance of a point from a turned rectangle.
double distanceTo(double x, double y, double cx, double cy, double dx, double dy, double theta) {
    const double a = theta * kDegree;
    const double u = std::cos(a) * (x - cx) + std::sin(a) * (y - cy);
    const double v = -std::sin(a) * (x - cx) + std::cos(a) * (y - cy);
    return std::hypot(std::max(0.0, std::abs(u) - dx / 2), std::max(0.0, std::abs(v) - dy / 2));
}

double distanceTo(double x, double y, const Wall& w) {
    const double dx = w.x2 - w.x1;
    const double dy = w.y2 - w.y1;
    const double length2 = dx * dx + dy * dy;
    const double part =
        length2 == 0 ? 0 : std::clamp(((x - w.x1) * dx + (y - w.y1) * dy) / length2, 0.0, 1.0);
    return std::hypot(x - w.x1 - part * dx, y - w.y1 - part * dy);
}

/// The height of the highest surface over a place of the floor.
double surfaceAt(const WorldDescription& world, double x, double y) {
    double height = 0;
    for (const auto& t : world.tables) {
        if (distanceTo(x, y, t.x, t.y, t.dx, t.dy, t.theta) == 0) height = std::max(height, t.height);
    }
    for (const auto& b : world.boxes) {
        if (distanceTo(x, y, b.x, b.y, b.dx, b.dy, b.theta) == 0) height = std::max(height, b.z + b.height);
    }
    return height;
}

void requireInside(const WorldDescription& world, const std::string& what, double x, double y) {
    if (x >= world.room_left && y >= world.room_bottom && x <= world.room_left + world.room_x &&
        y <= world.room_bottom + world.room_y) {
        return;
    }
    throw BadDescription(
        fmt::format("{} at x={}, y={} is outside of the room: expected {} to {} and {} to {}", what, x, y,
                    world.room_left, world.room_left + world.room_x, world.room_bottom,
                    world.room_bottom + world.room_y));
}

constexpr double metres(double mm) {
    return mm / 1000;
}

/// Gripper and camera: what hangs on the base and moves by itself.
std::string robotPartsXml(const std::string& r, double radius) {
    using namespace peoplebot;
    constexpr double kStroke = GripperControl::kOpening_mm / 1000;
    const double half_thickness = metres(kPaddleHalfThickness_mm);
    std::string xml = fmt::format(
        R"(<body name="{0}lift" pos="0 0 {1}"><joint name="{0}lift" type="slide" axis="0 0 1" range="0 {2}" limited="true" armature="2" damping="230"/>
<geom class="part" type="box" pos="0.04 0 0" size="0.018 0.12 0.018" mass="1" rgba="0.2 0.2 0.22 1"/>
)",
        r, metres(kPaddleLowest_mm) - radius, metres(GripperControl::kLift_mm));
    for (const int side : {1, -1}) {
        const double middle = metres(kPaddleRear_mm + kPaddleTip_mm) / 2;
        // At zero the faces meet in the middle.
        xml += fmt::format(
            R"(<body name="{0}{1}paddle" pos="{2} {3} 0"><joint name="{0}{1}paddle" type="slide" axis="0 {4} 0" range="0 {5}" limited="true" armature="0.3" damping="30"/>
<geom name="{0}{1}paddle" class="paddle" size="{6} {7} {8}" mass="0.2"/></body>
)",
            r, side > 0 ? "left" : "right", middle, side * half_thickness, side, kStroke,
            metres(kPaddleTip_mm - kPaddleRear_mm) / 2, half_thickness, metres(kPaddleHalfHeight_mm));
    }
    xml += "</body>\n";
    xml += fmt::format(
        R"(<body name="{0}pan" pos="{1} 0 {2}"><joint name="{0}pan" type="hinge" axis="0 0 1" armature="0.01" damping="0.3"/>
<geom class="part" type="cylinder" pos="0 0 0.045" size="0.03 0.012" mass="0.1" rgba="0.3 0.3 0.32 1"/>
<body><joint name="{0}tilt" type="hinge" axis="0 -1 0" armature="0.01" damping="0.3"/>
<geom class="part" type="box" size="0.028 0.03 0.028" mass="0.2" rgba="0.15 0.15 0.17 1"/>
<camera name="{0}camera" pos="{3} 0 0" xyaxes="0 -1 0 0 0 1" fovy="{4:.4f}"/></body></body>
)",
        r, metres(kCameraX_mm), metres(kCameraHeight_mm) - radius, metres(kCameraLens_mm),
        // The vendor tells the horizontal angle; pictures are 4 to 3.
        2 * std::atan(std::tan(arcos::vcc4::kWideView_deg / 2 * kDegree) * 0.75) / kDegree);
    return xml;
}

/// Notes which geoms are its bumpers.
std::string robotXml(std::size_t index, const RobotPlacement& robot, Scene& scene) {
    using namespace peoplebot;
    const double radius = metres(kWheelRadius_mm);
    const double bumper = metres(kHalfLength_mm - std::abs(kCentre_mm));  // from the axle to the front
    const double rear_centre = metres(2 * kCentre_mm);
    const double half_chord = bumper * std::sin(kBumperPitch_deg / 2 * kDegree);
    const std::string r = fmt::format("r{}_", index);
    constexpr double kPartsMass = 3 + 1.7;  // wheels; gripper and camera
    // The body's frame is at the height of the axle; heights below are above the floor, hence "- radius".
    std::string xml = fmt::format(
        R"(<body name="{0}base" pos="{1} {2} {3}" euler="0 0 {4}"><freejoint/>
<inertial pos="-0.03 0 0.22" mass="{5}" diaginertia="1.6 1.7 0.45"/>
<geom class="hull" type="box" pos="-0.045 0 {6}" size="0.19 0.14 0.09" rgba="0.16 0.17 0.2 1"/>
<geom class="hull" type="box" pos="-0.1 0 {7}" size="0.09 0.12 0.36" rgba="0.3 0.31 0.34 1"/>
<geom class="hull" type="box" pos="-0.045 0 {8}" size="0.2 0.17 0.035" rgba="0.16 0.17 0.2 1"/>
<geom class="part" type="box" pos="0.03 0 {11}" size="0.07 0.075 0.07" rgba="0.75 0.75 0.72 1"/>
<geom class="caster" pos="-0.2 0 {9}"/>
<geom class="caster" pos="0.14 0 {10}"/>
)",
        r, robot.x, robot.y, radius, robot.theta, kMass_kg - kPartsMass, 0.15 - radius, 0.6 - radius,
        metres(kHeight_mm) - 0.035 - radius, 0.0375 - radius, 0.0375 - radius + 0.004, 0.31 - radius);
    for (int side = 0; side < 2; ++side) {
        for (int segment = 0; segment < kBumperSegments; ++segment) {
            // Clockwise from the front left, the rear ones from the rear right.
            const double angle = (side == 0 ? 0 : 180) + (2 - segment) * kBumperPitch_deg;
            const double a = angle * kDegree;
            xml += fmt::format(
                R"(<geom name="{}{}bumper{}" class="bumper" pos="{:.5f} {:.5f} {:.5f}" euler="0 0 {}" size="0.007 {:.5f} 0.04"/>
)",
                r, side == 0 ? "front" : "rear", segment + 1,
                (side == 0 ? 0 : rear_centre) + (bumper - 0.007) * std::cos(a),
                (bumper - 0.007) * std::sin(a), 0.1 - radius, angle, half_chord);
            Scene::Owner owner{.kind = Scene::Owner::Kind::Robot, .index = index};
            (side == 0 ? owner.front : owner.rear) = 1U << static_cast<unsigned>(segment);
            scene.geoms[fmt::format("{}{}bumper{}", r, side == 0 ? "front" : "rear", segment + 1)] = owner;
        }
    }
    for (const char* side : {"left", "right"}) {
        // Half of the track, 2 / DiffConvFactor (arcos_server.hpp).
        const double y = (side[0] == 'l' ? 1 : -1) / 0.006 / 1000;
        xml += fmt::format(
            R"(<body pos="0 {0:.5f} 0"><joint name="{1}{2}" type="hinge" axis="0 1 0" armature="0.05" damping="0.01" frictionloss="0.05"/>
<geom name="{1}{2}wheel" class="wheel" fromto="0 -0.018 0 0 0.018 0" size="{3}"/></body>
)",
            y, r, side, radius);
    }
    return xml + robotPartsXml(r, radius) + "</body>\n";
}

/// Its parts in the order in which Physics counts them.
DeviceModel robotModel(std::size_t index) {
    DeviceModel robot{.mjcf = {}, .root = fmt::format("r{}_base", index)};
    for (const char* motor : peoplebot::kMotors) robot.joints.push_back(fmt::format("r{}_{}", index, motor));
    robot.actuators = robot.joints;
    for (const char* geom : peoplebot::kGeoms) robot.geoms.push_back(fmt::format("r{}_{}", index, geom));
    robot.cameras = {fmt::format("r{}_camera", index)};
    return robot;
}

std::string robotActuatorsXml(std::size_t index) {
    using namespace peoplebot;
    std::string xml;
    for (const char* side : {"left", "right"}) {
        xml += fmt::format(
            R"(<velocity name="r{0}_{1}" joint="r{0}_{1}" kv="{2}" forcelimited="true" forcerange="-{3} {3}"/>)"
            "\n",
            index, side, kWheelDamping_nm_s, kMotorTorque_nm);
    }
    const auto position = [&](const char* name, double stiffness, double force) {
        xml += fmt::format(
            R"(<position name="r{0}_{1}" joint="r{0}_{1}" kp="{2}" forcelimited="true" forcerange="-{3} {3}"/>)"
            "\n",
            index, name, stiffness, force);
    };
    position("leftpaddle", kPaddleStiffness_n_m, kPaddleForce_n);
    position("rightpaddle", kPaddleStiffness_n_m, kPaddleForce_n);
    position("lift", kLiftStiffness_n_m, kLiftForce_n);
    position("pan", 10, 2);
    position("tilt", 10, 2);
    return xml;
}

}  // namespace

std::optional<std::array<double, 3>> colourNamed(std::string_view name) {
    static const std::map<std::string, std::array<double, 3>, std::less<>> kColours{
        {"red", {0.85, 0.05, 0.05}},  {"green", {0.05, 0.65, 0.1}},  {"blue", {0.05, 0.15, 0.85}},
        {"yellow", {0.9, 0.8, 0.05}}, {"orange", {0.95, 0.4, 0.02}}, {"purple", {0.5, 0.05, 0.65}},
        {"white", {0.9, 0.9, 0.9}},   {"black", {0.05, 0.05, 0.05}}};
    const auto found = kColours.find(name);
    if (found == kColours.end()) return std::nullopt;
    return found->second;
}

WorldDescription defaultWorld() {
    WorldDescription world;
    world.boxes = {{.x = 5.2, .y = 1.0},
                   {.x = 6.4, .y = 5.2, .dx = 0.8, .dy = 0.4, .height = 1.2},
                   {.x = 3.4, .y = 5.4}};
    world.tables = {{.x = 1.0, .y = 5.4, .dx = 1.4, .dy = 0.8}};
    return world;
}

Box parseBox(std::string_view text) {
    return parsed<Box>("--box", text, ',');
}
Table parseTable(std::string_view text) {
    return parsed<Table>("--table", text, ',');
}
Object parseObject(std::string_view text) {
    return parsed<Object>("--object", text, ',');
}
RobotPlacement parseRobot(std::string_view text, std::size_t index) {
    return parsed("--robot", text, ',', robotAt(index));
}
DevicePlacement parseDevice(const DeviceKind& kind, std::string_view text) {
    return parsed("--" + kind.noun, text, ',', usualPlacement(kind));
}

namespace {

void addMap(WorldDescription& world, const std::string& text, const std::string& file) {
    try {
        const auto map = mapper3::parseMap(text, file);
        if (map.lines.empty()) throw BadDescription(file + ": the map has no LINES to make walls of");
        for (const auto& line : map.lines) {
            const Wall wall{metres(line.from.x_mm), metres(line.from.y_mm), metres(line.to.x_mm),
                            metres(line.to.y_mm)};
            if (std::hypot(wall.x2 - wall.x1, wall.y2 - wall.y1) > 0.001) world.walls.push_back(wall);
        }
        const auto bounds = map.bounds();
        world.room_left = metres(bounds.from.x_mm);
        world.room_bottom = metres(bounds.from.y_mm);
        world.room_x = metres(bounds.to.x_mm - bounds.from.x_mm);
        world.room_y = metres(bounds.to.y_mm - bounds.from.y_mm);
        world.room_walls = false;
        for (const auto& home : map.homes)
            world.homes.push_back({metres(home.at.x_mm), metres(home.at.y_mm), home.heading_deg.value_or(0)});
        for (const auto& area : map.obstacles) {
            const auto corners = area.corners();
            Box box;
            box.x = metres(corners[0].x_mm + corners[2].x_mm) / 2;
            box.y = metres(corners[0].y_mm + corners[2].y_mm) / 2;
            box.dx = metres(area.most.x_mm - area.least.x_mm);
            box.dy = metres(area.most.y_mm - area.least.y_mm);
            box.theta = area.theta_deg;
            world.boxes.push_back(box);
        }
    } catch (const mapper3::BadMap& error) {
        throw BadDescription(error.what());
    }
}

/// One line of a world's file.
void addItem(WorldDescription& world, std::string_view line, const ReadFile& read) {
    const auto end = std::min(line.find(' '), line.size());
    const auto kind = line.substr(0, end);
    const auto rest = line.substr(end);
    if (kind == "room") {
        if (!world.walls.empty()) throw BadDescription("room: the map has told already how large it is");
        parseFields(kind, rest, ' ', {{"x", &world.room_x}, {"y", &world.room_y}});
    } else if (kind == "map") {
        std::string file;
        parseFields(kind, rest, ' ', {{"file", &file}});
        if (file.empty()) throw BadDescription("map: expected file=NAME.map");
        if (!world.walls.empty()) throw BadDescription("map: there is one already");
        addMap(world, read(file), file);
    } else if (kind == "table") {
        world.tables.push_back(parsed<Table>(kind, rest, ' '));
    } else if (kind == "box") {
        world.boxes.push_back(parsed<Box>(kind, rest, ' '));
    } else if (kind == "glass") {
        world.boxes.push_back(parsed(kind, rest, ' ', Box{.dx = 1, .dy = 0.02, .height = 2, .glass = true}));
    } else if (kind == "object") {
        world.objects.push_back(parsed<Object>(kind, rest, ' '));
    } else if (kind == "peoplebot") {
        auto robot = robotAt(world.robots.size());
        if (world.robots.size() < world.homes.size()) {
            const auto& home = world.homes[world.robots.size()];
            robot.x = home[0];
            robot.y = home[1];
            robot.theta = home[2];
        }
        world.robots.push_back(parsed(kind, rest, ' ', std::move(robot)));
    } else if (const auto* device = deviceKind(kind)) {
        world.devices.push_back(parsed(kind, rest, ' ', usualPlacement(*device)));
    } else {
        throw BadDescription(
            fmt::format("\"{}\": expected one of {}", kind,
                        fmt::join(withDeviceWords({kOtherWords.begin(), kOtherWords.end()}), ", ")));
    }
}

std::string readFile(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::ostringstream text;
    text << file.rdbuf();
    if (!file) throw BadDescription(path + ": cannot be read");
    return text.str();
}

}  // namespace

WorldDescription parseWorld(std::string_view text, std::string_view name, const ReadFile& read) {
    WorldDescription world;
    std::vector<std::pair<int, std::string>> items;
    int number = 0;
    const auto fail = [&name](int line, const BadDescription& error) {
        throw BadDescription(fmt::format("{}:{}: {}", name, line, error.what()));
    };
    while (!text.empty()) {
        const auto end = std::min(text.find('\n'), text.size());
        std::string line(text.substr(0, std::min(text.find('#'), end)));
        text.remove_prefix(std::min(end + 1, text.size()));
        ++number;
        std::replace(line.begin(), line.end(), '\t', ' ');
        std::replace(line.begin(), line.end(), '\r', ' ');
        line.erase(0, std::min(line.find_first_not_of(' '), line.size()));
        if (line.empty()) continue;
        try {
            addItem(world, line, read);
        } catch (const BadDescription& error) {
            fail(number, error);
        }
        items.emplace_back(number, std::move(line));
    }
    try {
        auto whole = world;
        complete(whole);
        validate(whole);
        return whole;
    } catch (const BadDescription&) {
        // Which line made it so? The room's size and the walls come first, whatever the order.
        WorldDescription growing;
        growing.room_x = world.room_x;
        growing.room_y = world.room_y;
        growing.room_left = world.room_left;
        growing.room_bottom = world.room_bottom;
        growing.walls = world.walls;
        growing.homes = world.homes;
        growing.room_walls = world.room_walls;
        for (const auto& [line, item] : items) {
            const bool room = item.rfind("room", 0) == 0 || item.rfind("map", 0) == 0;
            try {
                if (!room) addItem(growing, item, read);
                auto whole = growing;
                complete(whole);
                validate(whole);
            } catch (const BadDescription& error) {
                fail(line, error);
            }
        }
        throw;
    }
}

WorldDescription loadWorld(const std::string& path) {
    const auto slash = path.rfind('/');
    const std::string folder = slash == std::string::npos ? "" : path.substr(0, slash + 1);
    return parseWorld(readFile(path), path, [&folder](const std::string& file) {
        return readFile(!file.empty() && file[0] == '/' ? file : folder + file);
    });
}

void complete(WorldDescription& world) {
    const auto name = [](auto& items, const std::string& kind) {
        std::size_t number = 0;
        for (auto& item : items) {
            ++number;
            if (item.name.empty()) item.name = number == 1 ? kind : kind + std::to_string(number);
        }
    };
    name(world.tables, "table");
    name(world.boxes, "box");
    name(world.objects, "object");
    for (auto& object : world.objects) {
        if (!object.z) object.z = surfaceAt(world, object.x, object.y);
    }
    for (auto& device : world.devices) {
        if (!device.z) device.z = surfaceAt(world, device.x, device.y);
    }
}

void validate(const WorldDescription& world) {
    if (world.room_x < 1 || world.room_y < 1 || world.room_x > 200 || world.room_y > 200) {
        throw BadDescription(
            fmt::format("a room of {} x {} m: expected sides from 1 to 200 m", world.room_x, world.room_y));
    }
    std::set<std::string> names;
    const auto requireNew = [&names](const std::string& name) {
        if (!name.empty() && !names.insert(name).second)
            throw BadDescription(fmt::format("two things are called {}: give them names of their own", name));
    };
    for (const auto& box : world.boxes) {
        requireNew(box.name);
        requireInside(world, "a box", box.x, box.y);
        if (box.dx <= 0 || box.dy <= 0 || box.height <= 0)
            throw BadDescription("a box needs dx, dy and height above 0");
        if (box.z < 0) throw BadDescription("a box needs z of 0 or more");
    }
    for (const auto& table : world.tables) {
        requireNew(table.name);
        requireInside(world, "a table", table.x, table.y);
        if (table.dx <= 0.1 || table.dy <= 0.1 || table.height <= 0.1) {
            throw BadDescription("a table needs dx, dy and height above 0.1");
        }
    }
    for (const auto& object : world.objects) {
        requireNew(object.name);
        requireInside(world, "an object", object.x, object.y);
        if (!colourNamed(object.colour)) {
            throw BadDescription(
                fmt::format("object {}: colour={}: expected one of black, blue, green, orange, purple, red, "
                            "white, yellow",
                            object.name, object.colour));
        }
        if (std::min({object.dx, object.dy, object.dz}) < 0.005 ||
            std::max({object.dx, object.dy, object.dz}) > 1)
            throw BadDescription(
                fmt::format("object {}: expected dx, dy and dz from 0.005 to 1", object.name));
        if (object.mass < 0.005 || object.mass > 50)
            throw BadDescription(fmt::format("object {}: expected mass from 0.005 to 50 kg", object.name));
        if (object.z && *object.z < 0)
            throw BadDescription(fmt::format("object {}: expected z of 0 or more", object.name));
    }
    for (std::size_t i = 0; i < world.devices.size(); ++i) {
        const auto& device = world.devices[i];
        const auto& kind = kindOf(device);
        requireInside(world, kind.noun + " " + device.name, device.x, device.y);
        for (std::size_t k = 0; k < i; ++k) {
            const auto& other = world.devices[k];
            const auto& other_kind = kindOf(other);
            if (std::hypot(device.x - other.x, device.y - other.y) < kind.radius_m + other_kind.radius_m)
                throw BadDescription(fmt::format("{} {} stands in {} {}", kind.noun, device.name,
                                                 other_kind.noun, other.name));
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
        const double x = robot.x - world.room_left;
        const double y = robot.y - world.room_bottom;
        if (world.room_walls && std::min({x, y, world.room_x - x, world.room_y - y}) < swing)
            throw stuck("a wall");
        for (const auto& w : world.walls) {
            if (distanceTo(robot.x, robot.y, w) < swing) throw stuck("a wall");
        }
        for (const auto& b : world.boxes) {
            const bool above = b.z > metres(peoplebot::kHeight_mm);
            if (!above && distanceTo(robot.x, robot.y, b.x, b.y, b.dx, b.dy, b.theta) < swing)
                throw stuck("a box");
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

Scene sceneOf(const WorldDescription& described) {
    using Owner = Scene::Owner;
    Scene scene;
    constexpr double kWall = 0.1;
    constexpr double kThinWall = 0.02;  // of a map's lines, which have no thickness, to both sides
    constexpr double kWallHeight = 2;
    auto world = described;
    complete(world);
    const double w = world.room_x;
    const double h = world.room_y;
    const double left = world.room_left;
    const double bottom = world.room_bottom;
    auto& xml = scene.xml;
    xml = R"(<mujoco model="axon-lab">
<compiler angle="degree" eulerseq="xyz"/>
<option timestep="0.004"><flag multiccd="enable"/></option>
<size nconmax="300" njmax="1200"/>
<statistic extent="1"/>
<visual><global offwidth="1280" offheight="960"/><quality shadowsize="0" offsamples="0"/><map znear="0.02" zfar="300"/>
<headlight ambient="0.45 0.45 0.45" diffuse="0.4 0.4 0.4" specular="0 0 0"/></visual>
<default>
<default class="obstacle"><geom type="box" group="0" friction="0.5" rgba="0.82 0.82 0.8 1"/></default>
<default class="hull"><geom group="1" friction="0.4"/></default>
<!-- margin and gap: the switch closes 3 mm before the rubber bears, and stays closed when the robot rebounds a little -->
<default class="bumper"><geom type="box" group="1" friction="0.4" margin="0.003" gap="0.003" rgba="0.08 0.08 0.09 1"/></default>
<default class="wheel"><geom type="cylinder" group="4" friction="0.9" mass="1.5" rgba="0.1 0.1 0.1 1"/></default>
<!-- solimp: with the usual one a held object creeps down by 2 mm a second -->
<!-- priority: otherwise the floor's friction applies to a frictionless caster, and the robot slips -->
<default class="caster"><geom type="sphere" size="0.0375" group="4" condim="1" priority="2" rgba="0.1 0.1 0.1 1"/></default>
<default class="part"><geom group="4" friction="0.4"/></default>
<default class="paddle"><geom type="box" group="4" condim="4" friction="1.2 0.02 0.001" solimp="0.9995 0.9999 0.0005" priority="1" rgba="0.25 0.25 0.28 1"/></default>
<default class="object"><geom group="2" friction="0.4" condim="4"/></default>
</default>
<worldbody>
<geom name="floor" type="plane" size="0 0 1" group="3" friction="0.9" rgba="0.55 0.56 0.58 1"/>
<light directional="true" pos="0 0 5" dir="-0.3 0.25 -0.9" diffuse="0.35 0.35 0.35" specular="0 0 0" castshadow="false"/>
)";
    // From the front and above, the whole room in view.
    const double far = 1.05 * std::max(w, 1.33 * h) + 1;
    xml += fmt::format("<camera name=\"{}\" pos=\"{} {} {}\" xyaxes=\"1 0 0 0 0.82 0.57\" fovy=\"45\"/>\n",
                       kOverview, left + w / 2, bottom + h / 2 - 0.57 * far, 0.82 * far);
    constexpr auto kWood = "0.62 0.55 0.47 1";
    scene.geoms["floor"] = {.kind = Owner::Kind::Floor};
    /// Says what this is called in ground truth: what is made of several blocks is there once.
    const auto standing = [&scene](const std::string& called) {
        scene.fixed.push_back(called);
        return Owner{.kind = Owner::Kind::Fixed, .index = scene.fixed.size() - 1};
    };
    const auto block = [&](const Owner& owner, const std::string& name, double x, double y, double z,
                           double hx, double hy, double hz, double theta, std::string_view colour,
                           int group = 0) {
        xml += fmt::format(
            R"(<geom name="{}" class="obstacle" group="{}" pos="{} {} {}" size="{} {} {}" euler="0 0 {}"{}/>)"
            "\n",
            name, group, x, y, z, hx, hy, hz, theta,
            colour.empty() ? "" : fmt::format(" rgba=\"{}\"", colour));
        scene.geoms[name] = owner;
    };
    const auto walls = standing("wall");
    int number = 0;
    const auto wall = [&](double x, double y, double hx, double hy, double theta) {
        block(walls, fmt::format("wall:{}", number++), x, y, kWallHeight / 2, hx, hy, kWallHeight / 2, theta,
              "");
    };
    if (world.room_walls) {
        wall(left + w / 2, bottom - kWall, w / 2 + kWall, kWall, 0);
        wall(left + w / 2, bottom + h + kWall, w / 2 + kWall, kWall, 0);
        wall(left - kWall, bottom + h / 2, kWall, h / 2 + kWall, 0);
        wall(left + w + kWall, bottom + h / 2, kWall, h / 2 + kWall, 0);
    }
    for (const auto& line : world.walls) {
        const double dx = line.x2 - line.x1;
        const double dy = line.y2 - line.y1;
        wall((line.x1 + line.x2) / 2, (line.y1 + line.y2) / 2, std::hypot(dx, dy) / 2 + kThinWall, kThinWall,
             std::atan2(dy, dx) / kDegree);
    }
    for (std::size_t i = 0; i < world.boxes.size(); ++i) {
        const auto& box = world.boxes[i];
        block(standing(box.name), fmt::format("box{}:", i), box.x, box.y, box.z + box.height / 2, box.dx / 2,
              box.dy / 2, box.height / 2, box.theta, box.glass ? "0.6 0.8 0.85 0.3" : "0.7 0.7 0.66 1",
              box.glass ? 5 : 0);
    }
    for (std::size_t i = 0; i < world.tables.size(); ++i) {
        const auto& t = world.tables[i];
        constexpr double kTop = 0.015;
        constexpr double kLeg = 0.025;
        const auto table = standing(t.name);
        block(table, fmt::format("table{}:top", i), t.x, t.y, t.height - kTop, t.dx / 2, t.dy / 2, kTop,
              t.theta, kWood);
        const double a = t.theta * kDegree;
        for (const int sx : {-1, 1}) {
            for (const int sy : {-1, 1}) {
                const double u = sx * (t.dx / 2 - kLeg);
                const double v = sy * (t.dy / 2 - kLeg);
                block(table, fmt::format("table{}:leg{}{}", i, sx, sy),
                      t.x + std::cos(a) * u - std::sin(a) * v, t.y + std::sin(a) * u + std::cos(a) * v,
                      t.height / 2 - kTop, kLeg, kLeg, t.height / 2 - kTop, t.theta, kWood);
            }
        }
    }
    for (int i = 0; i < kObstacles; ++i) {
        xml += fmt::format(
            R"(<body name="obstacle{0}" mocap="true" pos="{0} 0 -5"><geom name="obstacle{0}:" class="obstacle" size="0.2 0.2 0.3" rgba="0.6 0.6 0.64 1"/></body>)"
            "\n",
            i);
        scene.obstacles.emplace_back(fmt::format("obstacle{}", i), fmt::format("obstacle{}:", i));
        scene.bodies[scene.obstacles.back().first] = {.kind = Owner::Kind::Obstacle,
                                                      .index = static_cast<std::size_t>(i)};
    }
    for (std::size_t i = 0; i < world.objects.size(); ++i) {
        const auto& o = world.objects[i];
        const bool cylinder = o.shape == Object::Shape::Cylinder;
        const auto colour = colourNamed(o.colour).value_or(std::array{0.5, 0.5, 0.5});
        xml += fmt::format(
            R"(<body name="object{0}" pos="{1} {2} {3}" euler="0 0 {4}"><freejoint/><geom name="object{0}:" class="object" type="{5}" size="{6}" mass="{7}" rgba="{8} {9} {10} 1"/></body>)"
            "\n",
            i, o.x, o.y, *o.z + o.dz / 2, o.theta, cylinder ? "cylinder" : "box",
            cylinder ? fmt::format("{} {}", o.dx / 2, o.dz / 2)
                     : fmt::format("{} {} {}", o.dx / 2, o.dy / 2, o.dz / 2),
            o.mass, colour[0], colour[1], colour[2]);
        scene.objects.push_back(fmt::format("object{}", i));
        scene.bodies[scene.objects.back()] = {.kind = Owner::Kind::Object, .index = i};
    }
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        xml += robotXml(i, world.robots[i], scene);
        scene.robots.push_back(robotModel(i));
        scene.bodies[scene.robots.back().root] = {.kind = Owner::Kind::Robot, .index = i};
    }
    xml += "</worldbody>\n<actuator>\n";
    for (std::size_t i = 0; i < world.robots.size(); ++i) xml += robotActuatorsXml(i);
    xml += "</actuator>\n<contact>\n";
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        // Parts slide along the column and would touch it; only parent and child are exempt by themselves.
        for (const char* part : {"leftpaddle", "rightpaddle", "lift", "pan"})
            xml += fmt::format("<exclude body1=\"r{0}_base\" body2=\"r{0}_{1}\"/>\n", i, part);
    }
    xml += "</contact>\n";
    for (std::size_t i = 0; i < world.devices.size(); ++i) {
        const auto& device = world.devices[i];
        auto model = kindOf(device).model(fmt::format("d{}_", i), device);
        xml += std::exchange(model.mjcf, {});
        scene.bodies[model.root] = {.kind = Owner::Kind::Device, .index = i};
        scene.devices.push_back(std::move(model));
    }
    xml += "</mujoco>\n";
    return scene;
}

}  // namespace axon::lab
