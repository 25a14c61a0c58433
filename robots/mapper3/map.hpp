// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

/// Maps of the vendor's map editor Mapper3 (".map"), as the robot application navigates by them and as the
/// virtual laboratory builds its walls from them. Units as in the file: millimetres and degrees.
namespace axon::mapper3 {

struct Point {
    double x_mm = 0, y_mm = 0;
    bool operator==(const Point&) const = default;
};

struct Line {
    Point from, to;
    bool operator==(const Line&) const = default;
};

/// A goal, a home, or any other place with a direction.
struct Place {
    std::string name;  ///< may be empty for homes
    Point at;
    std::optional<double> heading_deg;  ///< only where the map demands one (GoalWithHeading, RobotHome, Dock)
};

/// A rectangle with sides along the axes of a frame that is turned by theta_deg about the map's origin: a
/// point (x, y) of the map lies in it when (x cos + y sin, y cos - x sin) lies between least and most.
struct Area {
    std::string name;
    Point least, most;  ///< in the turned frame
    double theta_deg = 0;

    bool contains(const Point& point) const;
    /// In the frame of the map, counterclockwise.
    std::vector<Point> corners() const;
};

/// A cairn of a type that has no member of its own in Map: custom types (MapInfo), sectors.
struct Cairn {
    std::string type;
    Place place;
    std::optional<Area> area;
    int line = 0;  ///< of the file
};

struct Map {
    std::string name;           ///< as given to parseMap
    int resolution_mm = 0;      ///< 0: not told
    std::vector<Line> lines;    ///< walls
    std::vector<Point> points;  ///< what a laser saw; where there are lines too, the same walls once more
    std::vector<Place> goals;   ///< names are unique
    std::vector<Place> homes;
    std::vector<Place> docks;
    std::vector<Line> forbidden_lines;
    std::vector<Area> forbidden_areas;
    std::vector<Area> obstacles;  ///< Sim.BoxObstacle: boxes that stand in the way, unknown to the robot
    std::vector<Cairn> others;

    /// By its exact name, else the only one whose name differs in upper and lower case alone; nullptr if
    /// there is none.
    const Place* goal(std::string_view name) const;
    bool forbidden(const Point& point) const;  ///< whether it lies in a forbidden area
    /// The corners of a rectangle around all lines and points; equal where there are none.
    Line bounds() const;
};

/// What is wrong with a map: "NAME:LINE: what, and what was expected".
class BadMap : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// Reads a map. `name` is for messages. Unknown keywords and whole unknown sections are skipped, as they come
/// from newer editors; what is known but wrong is refused: BadMap. Files of up to kMaximumBytes.
inline constexpr std::size_t kMaximumBytes = 64U << 20U;
Map parseMap(std::string_view text, std::string_view name);

}  // namespace axon::mapper3
