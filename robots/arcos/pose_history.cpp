// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/pose_history.hpp"

#include <algorithm>

namespace axon::arcos {

void PoseHistory::add(TimePoint at, const Pose& pose) {
    if (!entries_.empty() && at <= entries_.back().at) return;
    entries_.push_back({at, pose});
    while (entries_.size() > 1 && at - entries_.front().at > kMemory) entries_.pop_front();
}

std::optional<PoseHistory::Pose> PoseHistory::at(TimePoint when) const {
    if (entries_.empty()) return std::nullopt;
    const auto after =
        std::find_if(entries_.begin(), entries_.end(), [&](const Entry& entry) { return entry.at >= when; });
    if (after == entries_.begin()) return after->pose;
    if (after == entries_.end()) return entries_.back().pose;
    const auto& from = *(after - 1);
    const double part =
        std::chrono::duration<double>(when - from.at) / std::chrono::duration<double>(after->at - from.at);
    const auto between = [part](double a, double b) { return a + part * (b - a); };
    return Pose{between(from.pose.x_mm, after->pose.x_mm), between(from.pose.y_mm, after->pose.y_mm),
                between(from.pose.heading_deg, after->pose.heading_deg)};
}

}  // namespace axon::arcos
