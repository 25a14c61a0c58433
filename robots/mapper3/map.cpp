// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/mapper3/map.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <numbers>

namespace axon::mapper3 {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kFarthest_mm = 10'000'000;  // ten kilometres: beyond it something is wrong
constexpr std::size_t kMaximumRows = 5'000'000;

/// Words are separated by blanks; a quoted word may hold some. Nothing if a quote has no end.
std::optional<std::vector<std::string>> words(std::string_view text) {
    std::vector<std::string> result;
    std::size_t at = 0;
    while (true) {
        at = text.find_first_not_of(" \t", at);
        if (at == std::string_view::npos) return result;
        if (text[at] == '"') {
            const auto end = text.find('"', at + 1);
            if (end == std::string_view::npos) return std::nullopt;
            result.emplace_back(text.substr(at + 1, end - at - 1));
            at = end + 1;
        } else {
            const auto end = std::min(text.find_first_of(" \t", at), text.size());
            result.emplace_back(text.substr(at, end - at));
            at = end;
        }
    }
}

class Parser {
  public:
    Parser(std::string_view text, std::string_view name) : text_(text) { map_.name = name; }

    Map parse() {
        if (text_.size() > kMaximumBytes) fail("the map is larger than 64 MiB");
        std::string_view line;
        if (!next(line) || line != "2D-Map") fail("expected \"2D-Map\": this is no map of Mapper3's");
        while (next(line)) {
            if (line.empty()) continue;
            if (line[0] == '-' || (line[0] >= '0' && line[0] <= '9')) {
                onRow(line);
            } else {
                onKeyword(line);
            }
        }
        endSection();
        return std::move(map_);
    }

  private:
    enum class Section { Header, Lines, Points, Unknown };

    [[noreturn]] void fail(const std::string& what) const { fail(number_, what); }
    [[noreturn]] void fail(int line, const std::string& what) const {
        throw BadMap(fmt::format("{}:{}: {}", map_.name, std::max(line, 1), what));
    }

    bool next(std::string_view& line) {
        if (text_.empty()) return false;
        const auto end = std::min(text_.find('\n'), text_.size());
        line = text_.substr(0, end);
        text_.remove_prefix(std::min(end + 1, text_.size()));
        ++number_;
        while (!line.empty() && (line.back() == '\r' || line.back() == ' ' || line.back() == '\t'))
            line.remove_suffix(1);
        return true;
    }

    std::optional<double> parseNumber(std::string_view text) const {
        double value = 0;
        const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
        if (parsed.ec != std::errc{} || parsed.ptr != text.data() + text.size() || !std::isfinite(value))
            return std::nullopt;
        return value;
    }
    double number(std::string_view text, std::string_view what) const {
        const auto value = parseNumber(text);
        if (!value) fail(fmt::format("{}: \"{}\": expected a number", what, text));
        if (std::abs(*value) > kFarthest_mm) fail(fmt::format("{}: {} is out of all proportion", what, text));
        return *value;
    }
    int count(std::string_view text, std::string_view what) const {
        const double value = number(text, what);
        if (value < 0 || value != std::floor(value) || value > static_cast<double>(kMaximumRows))
            fail(fmt::format("{}: {}: expected a number of rows, up to {}", what, text, kMaximumRows));
        return static_cast<int>(value);
    }

    void onRow(std::string_view line) {
        if (section_ == Section::Unknown) return;
        const bool lines = section_ == Section::Lines;
        if (section_ == Section::Header) fail("numbers before LINES or DATA");
        std::array<double, 4> values{};
        std::size_t found = 0;
        const std::size_t wanted = lines ? 4 : 2;
        // By hand: maps have tens of thousands of these.
        for (auto rest = line; !rest.empty();) {
            const auto begin = rest.find_first_not_of(" \t");
            const auto end = std::min(rest.find_first_of(" \t", begin), rest.size());
            if (found == wanted) {
                ++found;
                break;
            }
            values[found++] = number(rest.substr(begin, end - begin), lines ? "a line" : "a point");
            rest.remove_prefix(end);
        }
        if (found != wanted) {
            fail(fmt::format("\"{}\": expected {}", line, lines ? "x1 y1 x2 y2" : "x y"));
        }
        if (lines) {
            map_.lines.push_back({{values[0], values[1]}, {values[2], values[3]}});
        } else {
            map_.points.push_back({values[0], values[1]});
        }
        if (map_.lines.size() + map_.points.size() > kMaximumRows) fail("too many lines and points");
    }

    void endSection() {
        const auto check = [this](std::optional<int> promised, std::size_t got, const char* key) {
            if (promised && *promised != static_cast<int>(got))
                fail(fmt::format("{} promises {}, but there are {}: the file is not whole", key, *promised,
                                 got));
        };
        if (section_ == Section::Lines) check(line_count_, map_.lines.size(), "NumLines");
        if (section_ == Section::Points) check(point_count_, map_.points.size(), "NumPoints");
        section_ = Section::Header;
    }

    void onKeyword(std::string_view line) {
        const auto key = line.substr(0, line.find_first_of(" \t"));
        const auto rest = line.substr(key.size());
        endSection();
        if (line == "LINES") {
            if (lines_seen_) fail("a second LINES");
            lines_seen_ = true;
            section_ = Section::Lines;
        } else if (line == "DATA") {
            if (points_seen_) fail("a second DATA");
            points_seen_ = true;
            section_ = Section::Points;
        } else if (key == "NumLines:" || key == "NumPoints:" || key == "Resolution:") {
            const auto given = words(rest);
            if (!given || given->size() != 1) fail(fmt::format("{} expected one number", key));
            const int value = count(given->front(), key);
            if (key == "NumLines:") line_count_ = value;
            if (key == "NumPoints:") point_count_ = value;
            if (key == "Resolution:") map_.resolution_mm = value;
        } else if (key == "MinPos:" || key == "MaxPos:" || key == "LineMinPos:" || key == "LineMaxPos:") {
            // What they tell follows from the lines and points; that they are numbers is all that matters.
            const auto given = words(rest);
            if (!given || given->size() != 2) fail(fmt::format("{} expected x y", key));
            for (const auto& value : *given) number(value, key);
        } else if (key == "Cairn:") {
            onCairn(rest);
        } else if (key.back() != ':') {
            section_ = Section::Unknown;
        }
        // Other keywords with a colon, MapInfo among them, tell nothing that matters here.
    }

    void onCairn(std::string_view rest) {
        const auto parsed = words(rest);
        if (!parsed) fail("Cairn: a quote without an end");
        const auto& w = *parsed;
        if (w.size() < 7) {
            fail(fmt::format(
                "Cairn: {} words: expected at least 7: type x y theta \"description\" ICON \"name\"",
                w.size()));
        }
        const auto& type = w[0];
        Place place{w[6], {number(w[1], "x"), number(w[2], "y")}, number(w[3], "theta")};
        std::optional<Line> span;
        if (w.size() >= 11) {
            span = Line{{number(w[7], "x1"), number(w[8], "y1")}, {number(w[9], "x2"), number(w[10], "y2")}};
        }
        const auto area = [&] {
            if (!span) fail(fmt::format("Cairn: {} needs x1 y1 x2 y2 after its name", type));
            const auto [x1, x2] = std::minmax(span->from.x_mm, span->to.x_mm);
            const auto [y1, y2] = std::minmax(span->from.y_mm, span->to.y_mm);
            return Area{place.name, {x1, y1}, {x2, y2}, *place.heading_deg};
        };
        if (type == "Goal" || type == "GoalWithHeading") {
            if (place.name.empty()) fail(fmt::format("Cairn: a {} without a name", type));
            const auto [first, fresh] = goal_lines_.emplace(place.name, number_);
            if (!fresh)
                fail(fmt::format("Cairn: there is a goal \"{}\" in line {} already", place.name,
                                 first->second));
            if (type == "Goal") place.heading_deg.reset();
            map_.goals.push_back(std::move(place));
        } else if (type == "RobotHome") {
            map_.homes.push_back(std::move(place));
        } else if (type == "Dock") {
            map_.docks.push_back(std::move(place));
        } else if (type == "ForbiddenLine") {
            if (!span) fail("Cairn: ForbiddenLine needs x1 y1 x2 y2 after its name");
            map_.forbidden_lines.push_back(*span);
        } else if (type == "ForbiddenArea") {
            map_.forbidden_areas.push_back(area());
        } else if (type == "Sim.BoxObstacle") {
            map_.obstacles.push_back(area());
        } else {
            Cairn other{type, place, std::nullopt, number_};
            if (span) other.area = area();
            map_.others.push_back(std::move(other));
        }
    }

    std::string_view text_;
    Map map_;
    int number_ = 0;
    Section section_ = Section::Header;
    std::optional<int> line_count_;
    std::optional<int> point_count_;
    bool lines_seen_ = false;
    bool points_seen_ = false;
    std::map<std::string, int, std::less<>> goal_lines_;
};

}  // namespace

bool Area::contains(const Point& p) const {
    const double c = std::cos(theta_deg * kDegree);
    const double s = std::sin(theta_deg * kDegree);
    const double x = p.x_mm * c + p.y_mm * s;
    const double y = p.y_mm * c - p.x_mm * s;
    return x >= least.x_mm && x <= most.x_mm && y >= least.y_mm && y <= most.y_mm;
}

std::vector<Point> Area::corners() const {
    const double c = std::cos(theta_deg * kDegree);
    const double s = std::sin(theta_deg * kDegree);
    std::vector<Point> result{least, {most.x_mm, least.y_mm}, most, {least.x_mm, most.y_mm}};
    for (auto& p : result) p = {p.x_mm * c - p.y_mm * s, p.x_mm * s + p.y_mm * c};
    return result;
}

const Place* Map::goal(std::string_view wanted) const {
    const auto found =
        std::find_if(goals.begin(), goals.end(), [&](const Place& g) { return g.name == wanted; });
    if (found != goals.end()) return &*found;
    const auto same = [wanted](const Place& g) {
        return std::equal(g.name.begin(), g.name.end(), wanted.begin(), wanted.end(), [](char a, char b) {
            const auto lower = [](char c) {
                return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
            };
            return lower(a) == lower(b);
        });
    };
    const auto first = std::find_if(goals.begin(), goals.end(), same);
    if (first == goals.end()) return nullptr;
    return std::any_of(std::next(first), goals.end(), same) ? nullptr : &*first;
}

bool Map::forbidden(const Point& point) const {
    return std::any_of(forbidden_areas.begin(), forbidden_areas.end(),
                       [&](const Area& area) { return area.contains(point); });
}

Line Map::bounds() const {
    std::optional<Line> box;
    const auto extend = [&box](const Point& p) {
        if (!box) box = Line{p, p};
        box->from = {std::min(box->from.x_mm, p.x_mm), std::min(box->from.y_mm, p.y_mm)};
        box->to = {std::max(box->to.x_mm, p.x_mm), std::max(box->to.y_mm, p.y_mm)};
    };
    for (const auto& line : lines) extend(line.from), extend(line.to);
    for (const auto& point : points) extend(point);
    return box.value_or(Line{});
}

Map parseMap(std::string_view text, std::string_view name) {
    return Parser(text, name).parse();
}

}  // namespace axon::mapper3
