// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>

#include "common/planted_bug.hpp"

namespace axon::entity_manager {

/// The stop generation, shared by the signal thread that raises it and the strand that reads it. A stop is
/// known by its sender and sequence number, which counts from 1: the same stop that arrives by two paths raises
/// the generation once (architecture, section 7), and one without such a number is always new. Threads: any. The mutex is the signal lane's own and is held for a
/// comparison of a few strings.
class StopGate {
  public:
    explicit StopGate(std::uint32_t first = 0) : generation_(first) {}

    std::uint32_t generation() const { return generation_.load(std::memory_order_acquire); }

    /// The generation of this stop if it is new, nothing if it has been seen before.
    std::optional<std::uint32_t> raise(const std::string& sender, std::int64_t sequence) {
        if (sequence <= 0) return raise();
        const std::lock_guard lock(mutex_);
        if (find(sender, sequence) != nullptr && !AXON_PLANTED(StopNotIdempotent)) return std::nullopt;
        const auto generation = raise();
        recent_[next_] = {sender, sequence, generation};
        next_ = (next_ + 1) % recent_.size();
        return generation;
    }
    /// The generation that this stop raised when it was new; nothing if that is too long ago.
    std::optional<std::uint32_t> raisedBy(const std::string& sender, std::int64_t sequence) {
        const std::lock_guard lock(mutex_);
        const auto* seen = find(sender, sequence);
        return seen != nullptr ? std::optional(seen->generation) : std::nullopt;
    }
    /// Before anything else uses it: an earlier life has told generations up to this one.
    void continueFrom(std::uint32_t generation) {
        if (generation > generation_) generation_ = generation;
    }
    /// What the strand says: all running tasks may go on without their client, so that a stop for the loss of
    /// a client is for the strand to decide. Out of date by one turn of the strand at most, and the strand
    /// looks again.
    void spareClientLoss(bool spare) { spares_client_loss_.store(spare, std::memory_order_release); }
    bool sparesClientLoss() const { return spares_client_loss_.load(std::memory_order_acquire); }

    /// A stop of the Entity Manager itself (link or server lost, release, …): always new.
    std::uint32_t raise() { return generation_.fetch_add(1, std::memory_order_acq_rel) + 1; }

  private:
    struct Seen {
        std::string sender;
        std::int64_t sequence = 0;
        std::uint32_t generation = 0;
    };
    const Seen* find(const std::string& sender, std::int64_t sequence) const {
        for (const auto& seen : recent_)
            if (sequence > 0 && seen.sequence == sequence && seen.sender == sender) return &seen;
        return nullptr;
    }
    std::atomic<std::uint32_t> generation_;
    std::atomic<bool> spares_client_loss_{false};
    std::mutex mutex_;
    std::array<Seen, 32> recent_;  // guarded by mutex_
    std::size_t next_ = 0;         // guarded by mutex_
};

}  // namespace axon::entity_manager
