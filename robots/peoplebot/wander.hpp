// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <memory>
#include <random>

#include "robots/fuzzy/engine.hpp"
#include "robots/peoplebot/motion.hpp"
#include "robots/peoplebot/surroundings.hpp"

namespace axon::peoplebot {

/// The rules of wander.rules. Throws fuzzy::BadRules where they lack what wandering needs.
std::shared_ptr<const fuzzy::Engine> loadWanderRules(const std::filesystem::path& file);

/// The fastest that the robot may go towards something at this clearance, so that it can stop before it even
/// if the next news of it is late.
double speedThatStopsWithin(double clearance_mm);

/// The service Wander with Collision Avoidance: drives about, by fuzzy rules over the room to the left, in
/// front and to the right (wander.rules), with bumpers and table sensors as guards.
///
/// States: wandering → backing (something was touched, or a table is overhead) → turning away → wandering;
/// wandering → turning away also when it has not come half a metre further in ten seconds, which is how it
/// gets out of corners; wandering → settling → done when the time is up. Fails when the robot is lost, when
/// no range sensor is heard for a second, and when it cannot get free: kTries recoveries without half a metre
/// between them. I/O-free, not thread-safe, and reproducible for a seed.
class Wander {
  public:
    struct Request {
        double velocity_mm_s = 300;  ///< at most
        double duration_s = 0;       ///< 0: until somebody stops it
        unsigned seed = 1;
    };
    static constexpr double kFastest_mm_s = 500;
    static constexpr double kSlowest_mm_s = 50;
    static constexpr int kTries = 6;

    static std::string objection(const Request& request);

    Wander(const Request& request, std::shared_ptr<const fuzzy::Engine> rules, const arcos::RobotState& start,
           TimePoint now);
    /// On the way too; within kSlowest and kFastest.
    void setVelocity(double velocity_mm_s) {
        request_.velocity_mm_s = std::clamp(velocity_mm_s, kSlowest_mm_s, kFastest_mm_s);
    }
    MotionStep step(const arcos::RobotState& robot, TimePoint now);
    void resume(TimePoint now);

    double travelled_mm() const { return travelled_; }
    int recoveries() const { return recoveries_; }

  private:
    enum class State { Wandering, Waiting, Backing, Turning, Settling };

    MotionStep wander(const arcos::RobotState& robot, const Clearance& room, TimePoint now);
    MotionStep back(const arcos::RobotState& robot, const Clearance& room, TimePoint now);
    MotionStep turn(const arcos::RobotState& robot, const Clearance& room, TimePoint now);
    MotionStep recover(const arcos::RobotState& robot, const Clearance& room, State first, TimePoint now);
    void beginTurn(const arcos::RobotState& robot, const Clearance& room, TimePoint now);
    void chooseFavour(const Clearance& room);
    double random(double least, double most);
    MotionStep fail(std::string reason) const;
    double progress(TimePoint now) const;

    Request request_;
    const std::shared_ptr<const fuzzy::Engine> rules_;
    std::mt19937 chance_;
    Surroundings surroundings_;
    State state_ = State::Wandering;
    TimePoint started_;
    TimePoint state_since_;
    TimePoint silent_since_;

    double last_x_;
    double last_y_;
    double travelled_ = 0;
    // Half a metre away from here it counts as free again.
    double anchor_x_;
    double anchor_y_;
    TimePoint anchored_;
    int recoveries_ = 0;
    int tries_ = 0;

    double favour_ = 0;
    double drift_deg_s_ = 0;
    TimePoint next_drift_;
    int escape_direction_ = -1;  // of backing: away from a bumper in front is backwards
    double turned_from_deg_ = 0;
    double turn_by_deg_ = 0;
    unsigned bumpers_ = 0;  // as they were when the last recovery began
};

}  // namespace axon::peoplebot
