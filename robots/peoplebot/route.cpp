// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/route.hpp"

#include <fmt/format.h>
#include <mrpt/maps/COccupancyGridMap2D.h>
#include <mrpt/nav/planners/PlannerSimple2D.h>
#include <mrpt/poses/CPose2D.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>

namespace axon::peoplebot {
namespace {

using mapper3::Point;

constexpr std::array<double, 3> kRooms_mm{460, 385, kLeastRoom_mm};
constexpr double kMetre = 1000;
constexpr double kEnds_mm = 700;     // about the ends less room is enough
constexpr double kEscape_mm = 1000;  // as far the robot looks for a place from which it can plan
// What a cell's centre may be off.
constexpr double kGrain_mm = FloorPlan::kCell_mm / 2;

double distance(const Point& a, const Point& b) {
    return std::hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm);
}

class Search {
  public:
    Search(const FloorPlan& plan, std::span<const Point> sighted) : plan_(plan) {
        auto occupied = plan.keepOut();
        for (const auto& point : sighted) {
            if (const auto cell = plan.cellOf(point); cell >= 0) occupied[static_cast<std::size_t>(cell)] = 1;
        }
        room_ = distancesToOccupied(occupied, plan.width(), plan.height());
    }

    double room_mm(const Point& point) const {
        const auto cell = plan_.cellOf(point);
        return cell < 0 ? 0
                        : static_cast<double>(room_[static_cast<std::size_t>(cell)]) * FloorPlan::kCell_mm;
    }

    /// The nearest place with enough room to which the way does not lead through anything.
    std::optional<Point> escape(const Point& from) const {
        std::optional<Point> best;
        double nearest = kEscape_mm;
        const int reach = static_cast<int>(kEscape_mm / FloorPlan::kCell_mm);
        for (int dy = -reach; dy <= reach; ++dy) {
            for (int dx = -reach; dx <= reach; ++dx) {
                const Point there{from.x_mm + dx * FloorPlan::kCell_mm, from.y_mm + dy * FloorPlan::kCell_mm};
                const double away = distance(from, there);
                if (away >= nearest || room_mm(there) < kLeastRoom_mm + kGrain_mm) continue;
                // Room must not shrink on the way: it leads away from whatever is near.
                double room = room_mm(from);
                bool good = true;
                for (double way = 0; way < away && good; way += FloorPlan::kCell_mm) {
                    const double part = way / away;
                    const double here = room_mm({from.x_mm + part * (there.x_mm - from.x_mm),
                                                 from.y_mm + part * (there.y_mm - from.y_mm)});
                    good = here >= room - 1.5 * FloorPlan::kCell_mm;
                    room = std::max(room, here);
                }
                if (!good) continue;
                nearest = away;
                best = there;
            }
        }
        return best;
    }

    std::optional<std::vector<Point>> find(const Point& from, const Point& to, double room_mm) {
        // In a frame of its own, with the origin in the grid's corner: MRPT rounds a grid's edges to whole
        // cells.
        constexpr double kCell_m = FloorPlan::kCell_mm / kMetre;
        const auto columns = static_cast<std::size_t>(plan_.width());
        mrpt::maps::COccupancyGridMap2D grid(0, static_cast<float>(plan_.width() * kCell_m), 0,
                                             static_cast<float>(plan_.height() * kCell_m),
                                             static_cast<float>(kCell_m));
        const auto inGrid = [this](const Point& point) {
            return mrpt::poses::CPose2D((point.x_mm - plan_.left_mm()) / kMetre,
                                        (point.y_mm - plan_.bottom_mm()) / kMetre, 0);
        };
        free_.assign(room_.size(), 0);
        for (std::size_t cell = 0; cell < room_.size(); ++cell) {
            const auto centre = plan_.centreOf(cell);
            const double least = std::min(distance(centre, from), distance(centre, to)) < kEnds_mm
                                     ? kLeastRoom_mm - kGrain_mm
                                     : room_mm;
            const double room = static_cast<double>(room_[cell]) * FloorPlan::kCell_mm;
            free_[cell] = room >= least ? 1 : 0;
            grid.setCell(static_cast<int>(cell % columns), static_cast<int>(cell / columns),
                         free_[cell] != 0 ? 0.95F : 0.05F);
        }
        std::vector<Point> points{from};
        if (distance(from, to) > 3 * FloorPlan::kCell_mm) {
            mrpt::nav::PlannerSimple2D planner;
            planner.robotRadius = 0;  // the grid has the room already, and round instead of square
            planner.minStepInReturnedPath = 0.15F;
            std::deque<mrpt::math::TPoint2D> path;
            bool not_found = false;
            planner.computePath(grid, inGrid(from), inGrid(to), path, not_found);
            if (not_found) return std::nullopt;
            for (const auto& point : path)
                points.push_back({plan_.left_mm() + point.x * kMetre, plan_.bottom_mm() + point.y * kMetre});
        }
        if (distance(points.back(), to) > 1) points.push_back(to);
        return straightened(points);
    }

  private:
    bool sees(const Point& a, const Point& b) const {
        const int steps = static_cast<int>(std::ceil(distance(a, b) / kGrain_mm));
        for (int i = 0; i <= steps; ++i) {
            const double part = steps == 0 ? 0 : static_cast<double>(i) / steps;
            const auto cell =
                plan_.cellOf({a.x_mm + part * (b.x_mm - a.x_mm), a.y_mm + part * (b.y_mm - a.y_mm)});
            if (cell < 0 || free_[static_cast<std::size_t>(cell)] == 0) return false;
        }
        return true;
    }
    /// A grid knows eight directions only: straight legs instead wherever they stay free.
    std::vector<Point> straightened(const std::vector<Point>& points) const {
        std::vector<Point> legs{points.front()};
        for (std::size_t at = 0; at + 1 < points.size();) {
            std::size_t next = at + 1;
            for (std::size_t i = at + 2; i < points.size() && i < at + 200; ++i) {
                if (sees(points[at], points[i])) next = i;
            }
            legs.push_back(points[next]);
            at = next;
        }
        return legs;
    }

    const FloorPlan& plan_;
    std::vector<float> room_;
    std::vector<std::uint8_t> free_;
};

}  // namespace

double Route::length_mm() const {
    double length = 0;
    for (std::size_t i = 1; i < points.size(); ++i) length += distance(points[i - 1], points[i]);
    return length;
}

RouteAnswer findRoute(const FloorPlan& plan, const Point& from, const Point& to,
                      std::span<const Point> sighted) {
    if (!plan.contains(from))
        return {{}, fmt::format("the robot at ({:.0f}, {:.0f}) mm is not on the map", from.x_mm, from.y_mm)};
    Search search(plan, sighted);
    if (search.room_mm(to) < kLeastRoom_mm - FloorPlan::kCell_mm) {
        return {{},
                fmt::format(
                    "there is no room for the robot at ({:.0f}, {:.0f}) mm: it needs {:.0f} mm to all sides",
                    to.x_mm, to.y_mm, kLeastRoom_mm)};
    }
    auto start = from;
    if (search.room_mm(from) < kLeastRoom_mm) {
        const auto way_out = search.escape(from);
        if (!way_out)
            return {{},
                    fmt::format("the robot at ({:.0f}, {:.0f}) mm stands too near to something to get away",
                                from.x_mm, from.y_mm)};
        start = *way_out;
    }
    try {
        for (const double room : kRooms_mm) {
            auto points = search.find(start, to, room);
            if (!points) continue;
            if (distance(start, from) > 1) points->insert(points->begin(), from);
            return {Route{std::move(*points), room}, {}};
        }
    } catch (const std::exception& error) {  // MRPT's planner asserts on ways beyond some kilometres
        return {{}, std::string("the planner failed: ") + error.what()};
    }
    return {{}, "no way leads there that is wide enough for the robot"};
}

}  // namespace axon::peoplebot
