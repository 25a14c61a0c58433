// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <cstdint>

#include "common/clock.hpp"

namespace axon {

/// Notices that a peer's counter no longer grows. Of the time between two looks at most a quarter of the
/// limit counts: while the whole machine stands still, the peer could not count and this side did not look.
///
/// It is not a Liveness, which has to be told when each sign of life came. The peer only counts in shared
/// memory, so this side does not know that time: the silence is the sum of the times between its looks.
///
/// I/O-free, without allocation, not thread-safe.
class SilenceCount {
  public:
    explicit SilenceCount(Duration limit) : limit_(limit) {}

    void restart(std::uint64_t count, TimePoint now) {
        count_ = count;
        looked_ = now;
        silent_ = Duration::zero();
    }
    /// True once the counter has stood for the limit. To be called several times within it.
    bool look(std::uint64_t count, TimePoint now) {
        if (count != count_) {
            restart(count, now);
            return false;
        }
        silent_ += std::min(now - looked_, limit_ / 4);
        looked_ = now;
        return silent_ >= limit_;
    }

  private:
    Duration limit_;
    std::uint64_t count_ = 0;
    TimePoint looked_{};
    Duration silent_{};
};

}  // namespace axon
