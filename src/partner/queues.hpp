// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

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

/// How much of what waits for the strand is of each client of home, or of each session there, so that some of
/// them do not fill it for all: an eighth of what is free, and of one of which nothing waits a message of a
/// fourth. The more of them want much, the less each of these gets; but kLeast it always gets. Of what may be
/// dropped, half as much, counted by itself, so that a stream takes nothing from a heartbeat. Bound: `all`,
/// and 2 * kLeast of each of which something waits. Any thread.
class StrandShares {
  public:
    static constexpr std::size_t kLeast = std::size_t{4} * 1024;
    /// Of refusals, beyond the share.
    static constexpr std::size_t kRefusals = std::size_t{64} * 1024;
    static constexpr std::size_t kAllRefusals = std::size_t{4} * 1024 * 1024;
    /// In the place of the bytes of a refusal: there is none.
    static constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();

    enum class Verdict : std::uint8_t {
        Take,           ///< it is in the share: give() it back
        TakeDroppable,  ///< likewise
        Refuse,         ///< it is not; its refusal is: give() that back
        Drop            ///< not even that
    };
    explicit StrandShares(std::size_t all) : all_bytes_(all) {}

    /// `refusal`: bytes of one.
    Verdict take(const std::string& client, std::size_t bytes, std::size_t refusal) {
        const std::lock_guard lock(mutex_);
        const auto found = used_.find(client);
        const auto its = found == used_.end() ? Used{} : found->second;
        const auto share = shareOf(its.taken);
        if (bytes <= share - std::min(its.taken, share)) {
            used_[client].taken += bytes;
            all_.taken += bytes;
            return Verdict::Take;
        }
        if (refusal > kRefusals - its.refused || refusal > kAllRefusals - all_.refused) return Verdict::Drop;
        used_[client].refused += refusal;
        all_.refused += refusal;
        return Verdict::Refuse;
    }
    /// The same of what may be dropped: TakeDroppable or Drop.
    Verdict takeDroppable(const std::string& client, std::size_t bytes) {
        const std::lock_guard lock(mutex_);
        const auto found = used_.find(client);
        const auto its = found == used_.end() ? std::size_t{0} : found->second.droppable;
        const auto share = shareOf(its) / 2;
        if (bytes > share - std::min(its, share)) return Verdict::Drop;
        used_[client].droppable += bytes;
        all_.droppable += bytes;
        return Verdict::TakeDroppable;
    }
    /// `verdict`: as these bytes were taken.
    void give(const std::string& client, std::size_t bytes, Verdict verdict) {
        const std::lock_guard lock(mutex_);
        const auto its = used_.find(client);
        if (its == used_.end() || verdict == Verdict::Drop) return;
        const auto part = verdict == Verdict::Take            ? &Used::taken
                          : verdict == Verdict::TakeDroppable ? &Used::droppable
                                                              : &Used::refused;
        const auto given = std::min(its->second.*part, bytes);
        its->second.*part -= given;
        all_.*part -= given;
        const auto& left = its->second;
        if (left.taken == 0 && left.droppable == 0 && left.refused == 0) used_.erase(its);
    }

  private:
    struct Used {
        std::size_t taken = 0, droppable = 0, refused = 0;  // bytes
    };
    // Under the lock:
    /// Of one of which `its` bytes wait.
    std::size_t shareOf(std::size_t its) const {
        const auto free = all_bytes_ - std::min(all_.taken + all_.droppable, all_bytes_);
        return std::max(kLeast, its == 0 ? free / 4 : free / 8);
    }
    const std::size_t all_bytes_;
    std::mutex mutex_;
    // Guarded by mutex_:
    std::map<std::string, Used> used_;  // by client
    Used all_;
};

/// What becomes of a message by a session there that waits for the strand: it is in the share of this session
/// or is dropped, and of a visitor who is sent more than is dealt with, nobody knows what would be lost, so
/// its session ends. The session that watches does not: it takes receipts here and nothing that it needs, and
/// whoever gets no receipt stops again. Any thread.
class SessionShare {
  public:
    enum class Fate : std::uint8_t {
        Post,
        Drop,
        End  ///< the session; said once
    };
    SessionShare(std::string name, bool ends) : name_(std::move(name)), ends_(ends) {}

    /// If it is to be posted: give() it back to `shares` as `verdict` says.
    Fate admit(StrandShares& shares, std::size_t bytes, bool droppable, StrandShares::Verdict& verdict) {
        verdict =
            droppable ? shares.takeDroppable(name_, bytes) : shares.take(name_, bytes, StrandShares::kNone);
        if (verdict != StrandShares::Verdict::Drop) return Fate::Post;
        return ends_ && !droppable && !ended_.exchange(true) ? Fate::End : Fate::Drop;
    }
    const std::string& name() const { return name_; }

  private:
    const std::string name_;
    const bool ends_;
    std::atomic<bool> ended_{false};
};

}  // namespace axon::partner
