// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/kinematics.hpp"

#include <kdl/chain.hpp>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <kdl/chainiksolverpos_lma.hpp>

#include <algorithm>
#include <cmath>

namespace axon::cyton {
namespace {

constexpr double kPositionTolerance_m = 1e-4;
constexpr double kRotationTolerance_rad = 2e-3;
constexpr int kIterations = 100;

KDL::Vector vector(const Point& point) {
    return {point[0], point[1], point[2]};
}
Point point(const KDL::Vector& vector) {
    return {vector.x(), vector.y(), vector.z()};
}

KDL::Chain chain() {
    KDL::Chain chain;
    for (const auto& joint : kChain) {
        // All frames are parallel to the base's with the joints at zero, so that offsets and axes are told in
        // it.
        chain.addSegment(KDL::Segment(
            KDL::Joint(joint.name, vector(joint.offset), vector(joint.axis), KDL::Joint::RotAxis),
            KDL::Frame(vector(joint.offset))));
    }
    chain.addSegment(KDL::Segment(KDL::Joint(KDL::Joint::None), KDL::Frame(vector(kToolOffset))));
    return chain;
}

KDL::JntArray array(const Joints& joints) {
    KDL::JntArray out(kJoints);
    for (unsigned i = 0; i < kJoints; ++i) out(i) = joints[i];
    return out;
}

KDL::Frame frame(const ToolPose& pose, bool turned) {
    const auto z = vector(pose.approach);
    const auto x = turned ? -vector(pose.closing) : vector(pose.closing);
    return {KDL::Rotation(x, z * x, z), vector(pose.position)};
}

}  // namespace

struct Kinematics::Solvers {
    // A millimetre weighs as much as a tenth of a degree: both must be met.
    Solvers() : chain(cyton::chain()), forward(chain), inverse(chain, weights(), 1e-7, kIterations, 1e-9) {}
    static Eigen::Matrix<double, 6, 1> weights() {
        Eigen::Matrix<double, 6, 1> weights;
        weights << 1, 1, 1, 0.1, 0.1, 0.1;
        return weights;
    }
    const KDL::Chain chain;
    mutable KDL::ChainFkSolverPos_recursive forward;
    KDL::ChainIkSolverPos_LMA inverse;
};

Kinematics::Kinematics(std::uint32_t seed) : solvers_(std::make_unique<Solvers>()), random_(seed) {}
Kinematics::~Kinematics() = default;

ToolPose Kinematics::forward(const Joints& joints) const {
    KDL::Frame tool;
    solvers_->forward.JntToCart(array(joints), tool);
    return {point(tool.p), point(tool.M.UnitZ()), point(tool.M.UnitX())};
}

std::array<Point, kJoints + 1> Kinematics::skeleton(const Joints& joints) const {
    const auto values = array(joints);
    std::array<Point, kJoints + 1> points;
    for (unsigned i = 0; i <= kJoints; ++i) {
        KDL::Frame frame;
        solvers_->forward.JntToCart(values, frame, static_cast<int>(i) + 1);
        points[i] = point(frame.p);
    }
    return points;
}

std::optional<Joints> Kinematics::attempt(const ToolPose& pose, bool turned, const Joints& start) {
    const auto wanted = frame(pose, turned);
    KDL::JntArray found(kJoints);
    solvers_->inverse.CartToJnt(array(start), wanted, found);
    Joints joints;
    for (unsigned i = 0; i < kJoints; ++i) joints[i] = std::remainder(found(i), 2 * std::numbers::pi);
    if (!withinLimits(joints, kMargin_rad)) return std::nullopt;
    // Not the solver's verdict: it also gives up where it is as near as anybody needs.
    KDL::Frame reached;
    solvers_->forward.JntToCart(array(joints), reached);
    const auto difference = KDL::diff(wanted, reached);
    if (difference.vel.Norm() > kPositionTolerance_m || difference.rot.Norm() > kRotationTolerance_rad)
        return std::nullopt;
    return joints;
}

bool Kinematics::nearerTurned(const ToolPose& pose, const Joints& from) const {
    return KDL::dot(vector(forward(from).closing), vector(pose.closing)) < 0;
}

std::optional<Joints> Kinematics::follow(const ToolPose& pose, const Joints& from) {
    return attempt(pose, nearerTurned(pose, from), from);
}

std::vector<Joints> Kinematics::solutions(const ToolPose& pose, const Joints& wanted, Effort effort) {
    std::vector<Joints> found;
    for (int i = 0; i <= effort.starts && static_cast<int>(found.size()) < effort.solutions; ++i) {
        const auto start = i == 0 ? wanted : randomJoints();
        // The claws are alike: the hand may be turned half round, whichever way it is nearer to.
        if (const auto joints = attempt(pose, nearerTurned(pose, start), start)) found.push_back(*joints);
    }
    const auto distance = [&wanted](const Joints& joints) {
        double sum = 0;
        for (std::size_t i = 0; i < kJoints; ++i) sum += (joints[i] - wanted[i]) * (joints[i] - wanted[i]);
        return sum;
    };
    std::sort(found.begin(), found.end(),
              [&distance](const Joints& a, const Joints& b) { return distance(a) < distance(b); });
    return found;
}

std::optional<Joints> Kinematics::solve(const ToolPose& pose, const Joints& wanted, Effort effort) {
    const auto found = solutions(pose, wanted, effort);
    return found.empty() ? std::nullopt : std::optional(found.front());
}

Joints Kinematics::randomJoints() {
    Joints joints;
    for (std::size_t i = 0; i < kJoints; ++i) {
        // Not std::uniform_real_distribution, whose numbers are each library's own.
        const double part = static_cast<double>(random_() >> 5) / static_cast<double>(1U << 27);
        joints[i] = kChain[i].minimum + part * (kChain[i].maximum - kChain[i].minimum);
    }
    return joints;
}

double largestDifference(const Joints& a, const Joints& b) {
    double largest = 0;
    for (std::size_t i = 0; i < kJoints; ++i) largest = std::max(largest, std::abs(a[i] - b[i]));
    return largest;
}

bool withinLimits(const Joints& joints, double margin_rad) {
    for (std::size_t i = 0; i < kJoints; ++i) {
        if (joints[i] < kChain[i].minimum + margin_rad || joints[i] > kChain[i].maximum - margin_rad)
            return false;
    }
    return true;
}

}  // namespace axon::cyton
