// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <functional>
#include <mutex>
#include <string>
#include <utility>

#include "audit/note.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// A journal whose entries go into the audit trail as well (docs/adr/0041-audit.md): what the Entity Manager
/// decides is known there already, so the core needs no further port.
///
/// What the journal does not take is in the trail all the same, except a dispatch: it is noted when the
/// journal has it, and not at all where its task may not begin (the end of that task says why). What is only
/// mentioned is in the trail and not in the journal.
/// Threads: as the journal, whose thread notes dispatches. Failure: as the journal; the trail has none.
class AuditedJournal final : public Journal {
  public:
    /// `entity`: its UUID, as far as it is known.
    AuditedJournal(Journal& journal, audit::AuditTrail& trail, std::string entity)
        : journal_(journal), trail_(trail), entity_(std::move(entity)) {}
    ~AuditedJournal() override { AuditedJournal::onAnswer({}); }
    AuditedJournal(const AuditedJournal&) = delete;
    AuditedJournal& operator=(const AuditedJournal&) = delete;
    /// Before the core's strand runs.
    void setEntity(std::string entity) { entity_ = std::move(entity); }

    bool append(const JournalRecord& record) override;
    Later<bool> appendDispatch(const JournalRecord& record) override;
    void mention(const JournalRecord& record) override;
    void onAnswer(std::function<void()> come) override;
    void replay(const std::function<void(const JournalRecord&)>& each) override { journal_.replay(each); }

  private:
    struct Dispatch {
        JournalRecord record;
        Later<bool> written;
    };
    void note(const JournalRecord& record) const;
    void noteWritten();

    Journal& journal_;
    audit::AuditTrail& trail_;
    std::string entity_;
    std::mutex mutex_;
    std::deque<Dispatch> dispatches_;  // guarded by mutex_; as many as the journal lets wait
};

}  // namespace axon::entity_manager
