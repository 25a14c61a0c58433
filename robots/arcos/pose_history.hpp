// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <optional>

#include "common/clock.hpp"

namespace axon::arcos {

/// Where the robot was, by its odometry, during the last two seconds: a sweep of a laser on a serial line
/// arrives a tenth of a second after it was made, and the robot has turned up to ten degrees meanwhile.
/// I/O-free, not thread-safe.
class PoseHistory {
  public:
    static constexpr Duration kMemory = std::chrono::seconds{2};

    struct Pose {
        double x_mm = 0, y_mm = 0;
        double heading_deg = 0;  ///< accumulated over full turns
    };

    /// Times must not go back; what does is ignored.
    void add(TimePoint at, const Pose& pose);
    /// Between two poses: on the straight way from one to the other. Before the first and after the last:
    /// that one. Nothing while there is none.
    std::optional<Pose> at(TimePoint when) const;
    void clear() { entries_.clear(); }

  private:
    struct Entry {
        TimePoint at;
        Pose pose;
    };
    std::deque<Entry> entries_;
};

}  // namespace axon::arcos
