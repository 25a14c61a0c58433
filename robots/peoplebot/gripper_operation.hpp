// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "robots/arcos/client_session.hpp"
#include "robots/peoplebot/motion.hpp"

namespace axon::peoplebot {

/// Something to tell the gripper; with a value for the two orders that have one.
struct GripperCommand {
    arcos::GripperOrder order{};
    std::optional<int> value{};  ///< LiftCarry, Press: in units of 20 ms

    bool operator==(const GripperCommand&) const = default;
};

/// The service Operate Gripper: opens or closes the paddles, moves the lift to one of its ends, or both.
///
/// Up: the paddles first, then the lift, so that what is grabbed is lifted. Down: the lift first, so that
/// what is held is set down before it is let go; a lift that what it carries holds up (it comes to rest on a
/// table) has arrived, and is relieved a little, since paddles that press on a table do not open. Each part
/// is done when the gripper's own state says so, and failed when it does not say so in time, tells an error,
/// or rests elsewhere. Closed on nothing is closed: holding() tells.
///
/// I/O-free, not thread-safe: what the robot says comes in, orders go out. Whoever calls halts the gripper
/// when the operation failed or was stopped.
class GripperOperation {
  public:
    enum class Direction { None, Up, Down };
    struct Request {
        Direction direction = Direction::None;
        std::optional<bool> open{};  ///< none: the paddles stay as they are
    };
    struct Step {
        MotionStep::Outcome outcome = MotionStep::Outcome::Running;
        std::vector<GripperCommand> commands{};
        double progress = 0;
        std::string reason{};
    };
    /// The lift needs ten seconds for its whole way, the paddles five.
    static constexpr Duration kTimeLimit = std::chrono::seconds{15};
    /// An order shows in the robot's state after at most so long; what rests then will not move any more.
    static constexpr Duration kReaction = std::chrono::milliseconds{1000};
    /// How long a lift that was held up goes back, in units of 20 ms: as far as its motor gave way, and no
    /// more.
    static constexpr int kRelief = 20;

    /// "up", "down", "none", in any case; "true" for down and "false" for up, since figure A.1 of the thesis
    /// has a flag here and sets down with it what was carried. Nothing for other words.
    static std::optional<Direction> parseDirection(std::string_view text);
    /// Why this cannot be done, empty if it can.
    static std::string objection(const Request& request, const arcos::RobotState& robot);

    explicit GripperOperation(const Request& request);
    Step step(const arcos::RobotState& robot, TimePoint now);

    /// Both paddles feel something, and not each other: it breaks a beam.
    static bool holding(const arcos::GripperState& gripper) {
        return gripper.closed && gripper.left_pressed && gripper.right_pressed &&
               (gripper.outer_beam || gripper.inner_beam);
    }

  private:
    enum class Part { Open, Close, Up, Down, Relieve };
    enum class Verdict { Moving, Done, Stuck };
    static Verdict judge(Part part, const arcos::GripperState& gripper, bool rested);

    std::vector<Part> parts_;
    std::size_t current_ = 0;
    bool ordered_ = false;
    TimePoint since_{};   // the current part was ordered
    TimePoint moving_{};  // last seen moving, or ordered
};

}  // namespace axon::peoplebot
