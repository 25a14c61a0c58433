// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "robots/fuzzy/engine.hpp"
#include "robots/peoplebot/localisation.hpp"
#include "robots/peoplebot/motion.hpp"
#include "robots/peoplebot/route.hpp"
#include "robots/peoplebot/surroundings.hpp"

namespace axon::peoplebot {

/// The rules of navigation.rules. Throws fuzzy::BadRules where they lack what navigation needs.
std::shared_ptr<const fuzzy::Engine> loadNavigationRules(const std::filesystem::path& file);

/// The service Navigation: to a goal of the map, along a planned route, with fuzzy avoidance on the way.
///
/// States: locating (the first scans; the estimate must fit the map) → planning (the robot stands) →
/// following → facing (the goal's heading, where it has one) → settling → done. Following → planning, when
/// something that is not on the map stands on the route; → waiting → planning, when there is no way round it,
/// until kPatience is over; → recoiling → planning, when a bumper is pressed or a table is overhead; kTries
/// times.
///
/// Fails with the reason: no way to the goal, the way is blocked, the laser is silent or does not see what
/// the map shows, the robot is lost or does not get on. I/O-free, not thread-safe. step() may take a second
/// when it plans; the robot stands then.
class Navigation {
  public:
    struct Request {
        std::string destination;
        double velocity_mm_s = 300;  ///< at most
        double tolerance_mm = 100;   ///< distance from the goal that counts as arrived
    };
    static constexpr double kFastest_mm_s = 600;
    static constexpr double kSlowest_mm_s = 50;
    static constexpr double kLeastTolerance_mm = 30;
    static constexpr double kMostTolerance_mm = 1000;
    static constexpr int kTries = 4;
    static constexpr Duration kPatience = std::chrono::seconds{20};

    /// Why this cannot be done whatever the way is; empty when nothing speaks against it.
    static std::string objection(const Request& request, const FloorPlan& plan);

    /// `locate` gives the present estimate of a Localisation on the same plan. The destination must be a
    /// goal.
    Navigation(const Request& request, std::shared_ptr<const FloorPlan> plan,
               std::shared_ptr<const fuzzy::Engine> rules, std::function<Estimate()> locate, TimePoint now);
    /// On the way too; within kSlowest and kFastest, and what objection() lets pass.
    void reconfigure(double velocity_mm_s, double tolerance_mm);
    MotionStep step(const arcos::RobotState& robot, TimePoint now);
    void resume(TimePoint now);

    /// Of the last step.
    const Estimate& estimate() const { return estimate_; }
    double distanceToGoal_mm() const;
    /// Along the route; nothing before there is one.
    std::optional<double> remaining_mm() const { return route_ ? std::optional(rest_mm()) : std::nullopt; }
    const std::optional<Route>& route() const { return route_; }
    int plans() const { return plans_; }
    /// What a person may want to know since the last call: a new route, a blocked way. Empty: nothing.
    std::string takeNews() { return std::exchange(news_, {}); }

  private:
    enum class State { Locating, Planning, Following, Waiting, Stopping, Recoiling, Facing, Settling };

    MotionStep locate(const arcos::RobotState& robot, TimePoint now);
    MotionStep plan(const arcos::RobotState& robot, TimePoint now);
    MotionStep follow(const arcos::RobotState& robot, TimePoint now);
    MotionStep recoil(const arcos::RobotState& robot, TimePoint now);
    MotionStep recover(const arcos::RobotState& robot, std::string what,
                       const std::vector<mapper3::Point>& seen_at, TimePoint now);
    MotionStep face(const arcos::RobotState& robot, TimePoint now);
    MotionStep fail(std::string reason) const;
    MotionStep rest() const;
    void enter(State state, TimePoint now);
    void remember(const arcos::RobotState& robot, TimePoint now);
    void forgetWhatIsGone(const arcos::RobotState& robot, TimePoint now);
    void note(const mapper3::Point& point, int times, bool laser, TimePoint now);
    std::vector<mapper3::Point> remembered() const;
    std::optional<mapper3::Point> onRoute() const;
    void advance();
    mapper3::Point ahead(double way_mm) const;  // so far along the route
    mapper3::Point target() const;              // what it steers for
    double rest_mm() const;
    double progress() const;
    mapper3::Point onMap(double x_mm, double y_mm) const;

    Request request_;
    const std::shared_ptr<const FloorPlan> plan_;
    const std::shared_ptr<const fuzzy::Engine> rules_;
    const std::function<Estimate()> locate_;
    const mapper3::Place goal_;

    Surroundings surroundings_{Surroundings::Echoes::WhereTheLaserSees};
    Estimate estimate_;
    State state_ = State::Locating;
    TimePoint state_since_;
    TimePoint doubtful_since_;  // the scans have not fitted the map since
    std::optional<TimePoint> blocked_since_;
    int first_scans_ = -1;

    std::optional<Route> route_;
    std::size_t leg_ = 0;  // of the route: from points[leg_] to points[leg_ + 1]
    double along_mm_ = 0;  // on it
    double whole_mm_ = 0;  // of the first route
    int plans_ = 0;
    bool turning_ = false;  // on the spot towards the route
    double least_rest_mm_ = 0;
    TimePoint got_on_;
    int tries_ = 0;
    int recoil_direction_ = -1;
    int facing_ = 0;  // the way round to the goal's heading: 1 to the left, -1 to the right, 0 not chosen
    bool turned_back_ = false;  // from the way round that was chosen first

    struct Unmapped {
        TimePoint seen{};
        int times = 0;
        bool laser = false;    // saw it; else only a sonar did, or it was felt
        bool planned = false;  // the present route keeps away from it
    };
    std::map<std::pair<int, int>, Unmapped> unmapped_;  // by cells of the map
    std::string news_;
};

}  // namespace axon::peoplebot
