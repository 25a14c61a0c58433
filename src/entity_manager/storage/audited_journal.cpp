// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/audited_journal.hpp"

namespace axon::entity_manager {

namespace {

audit::Kind kindOf(JournalRecord::Kind kind) {
    switch (kind) {
        case JournalRecord::Kind::Started:
            return audit::Kind::Started;
        case JournalRecord::Kind::Granted:
        case JournalRecord::Kind::Lost:
        case JournalRecord::Kind::Resumed:
        case JournalRecord::Kind::LeaseEnded:
            return audit::Kind::Ownership;
        case JournalRecord::Kind::TakenOver:
            return audit::Kind::TakeOver;
        case JournalRecord::Kind::Refused:
            return audit::Kind::Refusal;
        case JournalRecord::Kind::Stopped:
            return audit::Kind::Stop;
        case JournalRecord::Kind::Rearmed:
            return audit::Kind::Rearm;
        case JournalRecord::Kind::Dispatched:
        case JournalRecord::Kind::TaskEnded:
        case JournalRecord::Kind::Part:
        case JournalRecord::Kind::Controlled:
            break;
    }
    return audit::Kind::Command;
}

}  // namespace

void AuditedJournal::note(const JournalRecord& record) const {
    std::string what(toString(record.kind));
    if (!record.service.empty()) what += " " + record.service;
    if (!record.task.isZero()) what += " (task " + record.task.toString() + ")";
    if (record.kind == JournalRecord::Kind::Stopped)
        what += ", generation " + std::to_string(record.generation);
    if (!record.text.empty()) what += ": " + record.text;
    trail_.note({.kind = kindOf(record.kind),
                 .name = record.who,
                 .client = record.client,
                 .entity = entity_,
                 .what = what,
                 .outcome = record.code});
}

/// The dispatches that have their answer. Holds the mutex while it notes: on whichever thread, they are in
/// the trail before anything that follows from them.
void AuditedJournal::noteWritten() {
    const std::lock_guard lock(mutex_);
    while (!dispatches_.empty() && dispatches_.front().written.ready()) {
        if (dispatches_.front().written.value()) note(dispatches_.front().record);
        dispatches_.pop_front();
    }
}

bool AuditedJournal::append(const JournalRecord& record) {
    const bool written = journal_.append(record);
    noteWritten();
    note(record);
    return written;
}

Later<bool> AuditedJournal::appendDispatch(const JournalRecord& record) {
    auto written = journal_.appendDispatch(record);
    {
        const std::lock_guard lock(mutex_);
        dispatches_.push_back({record, written});
    }
    noteWritten();
    return written;
}

void AuditedJournal::mention(const JournalRecord& record) {
    noteWritten();
    note(record);
}

void AuditedJournal::onAnswer(std::function<void()> come) {
    if (!come) {
        journal_.onAnswer({});  // returns when no call is under way
        return noteWritten();
    }
    journal_.onAnswer([this, come = std::move(come)] {
        noteWritten();
        come();
    });
}

}  // namespace axon::entity_manager
