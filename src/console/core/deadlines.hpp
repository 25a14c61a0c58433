// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <map>
#include <vector>

#include "common/clock.hpp"

namespace axon::console {

/// Until when a connection must have got further, so that nobody holds one with a byte now and then: a
/// request must be complete 15 s after the connection was opened or the answer before was sent, and an
/// answer sent two minutes after its request was complete. Bytes alone extend nothing.
///
/// I/O-free; its owner confines it to one thread. Bound: one entry for each connection.
class Deadlines {
  public:
    static constexpr std::chrono::seconds kRequest{15};
    static constexpr std::chrono::seconds kAnswer{120};

    explicit Deadlines(const Clock& clock) : clock_(clock) {}

    /// A connection is identified by its descriptor.
    void opened(int connection) { set(connection, kRequest); }
    void asked(int connection) { set(connection, kAnswer); }
    void answered(int connection) { set(connection, kRequest); }
    void closed(int connection) { ends_.erase(connection); }

    /// Those that are too late, each of them once.
    std::vector<int> late() {
        std::vector<int> all;
        for (auto& [connection, ends] : ends_) {
            if (ends > clock_.now()) continue;
            all.push_back(connection);
            ends = TimePoint::max();
        }
        return all;
    }
    /// When late() may have something to say; TimePoint::max() where there is no connection.
    TimePoint next() const {
        auto first = TimePoint::max();
        for (const auto& [connection, ends] : ends_) first = std::min(first, ends);
        return first;
    }

  private:
    void set(int connection, Duration from_now) { ends_[connection] = clock_.now() + from_now; }

    const Clock& clock_;
    std::map<int, TimePoint> ends_;
};

}  // namespace axon::console
