// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <string>

#include "partner/ports.hpp"

namespace axon::partner {

/// Which visitors' sessions are opened next: kAtOnce at a time, in order. One that is forgotten before it is
/// its turn is not opened, so no more wait than there are visitors. One strand.
class Openings {
  public:
    static constexpr std::size_t kAtOnce = 2;

    void add(SessionNumber session) { waiting_.push_back(session); }
    void forget(SessionNumber session) { std::erase(waiting_, session); }
    /// Begins with it: done() says when that has ended.
    std::optional<SessionNumber> next() {
        if (waiting_.empty() || begun_ >= kAtOnce) return std::nullopt;
        const auto session = waiting_.front();
        waiting_.pop_front();
        ++begun_;
        return session;
    }
    void done() { --begun_; }
    std::size_t waiting() const { return waiting_.size(); }

  private:
    std::deque<SessionNumber> waiting_;
    std::size_t begun_ = 0;
};

/// How much of what waits for the strand is of each client of home, so that one of them does not fill it for
/// all. Bound: the clients of which something waits. Any thread.
class ClientShares {
  public:
    static constexpr std::size_t kShare = std::size_t{4} * 1024 * 1024;
    /// Of refusals, beyond the share.
    static constexpr std::size_t kRefusals = std::size_t{64} * 1024;

    enum class Verdict : std::uint8_t {
        Take,    ///< it is in the share: give() it back
        Refuse,  ///< it is not; its refusal is: give() that back
        Drop     ///< not even that
    };
    /// A client of which nothing waits may send a message of any size. `refusal`: bytes of one.
    Verdict take(const std::string& client, std::size_t bytes, std::size_t refusal) {
        const std::lock_guard lock(mutex_);
        auto& used = used_[client];
        if (used == 0 || used + bytes <= kShare) {
            used += bytes;
            return Verdict::Take;
        }
        if (used + refusal > kShare + kRefusals) return Verdict::Drop;
        used += refusal;
        return Verdict::Refuse;
    }
    void give(const std::string& client, std::size_t bytes) {
        const std::lock_guard lock(mutex_);
        const auto its = used_.find(client);
        if (its == used_.end()) return;
        its->second -= std::min(its->second, bytes);
        if (its->second == 0) used_.erase(its);
    }

  private:
    std::mutex mutex_;
    std::map<std::string, std::size_t> used_;  // guarded by mutex_; bytes, by client
};

}  // namespace axon::partner
