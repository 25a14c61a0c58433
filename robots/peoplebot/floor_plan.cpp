// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/floor_plan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "robots/peoplebot/route.hpp"

namespace axon::peoplebot {
namespace {

constexpr double kMargin_mm = 1000;
constexpr float kFar = 1e12F;

/// One row or column: squared distances to the nearest sample, by the lower envelope of parabolas.
void transform(const std::vector<float>& f, std::vector<float>& d, std::vector<int>& v, std::vector<float>& z,
               int n) {
    int k = 0;
    const auto at = [](auto& values, int i) -> auto& {
        return values[static_cast<std::size_t>(i)];
    };
    at(v, 0) = 0;
    at(z, 0) = -kFar;
    at(z, 1) = kFar;
    const auto crossing = [&](int q, int p) {
        const auto fq = static_cast<float>(q);
        const auto fp = static_cast<float>(p);
        return ((at(f, q) + fq * fq) - (at(f, p) + fp * fp)) / (2 * (fq - fp));
    };
    for (int q = 1; q < n; ++q) {
        float s = crossing(q, at(v, k));
        while (k > 0 && s <= at(z, k)) s = crossing(q, at(v, --k));
        at(v, ++k) = q;
        at(z, k) = s;
        at(z, k + 1) = kFar;
    }
    k = 0;
    for (int q = 0; q < n; ++q) {
        while (at(z, k + 1) < static_cast<float>(q)) ++k;
        const auto away = static_cast<float>(q - at(v, k));
        at(d, q) = away * away + at(f, at(v, k));
    }
}

}  // namespace

std::vector<float> distancesToOccupied(const std::vector<std::uint8_t>& occupied, int width, int height) {
    // Far more than any distance on a grid, but small enough for float to add to.
    constexpr float kNothing = 1e9F;
    std::vector<float> field(occupied.size());
    for (std::size_t i = 0; i < occupied.size(); ++i) field[i] = occupied[i] != 0 ? 0 : kNothing;
    const auto most = static_cast<std::size_t>(std::max(width, height));
    std::vector<float> f(most);
    std::vector<float> d(most);
    std::vector<int> v(most);
    std::vector<float> z(most + 1);
    for (int x = 0; x < width; ++x) {
        for (int y = 0; y < height; ++y)
            f[static_cast<std::size_t>(y)] = field[static_cast<std::size_t>(y * width + x)];
        transform(f, d, v, z, height);
        for (int y = 0; y < height; ++y)
            field[static_cast<std::size_t>(y * width + x)] = d[static_cast<std::size_t>(y)];
    }
    for (int y = 0; y < height; ++y) {
        const auto row = field.begin() + static_cast<std::ptrdiff_t>(y) * width;
        std::copy(row, row + width, f.begin());
        transform(f, d, v, z, width);
        std::transform(d.begin(), d.begin() + width, row, [](float square) { return std::sqrt(square); });
    }
    return field;
}

FloorPlan::FloorPlan(mapper3::Map map) : map_(std::move(map)) {
    if (map_.lines.empty() && map_.points.empty())
        throw mapper3::BadMap(fmt::format(
            "{}: there is neither a line nor a point: a robot cannot find itself without walls", map_.name));
    auto bounds = map_.bounds();
    for (const auto& goal : map_.goals) {
        bounds.from.x_mm = std::min(bounds.from.x_mm, goal.at.x_mm);
        bounds.from.y_mm = std::min(bounds.from.y_mm, goal.at.y_mm);
        bounds.to.x_mm = std::max(bounds.to.x_mm, goal.at.x_mm);
        bounds.to.y_mm = std::max(bounds.to.y_mm, goal.at.y_mm);
    }
    // Maps are drawn in round numbers: these lie in the middle of cells, not at their edges, or all walls
    // would stand half a cell too far to the right and up.
    left_ = (std::floor((bounds.from.x_mm - kMargin_mm) / kCell_mm) - 0.5) * kCell_mm;
    bottom_ = (std::floor((bounds.from.y_mm - kMargin_mm) / kCell_mm) - 0.5) * kCell_mm;
    const double columns = std::ceil((bounds.to.x_mm + kMargin_mm - left_) / kCell_mm);
    const double rows = std::ceil((bounds.to.y_mm + kMargin_mm - bottom_) / kCell_mm);
    if (columns * rows > static_cast<double>(kMostCells)) {
        throw mapper3::BadMap(fmt::format("{}: {:.0f} x {:.0f} m is too large: at most {} cells of {} mm",
                                          map_.name, columns * kCell_mm / 1000, rows * kCell_mm / 1000,
                                          kMostCells, kCell_mm));
    }
    width_ = static_cast<int>(columns);
    height_ = static_cast<int>(rows);
    walls_.resize(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_));
    for (const auto& line : map_.lines) draw(walls_, line);
    for (const auto& point : map_.points) draw(walls_, {point, point});
    keep_out_ = walls_;
    for (const auto& line : map_.forbidden_lines) draw(keep_out_, line);
    for (const auto& area : map_.forbidden_areas) {
        const auto corners = area.corners();
        for (std::size_t i = 0; i < corners.size(); ++i)
            draw(keep_out_, {corners[i], corners[(i + 1) % corners.size()]});
        for (std::size_t cell = 0; cell < keep_out_.size(); ++cell) {
            if (area.contains(centreOf(cell))) keep_out_[cell] = 1;
        }
    }
    wall_distance_ = distancesToOccupied(walls_, width_, height_);
    room_ = distancesToOccupied(keep_out_, width_, height_);
}

std::ptrdiff_t FloorPlan::cellOf(const mapper3::Point& point) const {
    const double column = std::floor((point.x_mm - left_) / kCell_mm);
    const double row = std::floor((point.y_mm - bottom_) / kCell_mm);
    if (!(column >= 0 && row >= 0 && column < width_ && row < height_)) return -1;
    return static_cast<std::ptrdiff_t>(row) * width_ + static_cast<std::ptrdiff_t>(column);
}

mapper3::Point FloorPlan::centreOf(std::size_t cell) const {
    const auto columns = static_cast<std::size_t>(width_);
    return {left_ + (static_cast<double>(cell % columns) + 0.5) * kCell_mm,
            bottom_ + (static_cast<double>(cell / columns) + 0.5) * kCell_mm};
}

void FloorPlan::draw(std::vector<std::uint8_t>& cells, const mapper3::Line& line) const {
    const double dx = line.to.x_mm - line.from.x_mm;
    const double dy = line.to.y_mm - line.from.y_mm;
    const int steps = static_cast<int>(std::ceil(std::hypot(dx, dy) / (kCell_mm / 2)));
    for (int i = 0; i <= steps; ++i) {
        const double part = steps == 0 ? 0 : static_cast<double>(i) / steps;
        const auto cell = cellOf({line.from.x_mm + part * dx, line.from.y_mm + part * dy});
        if (cell >= 0)
            cells[static_cast<std::size_t>(cell)] = 1;  // what is forbidden may reach beyond the walls
    }
}

double FloorPlan::wallDistance_mm(const mapper3::Point& point) const {
    const auto cell = cellOf(point);
    return cell < 0 ? 0 : static_cast<double>(wall_distance_[static_cast<std::size_t>(cell)]) * kCell_mm;
}

double FloorPlan::room_mm(const mapper3::Point& point) const {
    const auto cell = cellOf(point);
    return cell < 0 ? 0 : static_cast<double>(room_[static_cast<std::size_t>(cell)]) * kCell_mm;
}

std::string FloorPlan::objection(const std::string& name) const {
    const auto* goal = map_.goal(name);
    if (goal == nullptr) {
        std::vector<std::string> names;
        for (const auto& other : map_.goals) names.push_back('"' + other.name + '"');
        std::sort(names.begin(), names.end());
        std::string known;
        for (const auto& other : names) known += (known.empty() ? "" : ", ") + other;
        return fmt::format("the map {} has no goal \"{}\": {}", map_.name, name,
                           known.empty() ? "it has none at all; draw goals in Mapper3" : "it has " + known);
    }
    if (map_.forbidden(goal->at))
        return fmt::format("the goal \"{}\" lies in a forbidden area of the map {}", name, map_.name);
    const double room = room_mm(goal->at);
    if (room < kLeastRoom_mm - kCell_mm) {
        return fmt::format(
            "the goal \"{}\" has {:.0f} mm of room to the next wall or forbidden line; the robot needs "
            "{:.0f} mm",
            name, room, kLeastRoom_mm);
    }
    return {};
}

}  // namespace axon::peoplebot
