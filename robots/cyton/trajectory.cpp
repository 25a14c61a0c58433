// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/trajectory.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace axon::cyton {
namespace {

// Of x³(10 - 15x + 6x²), which goes from 0 to 1 with no velocity and no acceleration at both ends.
constexpr double kPeakVelocity = 1.875;
constexpr double kPeakAcceleration = 5.7735;

double leastJerk(double x) {
    return x * x * x * (10 + x * (6 * x - 15));
}

Posture between(const Posture& a, const Posture& b, double part) {
    Posture posture;
    for (std::size_t i = 0; i < kJoints; ++i) posture.joints[i] = std::lerp(a.joints[i], b.joints[i], part);
    posture.opening_mm = std::lerp(a.opening_mm, b.opening_mm, part);
    return posture;
}

}  // namespace

double leastTime_s(const Posture& from, const Posture& to) {
    double longest = std::abs(to.opening_mm - from.opening_mm) / gripper::kFastest_mm_s;
    for (std::size_t i = 0; i < kJoints; ++i)
        longest = std::max(longest, std::abs(to.joints[i] - from.joints[i]) / fastest_rad_s(kChain[i]));
    return longest;
}

Trajectory::Trajectory(std::vector<Posture> path, double speed) : path_(std::move(path)), speed_(speed) {
    if (path_.empty() || !(speed > 0) || speed > 1)
        throw std::invalid_argument("a trajectory needs a posture and a speed above 0, at most 1");
    reached_.push_back(0);
    for (std::size_t i = 1; i < path_.size(); ++i) {
        way_s_ += leastTime_s(path_[i - 1], path_[i]);
        reached_.push_back(way_s_);
    }
    if (way_s_ <= 0) {
        path_ = {path_.back()};
        reached_ = {0};
        return;
    }
    for (auto& reached : reached_) reached /= way_s_;
    duration_s_ = durationAt(speed_);
}

double Trajectory::durationAt(double speed) const {
    // The fastest joint's way, at its highest rate for way_s_; the acceleration of the others is less.
    double widest_rad = 0;
    for (const auto& joint : kChain) widest_rad = std::max(widest_rad, way_s_ * fastest_rad_s(joint));
    return std::max(kPeakVelocity * way_s_ / speed,
                    std::sqrt(kPeakAcceleration * widest_rad / kAcceleration_rad_s2));
}

double Trajectory::paceAt(double times) const {
    return duration_s_ > 0 ? duration_s_ / durationAt(std::min(speed_ * times, 1.0)) : 1;
}

Posture Trajectory::at(double time_s) const {
    if (time_s <= 0 && duration_s_ > 0) return path_.front();
    if (time_s >= duration_s_) return path_.back();
    const double part = leastJerk(time_s / duration_s_);
    const auto next = std::upper_bound(reached_.begin(), reached_.end(), part);
    if (next == reached_.end()) return path_.back();
    const auto i = static_cast<std::size_t>(next - reached_.begin());
    return between(path_[i - 1], path_[i], (part - reached_[i - 1]) / (reached_[i] - reached_[i - 1]));
}

Playback::Playback(std::vector<Leg> legs) : legs_(std::move(legs)) {
    if (legs_.empty()) throw std::invalid_argument("a motion needs a leg");
    for (const auto& leg : legs_) total_s_ += leg.way.duration_s() + leg.rest_s;
}

Playback::Step Playback::advance(double time_s, bool paused, double times) {
    const auto approach = [&](double& value, double wanted, double span) {
        value += std::clamp(wanted - value, -span * time_s / kRamp_s, span * time_s / kRamp_s);
    };
    const auto wanted = [&] { return legs_[leg_].keeps_speed ? 1 : legs_[leg_].way.paceAt(times); };
    approach(going_, paused ? 0 : 1, 1);
    approach(pace_, wanted(), std::max({1.0, wanted(), pace_}));
    const auto& way = legs_[leg_].way;
    const double on_way_s = std::min(std::max(0.0, way.duration_s() - gone_s_), time_s * going_ * pace_);
    gone_s_ += on_way_s + std::max(0.0, time_s * going_ - on_way_s / pace_);
    const auto lasts = [this] { return legs_[leg_].way.duration_s() + legs_[leg_].rest_s; };
    while (leg_ + 1 < legs_.size() && gone_s_ >= lasts()) {
        gone_s_ -= lasts();
        before_s_ += lasts();
        ++leg_;
        pace_ = wanted();  // it stands between two legs
    }
    Step step;
    step.leg = leg_;
    step.posture = legs_[leg_].way.at(gone_s_);
    step.done = leg_ + 1 == legs_.size() && gone_s_ >= lasts();
    step.progress = step.done || total_s_ <= 0 ? 1 : std::min(1.0, (before_s_ + gone_s_) / total_s_);
    step.resting = paused && going_ <= 0;
    return step;
}

}  // namespace axon::cyton
