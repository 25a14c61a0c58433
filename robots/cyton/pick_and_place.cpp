// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/pick_and_place.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace axon::cyton {
namespace {

constexpr Point kShoulder{0, 0, 0.120};
constexpr double kReach = 0.469;                  // stretched, from there to the tool point
constexpr double kApproaches[] = {0.060, 0.045};  // along the tool, before the object and back from it
constexpr double kLifts[] = {0.055, 0.035};       // straight up with it
constexpr double kSetDown = 0.002;                // released so far above the surface
constexpr double kSqueeze_mm = 5;  // the claws are told to close so much further than the object is wide
constexpr double kSurfaceRadius = 0.085;   // of what carries the object: half of 0.12 m, to its corner
constexpr double kStep = 0.010;            // of the tool on a line
constexpr double kLargestTurn_rad = 0.35;  // of a joint on one step: more is another configuration
constexpr double kArmClearance = 0.030;    // half as thick as the arm
constexpr double kHandClearance = 0.012;
constexpr double kCareful = 0.4;    // of the speed, close to the object
constexpr double kClawSpeed = 0.5;  // of the claws' highest rate
constexpr double kLevel_rad =
    radians(45);  // what is round turns between the claws when it is carried upside down
constexpr double kTilts_deg[] = {0, 10, 20, 30, 40, 50, 60, 70, 80, 90};
constexpr double kYawTolerance_rad = radians(50);  // between the tool's plane and the line from the arm

Point operator+(const Point& a, const Point& b) {
    return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}
Point operator-(const Point& a, const Point& b) {
    return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
Point operator*(double factor, const Point& a) {
    return {factor * a[0], factor * a[1], factor * a[2]};
}
double length(const Point& a) {
    return std::hypot(a[0], a[1], a[2]);
}
double azimuth(const Point& a) {
    return std::atan2(a[1], a[0]);
}

/// Something upright that must not be touched.
struct Column {
    Point foot;  // its middle; the column is below, or above for an object
    double radius;
    double top;

    bool touches(const Point& point, double clearance) const {
        return point[2] < top + std::min(clearance, kHandClearance) &&
               std::hypot(point[0] - foot[0], point[1] - foot[1]) < radius + clearance;
    }
};

struct Surroundings {
    std::vector<Column> columns;
    std::optional<double> carried_below;  // the object's underside below the tool point
};

/// Points on the arm from the elbow to the tips, each with how far it must stay off.
bool clear(const Kinematics& kinematics, const Joints& joints, const Surroundings& surroundings) {
    const auto points = kinematics.skeleton(joints);
    const auto tool = kinematics.forward(joints);
    std::vector<std::pair<Point, double>> probes;
    constexpr std::size_t kElbow = 3;
    for (std::size_t i = kElbow; i + 2 < points.size(); ++i) {
        for (const double part : {0.0, 0.5, 1.0})
            probes.emplace_back(points[i] + part * (points[i + 1] - points[i]), kArmClearance);
    }
    probes.emplace_back(tool.position - kPalmBehindTool * tool.approach, kPalmHalfWidth);
    probes.emplace_back(tool.position + kTipBeyondTool * tool.approach, kHandClearance);
    if (surroundings.carried_below)
        probes.emplace_back(tool.position - Point{0, 0, *surroundings.carried_below}, kHandClearance);
    return std::all_of(probes.begin(), probes.end(), [&](const auto& probe) {
        const auto& point = probe.first;
        const double clearance = probe.second;
        return point[2] > clearance * 0.8 &&
               std::none_of(surroundings.columns.begin(), surroundings.columns.end(),
                            [&](const Column& column) { return column.touches(point, clearance); });
    });
}

Joints between(const Joints& from, const Joints& to, double part) {
    Joints joints;
    for (std::size_t k = 0; k < kJoints; ++k) joints[k] = std::lerp(from[k], to[k], part);
    return joints;
}

bool clearWay(const Kinematics& kinematics, const Joints& from, const Joints& to,
              const Surroundings& surroundings) {
    const int steps = std::max(1, static_cast<int>(std::ceil(largestDifference(from, to) / 0.1)));
    for (int i = 0; i <= steps; ++i)
        if (!clear(kinematics, between(from, to, static_cast<double>(i) / steps), surroundings)) return false;
    return true;
}

/// How far what the tool holds upright at the beginning is tilted on the way, at the most; rad, 0 to pi.
double tiltOn(const Kinematics& kinematics, const std::vector<Joints>& way) {
    const auto axes = [&](const Joints& joints) {
        const auto tool = kinematics.forward(joints);
        const auto& [a, c] = std::pair{tool.approach, tool.closing};
        return std::array<Point, 3>{
            a, c, {a[1] * c[2] - a[2] * c[1], a[2] * c[0] - a[0] * c[2], a[0] * c[1] - a[1] * c[0]}};
    };
    const auto held = axes(way.front());
    double least = 1;  // cosine
    for (std::size_t leg = 1; leg < way.size(); ++leg) {
        const int steps =
            std::max(1, static_cast<int>(std::ceil(largestDifference(way[leg - 1], way[leg]) / 0.1)));
        for (int i = 1; i <= steps; ++i) {
            const auto now = axes(between(way[leg - 1], way[leg], static_cast<double>(i) / steps));
            double up = 0;  // of the object's axis, which is the world's at the beginning
            for (std::size_t k = 0; k < 3; ++k) up += held[k][2] * now[k][2];
            least = std::min(least, up);
        }
    }
    return std::acos(std::clamp(least, -1.0, 1.0));
}

/// Joints on the way from one place to the other; the shortest list of those that are clear.
std::optional<std::vector<Joints>> way(const Kinematics& kinematics, const Joints& from, const Joints& to,
                                       const Surroundings& surroundings) {
    if (clearWay(kinematics, from, to, surroundings)) return std::vector{from, to};
    // Turned about the arm's axis first or last: what is held stays as it is meanwhile.
    for (auto turned : {from, to}) {
        turned[0] = turned[0] == from[0] ? to[0] : from[0];
        if (clearWay(kinematics, from, turned, surroundings) &&
            clearWay(kinematics, turned, to, surroundings))
            return std::vector{from, turned, to};
    }
    // By way of postures above everything: upright, turned as at the beginning or at the end.
    for (const auto& like : {to, from}) {
        Joints upright = like;
        upright[1] = upright[3] = upright[5] = 0;
        if (clearWay(kinematics, from, upright, surroundings) &&
            clearWay(kinematics, upright, to, surroundings))
            return std::vector{from, upright, to};
        // Drawn in first: the hand goes back over its own shoulder.
        upright[1] = -0.6;
        upright[3] = 1.2;
        if (clearWay(kinematics, from, upright, surroundings) &&
            clearWay(kinematics, upright, to, surroundings))
            return std::vector{from, upright, to};
    }
    const Joints zero{};
    if (clearWay(kinematics, from, zero, surroundings) && clearWay(kinematics, zero, to, surroundings))
        return std::vector{from, zero, to};
    return std::nullopt;
}

/// The tool along a straight line without turning; from `joints`, which are at its beginning.
std::optional<std::vector<Joints>> line(Kinematics& kinematics, const ToolPose& from, const Point& to,
                                        const Joints& joints) {
    std::vector<Joints> way{joints};
    const auto path = to - from.position;
    const int steps = std::max(1, static_cast<int>(std::ceil(length(path) / kStep)));
    for (int i = 1; i <= steps; ++i) {
        auto pose = from;
        pose.position = from.position + (static_cast<double>(i) / steps) * path;
        const auto next = kinematics.follow(pose, way.back());
        if (!next || largestDifference(*next, way.back()) > kLargestTurn_rad) return std::nullopt;
        way.push_back(*next);
    }
    return way;
}

/// How high above the underside the tool point grips: near the top, so that the palm stays above the object,
/// but no lower than the hand needs above the surface.
double gripHeight(const PickAndPlaceRequest& request, double tilt) {
    const double room = kPalmBehindTool - 0.002 - request.width / 2 * std::sin(tilt);
    const double below_top = std::min(request.height / 2, room / std::max(std::cos(tilt), 0.2));
    return request.height - std::max(below_top, 0.003);
}
double leastGripHeight(double tilt) {
    const double tips = kTipBeyondTool * std::cos(tilt) + kPadHalfWidth * std::sin(tilt);
    const double palm = kPalmHalfWidth * std::sin(tilt) - kPalmBehindTool * std::cos(tilt);
    return std::max(tips, palm) + 0.005;
}

/// A way for the tool to stand at a place: closing directions and what they leave of the object's yaw.
struct Stand {
    ToolPose pose;
    double closing_yaw;
};

std::vector<Stand> stands(const Point& at, std::optional<double> yaw, double tilt) {
    const double outwards = azimuth(at);
    std::vector<double> headings;  // where the tool would point if it were level
    if (yaw) {
        for (int i = 0; i < 4; ++i) headings.push_back(*yaw + i * std::numbers::pi / 2);
    } else {
        headings = {outwards, outwards + std::numbers::pi / 2};
    }
    const auto off = [outwards](double heading) {
        return std::abs(std::remainder(heading - outwards, 2 * std::numbers::pi));
    };
    std::sort(headings.begin(), headings.end(), [&](double a, double b) { return off(a) < off(b); });
    std::vector<Stand> found;
    for (const double heading : headings) {
        if (off(heading) > (tilt > 0 ? kYawTolerance_rad : std::numbers::pi * 0.51)) continue;
        Stand stand;
        stand.closing_yaw = heading + std::numbers::pi / 2;
        stand.pose.position = at;
        stand.pose.approach = {std::sin(tilt) * std::cos(heading), std::sin(tilt) * std::sin(heading),
                               -std::cos(tilt)};
        stand.pose.closing = {std::cos(stand.closing_yaw), std::sin(stand.closing_yaw), 0};
        found.push_back(stand);
    }
    return found;
}

std::vector<Posture> postures(const std::vector<Joints>& joints, double opening_mm) {
    std::vector<Posture> out;
    for (const auto& each : joints) out.push_back({each, opening_mm});
    return out;
}

/// One end of the motion, solved: the tool at the object, what leads there and away.
struct Solved {
    Stand stand;
    Joints at;
    std::vector<Joints> along_tool;  // from there back along the tool
    std::vector<Joints> upwards;     // from there up, with the object
};

/// A posture of the kind that reaches down and outwards; the wrist's roll makes the claws close sideways.
Joints reachingPosture(const Point& at) {
    const double roll = std::clamp(-azimuth(at), kChain[0].minimum, kChain[0].maximum);
    return {roll, 0.7, 0, 0.9, 1.4, 0, 0.4};
}

class Planner {
  public:
    Planner(Kinematics& kinematics, const PickAndPlaceRequest& request, const Posture& start,
            const std::function<bool()>& cancelled)
        : kinematics_(kinematics), request_(request), start_(start), cancelled_(cancelled) {}

    Result<PickAndPlacePlan> plan() {
        std::optional<PickAndPlacePlan> best;  // of those that tilt the object on the way
        for (const int postures : {2, 5}) {
            if (auto found = search(postures, best)) return *std::move(found);
            if (!best || (cancelled_ && cancelled_())) break;
        }
        if (cancelled_ && cancelled_()) return refusal("the task was stopped while it was planned");
        if (best) return *std::move(best);
        return refusal(reason());
    }

  private:
    /// Looks at so many postures for each end. A plan that carries the object level, or nothing and perhaps a
    /// `best`.
    std::optional<PickAndPlacePlan> search(int postures, std::optional<PickAndPlacePlan>& best) {
        for (const double tilt_deg : kTilts_deg) {
            const double tilt = radians(tilt_deg);
            const double grip = std::max(gripHeight(request_, tilt), leastGripHeight(tilt));
            if (grip > request_.height) continue;
            for (const auto& pick :
                 solve(request_.pick, request_.pick_yaw, tilt, grip, std::nullopt, postures)) {
                pick_reached_ = true;
                std::optional<double> place_yaw;
                if (request_.place_yaw) {
                    const double sides = request_.pick_yaw.value_or(azimuth(request_.pick));
                    // The heading of the tool at the place, a quarter turn before its closing direction.
                    place_yaw = pick.stand.closing_yaw - std::numbers::pi / 2 + *request_.place_yaw - sides;
                }
                auto above = request_.place;
                above[2] += kSetDown;
                for (const auto& place : solve(above, place_yaw, tilt, grip, pick.at, postures)) {
                    place_reached_ = true;
                    if (cancelled_ && cancelled_()) return std::nullopt;
                    auto plan = connect(pick, place, tilt, grip);
                    if (!plan) continue;
                    if (plan->carried_tilt <= kLevel_rad) return plan;
                    if (!best || plan->carried_tilt < best->carried_tilt) best = std::move(plan);
                }
                if (cancelled_ && cancelled_()) return std::nullopt;
            }
        }
        return std::nullopt;
    }

    static Refusal refusal(const std::string& why) { return {RefusalCode::Denied, why, {}}; }

    std::string reason() const {
        const auto where = [](const Point& at) {
            return fmt::format("({:.0f}, {:.0f}, {:.0f}) mm, {:.0f} mm from the arm's axis", at[0] * 1000,
                               at[1] * 1000, at[2] * 1000, std::hypot(at[0], at[1]) * 1000);
        };
        if (!pick_reached_)
            return fmt::format(
                "the arm cannot grip an object of {:.0f} mm that stands at {}, tilted however it may be: on "
                "its own "
                "level it reaches 340 to 420 mm far",
                request_.height * 1000, where(request_.pick));
        if (!place_reached_)
            return fmt::format(
                "the arm can pick the object up at {}, but not put it down at {} with the hand tilted alike: "
                "on its "
                "own level it reaches 340 to 420 mm far",
                where(request_.pick), where(request_.place));
        return fmt::format(
            "the arm reaches {} and {}, but found no way in between that touches neither the surface below "
            "the "
            "object nor the one it stands on: move them further apart",
            where(request_.pick), where(request_.place));
    }

    std::vector<Solved> solve(const Point& foot, std::optional<double> yaw, double tilt, double grip,
                              const std::optional<Joints>& like, int postures) {
        std::vector<Solved> found;
        for (const auto& stand : stands(foot + Point{0, 0, grip}, yaw, tilt)) {
            auto wanted = reachingPosture(foot);
            if (like) {
                const double roll = wanted[0];
                wanted = *like;
                wanted[0] = roll;
            }
            for (const auto& at : kinematics_.solutions(
                     stand.pose, wanted, {.starts = 25 * postures, .solutions = 2 * postures})) {
                std::optional<std::vector<Joints>> back;
                for (const double far : kApproaches) {
                    back = line(kinematics_, stand.pose, stand.pose.position - far * stand.pose.approach, at);
                    if (back) break;
                }
                std::optional<std::vector<Joints>> up;
                for (const double high : kLifts) {
                    if (back) up = line(kinematics_, stand.pose, stand.pose.position + Point{0, 0, high}, at);
                    if (up) break;
                }
                if (!up || !clear(kinematics_, at, {})) continue;
                found.push_back({stand, at, *back, *up});
                if (found.size() >= static_cast<std::size_t>(postures)) return found;
            }
        }
        return found;
    }

    std::optional<PickAndPlacePlan> connect(const Solved& pick, const Solved& place, double tilt,
                                            double grip) {
        const Column surface{request_.pick, kSurfaceRadius, request_.pick[2]};
        const double around = request_.width * 0.71;
        Surroundings before{{surface, {request_.pick, around, request_.pick[2] + request_.height}}, {}};
        if (request_.pick[2] < 0.005) before.columns.erase(before.columns.begin());
        Surroundings carrying{{surface}, grip};
        if (request_.pick[2] < 0.005) carrying.columns.clear();
        Surroundings after{carrying.columns, {}};
        after.columns.push_back({request_.place, around, request_.place[2] + request_.height});

        const auto& ready = pick.along_tool.back();
        const auto& retreated = place.along_tool.back();
        const auto to_ready = way(kinematics_, start_.joints, ready, before);
        if (!to_ready) return std::nullopt;
        const auto carry = way(kinematics_, pick.upwards.back(), place.upwards.back(), carrying);
        if (!carry) return std::nullopt;
        const auto home = way(kinematics_, retreated, kHome, after);
        if (!home) return std::nullopt;

        const double speed = request_.speed;
        const double careful = speed * kCareful;
        const double open = gripper::kOpen_mm;
        const double held = std::max(gripper::kClosed_mm, request_.width * 1000 - kSqueeze_mm);
        const auto reversed = [](std::vector<Joints> joints) {
            std::reverse(joints.begin(), joints.end());
            return joints;
        };
        PickAndPlacePlan plan;
        plan.tilt = tilt;
        plan.carried_tilt = tiltOn(kinematics_, *carry);
        plan.grip_height = grip;
        auto first = postures(*to_ready, open);
        first.front().opening_mm = start_.opening_mm;
        const auto leg = [&plan](const char* name, std::vector<Posture> way, double part, double rest_s) {
            plan.legs.push_back({name, Trajectory(std::move(way), part), rest_s});
        };
        // However fast the arm is: pads that hit the object fast push it away before they hold it.
        const auto claws = [&leg, &plan](const char* name, const Posture& from, const Posture& to,
                                         double rest_s) {
            leg(name, {from, to}, kClawSpeed, rest_s);
            plan.legs.back().keeps_speed = true;
        };
        leg("going to the object", std::move(first), speed, 0.3);
        leg("approaching it", postures(reversed(pick.along_tool), open), careful, 0.3);
        claws("closing the gripper", {pick.at, open}, {pick.at, held}, 0.5);
        plan.grasped = plan.legs.size();
        leg("lifting it", postures(pick.upwards, held), careful, 0.2);
        leg("carrying it", postures(*carry, held), speed * 0.8, 0.3);
        leg("lowering it", postures(reversed(place.upwards), held), careful, 0.5);
        plan.released = plan.legs.size();
        claws("opening the gripper", {place.at, held}, {place.at, open}, 0.4);
        leg("backing off", postures(place.along_tool, open), careful, 0.1);
        auto last = postures(*home, open);
        last.back().opening_mm = gripper::kHome_mm;
        leg("going home", std::move(last), speed, 0.3);
        return plan;
    }

    Kinematics& kinematics_;
    const PickAndPlaceRequest& request_;
    const Posture& start_;
    const std::function<bool()>& cancelled_;
    bool pick_reached_ = false;
    bool place_reached_ = false;
};

}  // namespace

std::string objection(const PickAndPlaceRequest& request) {
    if (request.width > PickAndPlaceRequest::kWidest || request.width <= 0.003)
        return fmt::format("an object {:.0f} mm wide does not fit between the claws: up to {:.0f} mm do",
                           request.width * 1000, PickAndPlaceRequest::kWidest * 1000);
    if (request.height < 0.02)
        return "an object lower than 20 mm cannot be gripped: the hand would touch the surface";
    for (const auto& [at, what] : {std::pair{request.pick, "pick"}, std::pair{request.place, "place"}}) {
        if (at[2] < 0)
            return fmt::format(
                "the {} position is below the plane that the arm stands on: give a Z of 0 or more", what);
        auto top = at;
        top[2] += request.height;
        const double far = std::min(length(at - kShoulder), length(top - kShoulder));
        if (far > kReach)
            return fmt::format(
                "the {} position ({:.0f}, {:.0f}, {:.0f}) mm is {:.0f} mm from the shoulder, which is {:.0f} "
                "mm "
                "above the base: the arm is {:.0f} mm long",
                what, at[0] * 1000, at[1] * 1000, at[2] * 1000, far * 1000, kShoulder[2] * 1000,
                kReach * 1000);
        if (std::hypot(at[0], at[1]) < 0.12)
            return fmt::format("the {} position is {:.0f} mm from the arm's own axis: keep it 120 mm away",
                               what, std::hypot(at[0], at[1]) * 1000);
    }
    if (std::hypot(request.pick[0] - request.place[0], request.pick[1] - request.place[1]) < 0.06)
        return "the pick and the place position are less than 60 mm apart";
    return {};
}

Result<PickAndPlacePlan> planPickAndPlace(Kinematics& kinematics, const PickAndPlaceRequest& request,
                                          const Posture& start, const std::function<bool()>& cancelled) {
    if (auto why = objection(request); !why.empty()) return Refusal{RefusalCode::Denied, std::move(why), {}};
    return Planner(kinematics, request, start, cancelled).plan();
}

std::optional<std::vector<Posture>> wayBetween(const Kinematics& kinematics, const Posture& from,
                                               const Posture& to) {
    const auto found = way(kinematics, from.joints, to.joints, {});
    if (!found) return std::nullopt;
    auto out = postures(*found, to.opening_mm);
    out.front().opening_mm = from.opening_mm;
    return out;
}

}  // namespace axon::cyton
