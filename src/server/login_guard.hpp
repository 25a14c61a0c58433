// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <cstdint>
#include <map>
#include <string>
#include <utility>

#include "common/clock.hpp"

namespace axon::server {

/// Slows down who guesses passwords. From the third wrong one in succession for the same user from the same
/// address on, the next try is heard after 1 s, then 2, 4 … up to 60 s; what is tried earlier is not verified
/// and counts as nothing. Others from that address, and the same user from elsewhere, do not wait.
///
/// I/O-free. Threads: none of its own, not thread-safe; its owner confines it. Bound: 4096 pairs; when they
/// are full, those that wait no more are forgotten, and if there are none, all.
class LoginGuard {
  public:
    static constexpr int kFreeFailures = 2;
    static constexpr std::size_t kPairsMax = 4096;

    explicit LoginGuard(const Clock& clock) : clock_(clock) {}

    /// Zero: now.
    Duration mustWait(const std::string& address, const std::string& user) const {
        const auto found = failures_.find({address, user});
        if (found == failures_.end()) return {};
        return std::max(found->second.until - clock_.now(), Duration{});
    }
    void failed(const std::string& address, const std::string& user) {
        const auto now = clock_.now();
        if (failures_.size() >= kPairsMax) {
            std::erase_if(failures_, [&](const auto& entry) { return entry.second.until <= now; });
            if (failures_.size() >= kPairsMax) failures_.clear();
        }
        auto& entry = failures_[{address, user}];
        entry.until = now;
        if (++entry.count <= kFreeFailures) return;
        const int doublings = std::min(entry.count - kFreeFailures - 1, 6);
        entry.until += std::min(std::chrono::seconds{1 << doublings}, std::chrono::seconds{60});
    }
    void succeeded(const std::string& address, const std::string& user) { failures_.erase({address, user}); }

  private:
    struct Failures {
        int count = 0;
        TimePoint until;
    };
    const Clock& clock_;
    std::map<std::pair<std::string, std::string>, Failures> failures_;
};

}  // namespace axon::server
