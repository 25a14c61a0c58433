// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "robots/mapper3/map.hpp"

namespace axon::peoplebot {

/// Distances from each cell of a grid to the nearest occupied one, in cells; exact (P. Felzenszwalb and
/// D. Huttenlocher, "Distance transforms of sampled functions", 2012). Very large where nothing is occupied.
std::vector<float> distancesToOccupied(const std::vector<std::uint8_t>& occupied, int width, int height);

/// A Mapper3 map as a grid of square cells: walls, and what is forbidden, rasterised. Constant after
/// construction, any thread may read. Throws mapper3::BadMap when the map has no walls or is larger than
/// kMostCells.
class FloorPlan {
  public:
    static constexpr double kCell_mm = 50;
    static constexpr std::size_t kMostCells = 16U << 20U;  // 200 x 200 m

    explicit FloorPlan(mapper3::Map map);

    const mapper3::Map& map() const { return map_; }
    int width() const { return width_; }
    int height() const { return height_; }
    double left_mm() const { return left_; }      ///< x of the grid's left edge
    double bottom_mm() const { return bottom_; }  ///< y of its lower edge
    bool contains(const mapper3::Point& point) const { return cellOf(point) >= 0; }
    /// Negative outside.
    std::ptrdiff_t cellOf(const mapper3::Point& point) const;
    mapper3::Point centreOf(std::size_t cell) const;

    const std::vector<std::uint8_t>& walls() const { return walls_; }       ///< by rows, from the lower left
    const std::vector<std::uint8_t>& keepOut() const { return keep_out_; }  ///< walls and what is forbidden
    /// To the nearest wall; 0 outside the grid.
    double wallDistance_mm(const mapper3::Point& point) const;
    /// To the nearest wall, forbidden line or forbidden area; 0 outside the grid.
    double room_mm(const mapper3::Point& point) const;

    /// Why the robot cannot be sent to this goal whatever its way: there is none of this name (tells which
    /// there are), it is in a forbidden area or too near to a wall. Empty when nothing speaks against it.
    std::string objection(const std::string& goal) const;

  private:
    void draw(std::vector<std::uint8_t>& cells, const mapper3::Line& line) const;

    mapper3::Map map_;
    double left_ = 0;
    double bottom_ = 0;
    int width_ = 0;
    int height_ = 0;
    std::vector<std::uint8_t> walls_;
    std::vector<std::uint8_t> keep_out_;
    std::vector<float> wall_distance_;
    std::vector<float> room_;
};

}  // namespace axon::peoplebot
