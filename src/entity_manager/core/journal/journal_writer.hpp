// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <string_view>

#include "common/rate_limit.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "entity_manager/core/services/task_memory.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/journal_record.hpp"
#include "entity_manager/ports/later.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// What the Entity Manager has decided, on its way into the journal (ADR 0013).
///
/// Each entry gets here what every entry has: the present lease, the stop generation and the time, where they
/// are empty. What the journal does not take is counted, and warned of once until it takes something again.
/// Without a journal everything counts as written. Threads: the core's strand. Bounded: 10 refusals a second.
class JournalWriter {
  public:
    /// `journal`: null = none is kept.
    JournalWriter(Turn& turn, Journal* journal) : turn_(turn), journal_(journal) {}

    /// Once, before any other: gives `memory` what earlier lives have dispatched, so that none of it is
    /// dispatched again, and ends there and in the journal what has no end. `text` is noted of this life.
    void begin(TaskMemory& memory, LeaseNumber last, std::string text);

    /// False: it is not going to be written.
    bool note(JournalRecord record);
    /// The entry that goes before a task or a run. It may begin when this has come and recorded() says so.
    Later<bool> noteDispatch(JournalRecord record);
    /// Counts, and warns of, what the journal does not take; returns what it is told.
    bool recorded(bool written);
    /// Refusals of ownership are noted, as far as their bound goes; others are mentioned.
    void noteRefusal(const Sender& who, LeaseNumber under, const Refusal& refusal);
    /// Of raw data, which may be refused many times in a second: those of ownership are noted, and nothing
    /// else.
    void noteRefusalOfRaw(const Sender& who, LeaseNumber under, const Refusal& refusal);
    /// A pause, resume or cancel that is carried out.
    void mentionControl(const Sender& who, const std::string& task_id, std::string_view action);
    /// A task has ended that had not begun.
    void mention(JournalRecord record);

  private:
    void complete(JournalRecord& record) const;
    bool noteIfOfOwnership(const JournalRecord& record, RefusalCode code);

    Turn& turn_;
    Journal* const journal_;
    bool failing_ = false;
    RateLimit refusals_noted_{10};
};

}  // namespace axon::entity_manager
