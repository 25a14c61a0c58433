// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/navigation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "robots/peoplebot/body.hpp"
#include "robots/peoplebot/wander.hpp"

namespace axon::peoplebot {
namespace {

using mapper3::Point;
using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr double kDegree = std::numbers::pi / 180;

// Localisation.
constexpr int kScansToBegin = 3;
constexpr Duration kLaserPatience = seconds{4};
constexpr double kLeastFit = 0.35;  // furniture and people may hide most of the walls
constexpr Duration kDoubtPatience = seconds{6};

// Following.
constexpr double kLookAhead_mm = 550;
constexpr double kLookAheadNarrow_mm = 350;
constexpr double kLookAheadLeast_mm = 200;
constexpr double kLookAheadStep_mm = 50;
constexpr double kGain_per_s = 1.6;
constexpr double kFastestTurn_deg_s = 45;
constexpr double kTurnOnTheSpot_deg = 40;
constexpr double kTurnedEnough_deg = 12;
constexpr double kBeside_mm = 40;
constexpr double kTurnCrawl_deg_s = 6;
constexpr double kBraking_mm_s2 = 200;
constexpr double kCrawl_mm_s = 60;
constexpr double kFaced_deg = 2;
constexpr double kSwingMargin_mm = 5;  // routes lead through places that are hardly wider
constexpr double kFacingMargin_mm = 40;
constexpr double kOvershoot_deg = 20;
constexpr Duration kFacingPatience = seconds{20};
constexpr Duration kGettingOn = seconds{8};
constexpr double kStepOn_mm = 50;

// What is not on the map.
constexpr double kSeeLaser_mm = 2500;
constexpr double kSeeSonar_mm = 900;
constexpr double kFromWalls_mm = 250;
constexpr double kGrid_mm = 100;
constexpr int kTimesSeen = 3;
constexpr Duration kRemember = seconds{8};
// What the laser saw it also sees go; out of its sight it is there for a while.
constexpr Duration kRememberLaser = seconds{40};
constexpr double kSeenThrough_mm = 250;
constexpr double kLookForBlocks_mm = 1800;
constexpr double kBlocks_mm = 255;  // the hull and a little
// Something that the route was planned round may be nearer by as much as cells are coarse.
constexpr double kBlocksThoughPlanned_mm = 190;

constexpr double kRecoil_mm_s = 100;
constexpr Duration kRecoil = milliseconds{2500};
constexpr Duration kStallPause = milliseconds{700};
constexpr double kRearMargin_mm = 120;

double distance(const Point& a, const Point& b) {
    return std::hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm);
}
Point between(const Point& a, const Point& b, double part) {
    return {a.x_mm + part * (b.x_mm - a.x_mm), a.y_mm + part * (b.y_mm - a.y_mm)};
}
/// How far along a leg the point next to p lies, 0 to 1.
double partAlong(const Point& a, const Point& b, const Point& p) {
    const double dx = b.x_mm - a.x_mm;
    const double dy = b.y_mm - a.y_mm;
    const double square = dx * dx + dy * dy;
    return square <= 0 ? 1 : std::clamp(((p.x_mm - a.x_mm) * dx + (p.y_mm - a.y_mm) * dy) / square, 0.0, 1.0);
}
double distanceToLeg(const Point& a, const Point& b, const Point& p) {
    return distance(between(a, b, partAlong(a, b, p)), p);
}

}  // namespace

std::shared_ptr<const fuzzy::Engine> loadNavigationRules(const std::filesystem::path& file) {
    auto rules = std::make_shared<fuzzy::Engine>(fuzzy::Engine::load(file));
    rules->require({"left", "front", "right", "route"}, {"speed", "swerve"});
    return rules;
}

std::string Navigation::objection(const Request& r, const FloorPlan& plan) {
    if (!(r.velocity_mm_s >= kSlowest_mm_s && r.velocity_mm_s <= kFastest_mm_s))
        return fmt::format("Velocity is {} mm/s: give {} to {} mm/s", r.velocity_mm_s, kSlowest_mm_s,
                           kFastest_mm_s);
    if (!(r.tolerance_mm >= kLeastTolerance_mm && r.tolerance_mm <= kMostTolerance_mm))
        return fmt::format("Tolerance is {} mm: give {} to {} mm", r.tolerance_mm, kLeastTolerance_mm,
                           kMostTolerance_mm);
    return plan.objection(r.destination);
}

Navigation::Navigation(const Request& request, std::shared_ptr<const FloorPlan> plan,
                       std::shared_ptr<const fuzzy::Engine> rules, std::function<Estimate()> locate,
                       TimePoint now)
    : request_(request),
      plan_(std::move(plan)),
      rules_(std::move(rules)),
      locate_(std::move(locate)),
      goal_(*plan_->map().goal(request.destination)),
      state_since_(now),
      doubtful_since_(now),
      got_on_(now) {}

void Navigation::reconfigure(double velocity_mm_s, double tolerance_mm) {
    request_.velocity_mm_s = std::clamp(velocity_mm_s, kSlowest_mm_s, kFastest_mm_s);
    request_.tolerance_mm = std::clamp(tolerance_mm, kLeastTolerance_mm, kMostTolerance_mm);
}

void Navigation::resume(TimePoint now) {
    state_since_ = doubtful_since_ = got_on_ = now;
    if (blocked_since_) blocked_since_ = now;
}

void Navigation::enter(State state, TimePoint now) {
    state_ = state;
    state_since_ = now;
}

MotionStep Navigation::fail(std::string reason) const {
    return {.outcome = MotionStep::Outcome::Failed, .progress = progress(), .reason = std::move(reason)};
}
MotionStep Navigation::rest() const {
    return {.progress = progress()};
}

double Navigation::distanceToGoal_mm() const {
    return distance({estimate_.pose.x_mm, estimate_.pose.y_mm}, goal_.at);
}
double Navigation::progress() const {
    return !route_ || whole_mm_ <= 0 ? 0 : std::clamp(1 - rest_mm() / whole_mm_, 0.0, 1.0);
}
Point Navigation::onMap(double x_mm, double y_mm) const {
    const auto pose = estimate_.pose.then({x_mm, y_mm, 0});
    return {pose.x_mm, pose.y_mm};
}

MotionStep Navigation::step(const arcos::RobotState& robot, TimePoint now) {
    if (!robot.online) return fail("the connection to the robot is gone");
    surroundings_.update(robot);
    estimate_ = locate_();
    if (state_ != State::Locating) {
        if (now - estimate_.scan_taken > kLaserPatience)
            return fail("the laser fell silent: without it the robot does not know where it is");
        if (estimate_.fit >= kLeastFit) doubtful_since_ = now;
        if (now - doubtful_since_ > kDoubtPatience) {
            return fail(
                fmt::format("the robot lost itself: at ({:.0f}, {:.0f}) mm only {:.0f} % of what the laser "
                            "sees is on the map",
                            estimate_.pose.x_mm, estimate_.pose.y_mm, estimate_.fit * 100));
        }
        remember(robot, now);
    }
    switch (state_) {
        case State::Locating:
            return locate(robot, now);
        case State::Planning:
            return plan(robot, now);
        case State::Following:
            return follow(robot, now);
        case State::Waiting:
            if (now - state_since_ >= seconds{2}) enter(State::Planning, now);
            return rest();
        case State::Stopping:
            if (now - state_since_ < kStallPause) return {.progress = progress(), .halt = robot.moving};
            enter(State::Recoiling, now);
            return rest();
        case State::Recoiling:
            return recoil(robot, now);
        case State::Facing:
            return face(robot, now);
        case State::Settling:
            break;
    }
    if (!robot.moving || now - state_since_ > seconds{2})
        return {.outcome = MotionStep::Outcome::Done, .progress = 1};
    return rest();
}

MotionStep Navigation::locate(const arcos::RobotState& robot, TimePoint now) {
    if (first_scans_ < 0) first_scans_ = estimate_.scans;
    const bool fresh = now - estimate_.scan_taken < seconds{1};
    if (fresh && estimate_.scans >= kScansToBegin && estimate_.fit >= kLeastFit) {
        doubtful_since_ = now;
        enter(State::Planning, now);
        return rest();
    }
    if (now - state_since_ < kLaserPatience) return rest();
    if (!fresh || !robot.laser)
        return fail(
            "the laser sends no readings: without them the robot cannot find itself on the map. Is it fitted "
            "and switched on?");
    return fail(fmt::format(
        "only {:.0f} % of what the laser sees is on the map around ({:.0f}, {:.0f}) mm, heading {:.0f} deg: "
        "does the robot stand "
        "there? Say where it is with Start, and check the map",
        estimate_.fit * 100, estimate_.pose.x_mm, estimate_.pose.y_mm, estimate_.pose.heading_deg));
}

void Navigation::note(const Point& point, int times, bool laser, TimePoint now) {
    auto& thing = unmapped_[{static_cast<int>(std::floor(point.x_mm / kGrid_mm)),
                             static_cast<int>(std::floor(point.y_mm / kGrid_mm))}];
    thing.times += times;
    thing.seen = now;
    thing.laser = thing.laser || laser;
}

void Navigation::forgetWhatIsGone(const arcos::RobotState& robot, TimePoint now) {
    const auto* scan = robot.laser && now - robot.laser->taken < seconds{1} ? robot.laser.get() : nullptr;
    MapPose from;
    if (scan != nullptr) {
        const MapPose odometry{robot.x_mm, robot.y_mm, robot.heading_deg};
        from = estimate_.pose.then(odometry.between({scan->x_mm, scan->y_mm, scan->heading_deg}))
                   .then({body::kLaserX_mm, 0, 0});
    }
    const auto seenThrough = [&](const Point& point) {
        const auto seen = from.between({point.x_mm, point.y_mm, 0});
        const double away = std::hypot(seen.x_mm, seen.y_mm);
        const double beam = (std::atan2(seen.y_mm, seen.x_mm) / kDegree - scan->start_deg) / scan->step_deg;
        // All beams that may meet the cell, and the error of the estimate with it.
        const double width = std::atan2(kGrid_mm, std::max(away, 1.0)) / kDegree / scan->step_deg;
        const auto first = static_cast<int>(std::floor(beam - width));
        const auto last = static_cast<int>(std::ceil(beam + width));
        if (first < 0 || last >= static_cast<int>(scan->ranges_mm.size()) || away > kSeeLaser_mm)
            return false;
        for (int i = first; i <= last; ++i) {
            if (scan->ranges_mm[static_cast<std::size_t>(i)] < away + kSeenThrough_mm) return false;
        }
        return true;
    };
    for (auto at = unmapped_.begin(); at != unmapped_.end();) {
        const auto& thing = at->second;
        const bool gone =
            now - thing.seen > (thing.laser ? kRememberLaser : kRemember) ||
            (thing.laser && scan != nullptr &&
             seenThrough({(at->first.first + 0.5) * kGrid_mm, (at->first.second + 0.5) * kGrid_mm}));
        at = gone ? unmapped_.erase(at) : std::next(at);
    }
}

void Navigation::remember(const arcos::RobotState& robot, TimePoint now) {
    forgetWhatIsGone(robot, now);
    const auto sightings = surroundings_.sightings(kSeeLaser_mm);
    for (const auto& seen : sightings) {
        if (seen.laser) {
            const auto at = onMap(seen.x_mm, seen.y_mm);
            // Within a forbidden area it is what the area is there for: a table's legs.
            if (plan_->wallDistance_mm(at) > kFromWalls_mm && !plan_->map().forbidden(at))
                note(at, 1, true, now);
            continue;
        }
        if (seen.distance_mm > kSeeSonar_mm) continue;
        // A sonar tells that something is on an arc: where a wall of the map touches the arc, or something
        // that the laser sees does, it was that.
        const double middle = std::atan2(seen.y_mm - seen.sensor_y_mm, seen.x_mm - seen.sensor_x_mm);
        bool known =
            std::any_of(sightings.begin(), sightings.end(), [&](const Surroundings::Sighting& other) {
                if (!other.laser) return false;
                const double dx = other.x_mm - seen.sensor_x_mm;
                const double dy = other.y_mm - seen.sensor_y_mm;
                return std::abs(std::hypot(dx, dy) - seen.distance_mm) < 200 &&
                       std::abs(std::remainder(std::atan2(dy, dx) - middle, 2 * std::numbers::pi)) <
                           (body::kSonarHalfCone_deg + 8) * kDegree;
            });
        for (int i = -3; i <= 3 && !known; ++i) {
            const double a = middle + i * body::kSonarHalfCone_deg / 3 * kDegree;
            known = plan_->wallDistance_mm(onMap(seen.sensor_x_mm + seen.distance_mm * std::cos(a),
                                                 seen.sensor_y_mm + seen.distance_mm * std::sin(a))) <=
                    kFromWalls_mm;
        }
        // Behind the laser the things that it saw before are known as well.
        const auto at = onMap(seen.x_mm, seen.y_mm);
        for (auto other = unmapped_.begin(); other != unmapped_.end() && !known; ++other) {
            known = other->second.laser && distance(at, {(other->first.first + 0.5) * kGrid_mm,
                                                         (other->first.second + 0.5) * kGrid_mm}) < 350;
        }
        if (!known) note(at, 1, false, now);
    }
}

std::vector<Point> Navigation::remembered() const {
    std::vector<Point> points;
    for (const auto& [cell, thing] : unmapped_) {
        if (thing.times < kTimesSeen) continue;
        points.push_back({(cell.first + 0.5) * kGrid_mm, (cell.second + 0.5) * kGrid_mm});
    }
    return points;
}

std::optional<Point> Navigation::onRoute() const {
    const Point here{estimate_.pose.x_mm, estimate_.pose.y_mm};
    for (const auto& [cell, thing] : unmapped_) {
        if (thing.times < kTimesSeen) continue;
        const Point point{(cell.first + 0.5) * kGrid_mm, (cell.second + 0.5) * kGrid_mm};
        double way = -along_mm_;
        for (std::size_t i = leg_; i + 1 < route_->points.size() && way < kLookForBlocks_mm; ++i) {
            auto from = route_->points[i];
            auto to = route_->points[i + 1];
            const double length = distance(from, to);
            if (i == leg_ && length > 0) from = between(from, to, along_mm_ / length);
            const double to_look = kLookForBlocks_mm - std::max(0.0, way);
            if (const double left = distance(from, to); left > to_look)
                to = between(from, to, to_look / left);
            if (distanceToLeg(from, to, point) < (thing.planned ? kBlocksThoughPlanned_mm : kBlocks_mm) &&
                distance(here, point) > body::kRadius_mm)
                return point;
            way += length;
        }
    }
    return std::nullopt;
}

MotionStep Navigation::plan(const arcos::RobotState& robot, TimePoint now) {
    if (robot.moving && now - state_since_ < seconds{2}) return rest();
    const Point here{estimate_.pose.x_mm, estimate_.pose.y_mm};
    const auto sighted = remembered();
    auto answer = findRoute(*plan_, here, goal_.at, sighted);
    ++plans_;
    if (!answer.route) {
        if (sighted.empty() || !findRoute(*plan_, here, goal_.at).route)
            return fail(fmt::format("\"{}\" cannot be reached: {}", goal_.name, answer.reason));
        // Only what stands about keeps it: perhaps it goes away.
        if (!blocked_since_) {
            blocked_since_ = now;
            news_ = "the way is blocked by something that is not on the map; waiting for it to go";
        }
        if (now - *blocked_since_ > kPatience) {
            const auto nearest = *std::min_element(
                sighted.begin(), sighted.end(),
                [&](const Point& a, const Point& b) { return distance(a, here) < distance(b, here); });
            return fail(
                fmt::format("the way to \"{}\" is blocked, near ({:.0f}, {:.0f}) mm, and there is no other",
                            goal_.name, nearest.x_mm, nearest.y_mm));
        }
        enter(State::Waiting, now);
        return rest();
    }
    for (auto& [cell, thing] : unmapped_) thing.planned = thing.times >= kTimesSeen;
    route_ = std::move(answer.route);
    leg_ = 0;
    along_mm_ = 0;
    turning_ = true;
    const double length = route_->length_mm();
    if (plans_ == 1) whole_mm_ = length;
    least_rest_mm_ = length;
    got_on_ = now;
    news_ =
        fmt::format("{}: {:.1f} m to \"{}\"", plans_ == 1 ? "route" : "new route", length / 1000, goal_.name);
    enter(State::Following, now);
    return rest();
}

void Navigation::advance() {
    const Point here{estimate_.pose.x_mm, estimate_.pose.y_mm};
    // The nearest place on this leg or the next two: never back, never to where the route passes by later.
    double best = 1e12;
    std::size_t best_leg = leg_;
    double best_along = along_mm_;
    for (std::size_t i = leg_; i + 1 < route_->points.size() && i < leg_ + 3; ++i) {
        const auto& a = route_->points[i];
        const auto& b = route_->points[i + 1];
        const double part = partAlong(a, b, here);
        const double away = distance(between(a, b, part), here);
        if (away < best - 1) {
            best = away;
            best_leg = i;
            best_along = part * distance(a, b);
        }
    }
    leg_ = best_leg;
    along_mm_ = best_along;
}

Point Navigation::ahead(double way_mm) const {
    double way = way_mm + along_mm_;
    for (std::size_t i = leg_; i + 1 < route_->points.size(); ++i) {
        const double length = distance(route_->points[i], route_->points[i + 1]);
        if (way <= length)
            return between(route_->points[i], route_->points[i + 1], length > 0 ? way / length : 1);
        way -= length;
    }
    return route_->points.back();
}

Point Navigation::target() const {
    const Point here{estimate_.pose.x_mm, estimate_.pose.y_mm};
    // The straight way to a point ahead cuts the corner that the route goes round: not nearer to it than any
    // route does.
    const double least_room = std::min(kLeastRoom_mm, plan_->room_mm(here));
    const auto free = [&](const Point& there) {
        const double length = distance(here, there);
        for (double way = FloorPlan::kCell_mm; way <= length; way += FloorPlan::kCell_mm) {
            if (plan_->room_mm(between(here, there, way / length)) < least_room) return false;
        }
        return true;
    };
    double way = route_->room_mm > kLeastRoom_mm + 1 ? kLookAhead_mm : kLookAheadNarrow_mm;
    while (way > kLookAheadLeast_mm && !free(ahead(way))) way -= kLookAheadStep_mm;
    return ahead(way);
}

double Navigation::rest_mm() const {
    double rest = -along_mm_;
    for (std::size_t i = leg_; i + 1 < route_->points.size(); ++i)
        rest += distance(route_->points[i], route_->points[i + 1]);
    return std::max(0.0, rest);
}

MotionStep Navigation::follow(const arcos::RobotState& robot, TimePoint now) {
    if ((robot.table_left || robot.table_right) && distanceToGoal_mm() < 2 * request_.tolerance_mm) {
        // A goal in front of a table: as near as can be.
        enter(goal_.heading_deg ? State::Facing : State::Settling, now);
        return {.progress = progress(), .halt = true};
    }
    if (robot.table_left || robot.table_right) {
        std::vector<Point> seen;
        for (const double side : {-1.0, 1.0}) {
            if (side > 0 ? robot.table_left : robot.table_right)
                seen.push_back(onMap(body::kTableSensorX_mm + 40, side * body::kTableSensorY_mm));
        }
        return recover(robot, "a table is overhead that is not on the map", seen, now);
    }
    if (robot.front_bumpers != 0)
        return recover(robot, "a front bumper is pressed", {onMap(body::kRadius_mm + 60, 0)}, now);
    if (robot.rear_bumpers != 0)
        return recover(robot, "a rear bumper is pressed", {onMap(body::kRear_mm - body::kRadius_mm - 60, 0)},
                       now);
    if (robot.left_stall || robot.right_stall)
        return recover(robot, "the motors stalled", {onMap(body::kRadius_mm + 60, 0)}, now);

    advance();
    const double rest_way = rest_mm();
    if (rest_way < least_rest_mm_ - kStepOn_mm) {
        least_rest_mm_ = rest_way;
        got_on_ = now;
        if (rest_way < whole_mm_ - 1000) blocked_since_.reset();
    }
    const double to_goal = distanceToGoal_mm();
    // Within the tolerance it is there, and a little less than that, so that an estimate which trembles does
    // not matter.
    if (to_goal < request_.tolerance_mm * 0.6 || (to_goal < request_.tolerance_mm && rest_way < 5)) {
        enter(goal_.heading_deg ? State::Facing : State::Settling, now);
        return rest();
    }
    if (const auto thing = onRoute()) {
        news_ = fmt::format("something that is not on the map stands on the route, near ({:.0f}, {:.0f}) mm",
                            thing->x_mm, thing->y_mm);
        enter(State::Planning, now);
        return rest();
    }
    const auto room = surroundings_.clearance();
    if (now - got_on_ > kGettingOn)
        return recover(robot, "it does not get on",
                       {onMap(body::kRadius_mm + std::min(room.front, 300.0), 0)}, now);

    const auto to = target();
    const auto seen = estimate_.pose.between({to.x_mm, to.y_mm, 0});
    const double bearing = std::atan2(seen.y_mm, seen.x_mm) / kDegree;
    if (std::abs(bearing) > kTurnOnTheSpot_deg) turning_ = true;
    if (std::abs(bearing) < kTurnedEnough_deg) turning_ = false;
    double turn = std::clamp(bearing * kGain_per_s, -kFastestTurn_deg_s, kFastestTurn_deg_s);
    if (turning_) {
        if (surroundings_.roomToTurn(bearing) < kSwingMargin_mm)
            return recover(robot, "there is no room to turn", {}, now);
        if (std::abs(turn) < kTurnCrawl_deg_s) turn = std::copysign(kTurnCrawl_deg_s, bearing);
        return {.left_deg_s = turn, .progress = progress()};
    }
    const auto wish =
        rules_->evaluate(std::array{room.left, room.front, room.right, std::clamp(bearing / 30, -1.0, 1.0)});
    double speed = request_.velocity_mm_s * std::clamp(wish[0], 0.0, 100.0) / 100;
    speed *= std::max(0.2, std::cos(std::min(90.0, 2 * std::abs(bearing)) * kDegree));
    speed = std::min(speed, speedThatStopsWithin(room.front));
    speed = std::min(
        speed, std::max(kCrawl_mm_s,
                        std::sqrt(2 * kBraking_mm_s2 * std::max(0.0, rest_way - robot.speed_mm_s() * 0.2))));
    // Close to the goal nothing but the goal counts, unless it touches.
    if (speed < kCrawl_mm_s && to_goal < 400 && room.front > 60) speed = kCrawl_mm_s;
    // What is beside it is not steered towards, wherever the route leads.
    if ((turn > 0 ? room.left : room.right) < kBeside_mm) turn = 0;
    return {.forward_mm_s = speed, .left_deg_s = turn + wish[1], .progress = progress()};
}

MotionStep Navigation::recover(const arcos::RobotState& robot, std::string what,
                               const std::vector<Point>& seen_at, TimePoint now) {
    if (++tries_ > kTries)
        return fail(fmt::format("the way to \"{}\" is blocked: {}, {} times", goal_.name, what, tries_));
    for (const auto& point : seen_at) note(point, 2 * kTimesSeen, false, now);
    news_ = what + "; backing off and looking for another way";
    recoil_direction_ = robot.rear_bumpers != 0 && robot.front_bumpers == 0 ? 1 : -1;
    enter(State::Stopping, now);
    return {.progress = progress(), .halt = true};
}

MotionStep Navigation::recoil(const arcos::RobotState& robot, TimePoint now) {
    const auto room = surroundings_.clearance();
    const double ahead_mm = recoil_direction_ < 0 ? room.rear : room.front;
    const unsigned behind = recoil_direction_ < 0 ? robot.rear_bumpers : robot.front_bumpers;
    if (now - state_since_ >= kRecoil || behind != 0 || ahead_mm < kRearMargin_mm) {
        enter(State::Planning, now);
        return rest();
    }
    return {.forward_mm_s = recoil_direction_ * kRecoil_mm_s, .progress = progress()};
}

MotionStep Navigation::face(const arcos::RobotState& robot, TimePoint now) {
    if (robot.front_bumpers != 0 || robot.rear_bumpers != 0)
        return fail("a bumper was pressed while the robot turned to the goal's heading");
    double off = std::remainder(*goal_.heading_deg - estimate_.pose.heading_deg, 360.0);
    if (std::abs(off) < kFaced_deg) {
        enter(State::Settling, now);
        return rest();
    }
    // One way round as long as it is free: what stands there is only known while a sonar sees it.
    const auto turn = [off](int direction) {
        return off * direction < -kOvershoot_deg ? off + 360 * direction : off;
    };
    const auto free = [&](int direction) {
        return surroundings_.roomToTurn(turn(direction)) >= kFacingMargin_mm;
    };
    if (facing_ == 0) facing_ = off > 0 ? 1 : -1;
    if (!free(facing_)) {
        facing_ = -facing_;
        if (std::exchange(turned_back_, true) || !free(facing_))
            return fail("there is no room to turn to the goal's heading: something stands too near");
    }
    off = turn(facing_);
    if (now - state_since_ > kFacingPatience) return fail("the robot does not get to the goal's heading");
    // A turn goes on while it slows down, and each news is a tenth of a second old.
    const double rest_deg = std::max(0.0, std::abs(off) - std::abs(robot.rotation_deg_s) * 0.15);
    const double rate = std::clamp(std::sqrt(2 * 50 * rest_deg), kTurnCrawl_deg_s, kFastestTurn_deg_s);
    return {.left_deg_s = std::copysign(rate, off), .progress = progress()};
}

}  // namespace axon::peoplebot
