// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <memory>
#include <optional>
#include <random>
#include <span>
#include <vector>

#include "robots/cyton/geometry.hpp"

namespace axon::cyton {

using Point = std::array<double, 3>;  ///< m, in the frame of the base; or a direction

/// Where the point between the pads is, and how the tool stands there. Both directions are unit vectors and
/// perpendicular to each other.
struct ToolPose {
    Point position{};
    Point approach{0, 0, 1};  ///< from the wrist to the pads
    Point closing{1, 0, 0};   ///< the line along which the claws close, either way
};

/// Forward and inverse kinematics of the arm, by KDL.
///
/// Redundant with seven joints: of the solutions within the joint limits, which Levenberg-Marquardt finds
/// from random starts, the one nearest to a wanted posture is taken. The random numbers come from a generator
/// with a fixed seed, so that the same calls give the same joints. Threads: none; each user has its own.
class Kinematics {
  public:
    static constexpr std::uint32_t kSeed = 7;
    /// How far within their limits inverse kinematics keeps the joints, so that rounding to pulses never
    /// leaves them.
    static constexpr double kMargin_rad = 0.005;

    explicit Kinematics(std::uint32_t seed = kSeed);
    ~Kinematics();
    Kinematics(const Kinematics&) = delete;
    Kinematics& operator=(const Kinematics&) = delete;

    ToolPose forward(const Joints& joints) const;
    /// The seven joints, then the tool: what a link must not touch can be told from them.
    std::array<Point, kJoints + 1> skeleton(const Joints& joints) const;

    struct Effort {
        int starts = 60;    ///< at most so many random starts
        int solutions = 4;  ///< and no more when so many solutions were found
    };
    /// Joints within their limits that bring the tool there to within 0.1 mm and 0.1 degrees, those nearest
    /// to `wanted`, which is also the first start, before the others. Empty when none were found.
    std::vector<Joints> solutions(const ToolPose& pose, const Joints& wanted, Effort effort);
    std::optional<Joints> solve(const ToolPose& pose, const Joints& wanted, Effort effort);
    /// From these joints only, without random starts: the next point of a line. Nothing when a joint leaves
    /// its limits.
    std::optional<Joints> follow(const ToolPose& pose, const Joints& from);

    /// Within limits, evenly; for tests and trials.
    Joints randomJoints();

  private:
    struct Solvers;
    std::optional<Joints> attempt(const ToolPose& pose, bool turned, const Joints& start);
    bool nearerTurned(const ToolPose& pose, const Joints& from) const;

    std::unique_ptr<Solvers> solvers_;
    std::mt19937 random_;
};

/// Largest difference of one joint, rad.
double largestDifference(const Joints& a, const Joints& b);
bool withinLimits(const Joints& joints, double margin_rad = 0);

}  // namespace axon::cyton
