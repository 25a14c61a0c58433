// SPDX-License-Identifier: MIT
// A machine that knows the floor and computes shortest ways on it, for robots to follow.
#include <algorithm>
#include <deque>
#include <fstream>
#include <map>
#include <vector>

#include "station.hpp"

namespace {

/// map.txt: '#' is a wall, all else is free, letters and digits are places that have that name.
class Floor {
  public:
    explicit Floor(const std::filesystem::path& file) {
        std::ifstream lines(file);
        for (std::string line; std::getline(lines, line);) rows_.push_back(line);
        if (rows_.empty())
            throw axon::Misconfiguration(file.string() + ": expected rows of '#' and '.', found nothing");
    }

    /// "3,1", or the name of a place.
    Cell find(const std::string& text) const {
        if (text.size() == 1 && std::isalnum(static_cast<unsigned char>(text[0]))) {
            for (int y = 0; y < int(rows_.size()); ++y)
                if (const auto x = rows_[std::size_t(y)].find(text[0]); x != std::string::npos)
                    return {int(x), y};
            throw std::invalid_argument("the map has no place " + text);
        }
        const auto cell = toCell(text);
        if (!isFree(cell)) throw std::invalid_argument(text + " is a wall, or outside the map");
        return cell;
    }

    /// Breadth first, so it is one of the shortest; both ends included. Empty: there is none.
    std::vector<Cell> way(const Cell& from, const Cell& to) const {
        const auto order = [](const Cell& a, const Cell& b) {
            return std::pair(a.y, a.x) < std::pair(b.y, b.x);
        };
        std::map<Cell, Cell, decltype(order)> came_from(order);
        came_from.emplace(from, from);
        std::deque<Cell> border{from};
        while (!border.empty() && border.front() != to) {
            const auto at = border.front();
            border.pop_front();
            for (const auto& [x, y] : {std::pair(1, 0), {0, 1}, {-1, 0}, {0, -1}}) {
                const Cell next{at.x + x, at.y + y};
                if (isFree(next) && came_from.emplace(next, at).second) border.push_back(next);
            }
        }
        if (border.empty()) return {};
        std::vector<Cell> way{to};
        while (way.back() != from) way.push_back(came_from.at(way.back()));
        std::reverse(way.begin(), way.end());
        return way;
    }

  private:
    bool isFree(const Cell& cell) const {
        if (cell.y < 0 || cell.y >= int(rows_.size())) return false;
        const auto& row = rows_[std::size_t(cell.y)];
        return cell.x >= 0 && cell.x < int(row.size()) && row[std::size_t(cell.x)] != '#';
    }

    std::vector<std::string> rows_;
};

}  // namespace

int main(int argc, char** argv) {
    return runStation(
        argc, argv, "Planner", "planner", [](axon::EntityInterfacer& interfacer, const Options& options) {
            const auto plan = [floor = Floor(options.folder / "map.txt"),
                               speed = options.speed](axon::Task& task) {
                const auto from = floor.find(task.text("From"));
                const auto to = floor.find(task.text("To"));
                if (!task.waitFor(std::chrono::duration<double>(0.3 / speed))) return;  // as on a real map
                std::vector<axon::Value> way;
                for (const auto& cell : floor.way(from, to)) way.emplace_back(toText(cell));
                if (way.empty())
                    return task.fail("there is no way from " + task.text("From") + " to " + task.text("To"));
                const auto steps = std::int64_t(way.size()) - 1;
                task.feedback(std::to_string(steps) + " steps");
                task.result("Steps", steps);
                task.result("Way", std::move(way));
            };
            interfacer.onTask("Plan", failing(plan));
        });
}
