// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/task.pb.h>

#include <cstddef>
#include <deque>
#include <optional>
#include <unordered_map>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"

namespace axon::entity_manager {

/// What became of the tasks: the ids that may not run again, and how the last ones of the present lease
/// ended.
///
/// Where in the flow: EntityManagerCore asks it before a task is accepted, fills it from the journal at its
/// start, and tells a holder that has come back what ended while it was away. States of an id: accepted →
/// dispatched → ended, or ended at once. Threads: the core's strand. Bounded: kIds ids, kFinals final events
/// of at most kFinalBytes each (of a larger one results and feedback are left out); the oldest are forgotten.
class TaskMemory {
  public:
    static constexpr std::size_t kIds = 16'384;
    static constexpr std::size_t kFinals = 64;
    static constexpr std::size_t kFinalBytes = 32 * 1024;

    void accept(const Id128& id) { remember(id, Fate{}); }
    void dispatched(const Id128& id) { remember(id, Fate{.dispatched = true}); }
    /// `event` is final.
    void ended(const Id128& id, LeaseNumber lease, const proto::TaskEvent& event, TimePoint at);
    /// Of an earlier life, from its journal.
    void ended(const Id128& id, proto::TaskState state) {
        remember(id, Fate{.dispatched = true, .end = state});
    }

    bool wasDispatched(const Id128& id) const;
    /// Why a task of this id is not run: DUPLICATE, or OUTCOME_UNKNOWN where it ran and nobody knows how it
    /// ended.
    std::optional<Refusal> whyNotAgain(const Id128& id) const;
    /// Dispatched, and no end is known, oldest first.
    std::vector<Id128> unfinished() const;
    /// How the last tasks of this lease ended, oldest first; those that ended since.
    std::vector<proto::TaskEvent> finals(LeaseNumber lease, TimePoint since = TimePoint::min()) const;

  private:
    struct Fate {
        bool dispatched = false;
        proto::TaskState end = proto::TASK_UNSPECIFIED;  ///< unspecified = it has not ended
    };
    void remember(const Id128& id, Fate fate);

    std::unordered_map<Id128, Fate> fates_;
    std::deque<Id128> order_;
    LeaseNumber lease_;  ///< of finals_
    struct Final {
        proto::TaskEvent event;
        TimePoint at;
    };
    std::deque<Final> finals_;
};

}  // namespace axon::entity_manager
