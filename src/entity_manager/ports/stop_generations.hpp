// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "common/planted_bug.hpp"

namespace axon::entity_manager {

/// The stop generation, shared by the signal thread that raises it and the strand that reads it. A stop is
/// known by its sender and sequence number, which counts from 1: the same stop that arrives by two paths
/// raises the generation once (ADR 0007), and one without such a number is always new. So is
/// one under a number that was used before, if its sender knew of that stop and the robot has been rearmed
/// since: no late copy knows that.
/// Threads: any. The mutex is the signal lane's own and is held for a comparison of a few strings. Drills
/// have numbers and a memory of their own, so that they change nothing here.
class StopGenerations {
  public:
    explicit StopGenerations(std::uint32_t first = 0) : generation_(first) {}

    std::uint32_t generation() const { return generation_.load(std::memory_order_acquire); }

    /// The generation of this stop if it is new, nothing if it has been seen before. `known`: the newest
    /// generation that its sender had been told.
    std::optional<std::uint32_t> raise(const std::string& sender, std::int64_t sequence,
                                       std::uint32_t known = 0) {
        if (sequence <= 0) return raise();
        const std::lock_guard lock(mutex_);
        const auto* seen = stops_.find(sender, sequence);
        const bool another = seen != nullptr && seen->generation <= rearmed_ && seen->generation <= known;
        if (seen != nullptr && !another && !AXON_PLANTED(StopNotIdempotent)) return std::nullopt;
        const auto generation = raise();
        stops_.add({sender, sequence, generation});
        return generation;
    }
    /// The number of this drill if it is new.
    std::optional<std::uint32_t> drill(const std::string& sender, std::int64_t sequence) {
        const std::lock_guard lock(mutex_);
        if (sequence > 0 && drills_seen_.find(sender, sequence) != nullptr) return std::nullopt;
        const auto number = drills_.fetch_add(1, std::memory_order_acq_rel) + 1;
        if (sequence > 0) drills_seen_.add({sender, sequence, number});
        return number;
    }
    /// How many drills there have been.
    std::uint32_t drills() const { return drills_.load(std::memory_order_acquire); }
    /// The generation that this stop raised when it was new; nothing if that is too long ago.
    std::optional<std::uint32_t> raisedBy(const std::string& sender, std::int64_t sequence) {
        const std::lock_guard lock(mutex_);
        const auto* seen = stops_.find(sender, sequence);
        return seen != nullptr ? std::optional(seen->generation) : std::nullopt;
    }
    /// What the strand says: somebody has rearmed the robot after all stops up to this generation.
    void rearmed(std::uint32_t generation) { rearmed_.store(generation, std::memory_order_release); }
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
    /// The newest few.
    struct Recent {
        std::array<Seen, 32> seen;
        std::size_t next = 0;

        /// The newest, where a number was used again.
        const Seen* find(const std::string& sender, std::int64_t sequence) const {
            const Seen* found = nullptr;
            for (const auto& one : seen)
                if (sequence > 0 && one.sequence == sequence && one.sender == sender &&
                    (found == nullptr || one.generation > found->generation))
                    found = &one;
            return found;
        }
        void add(Seen one) {
            seen[next] = std::move(one);
            next = (next + 1) % seen.size();
        }
    };
    std::atomic<std::uint32_t> generation_;
    std::atomic<std::uint32_t> rearmed_{0};
    std::atomic<bool> spares_client_loss_{false};
    std::mutex mutex_;
    Recent stops_;        // guarded by mutex_
    Recent drills_seen_;  // guarded by mutex_
    std::atomic<std::uint32_t> drills_{0};
};

}  // namespace axon::entity_manager
