// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/journal/journal_writer.hpp"

#include <utility>

#include "common/planted_bug.hpp"
#include "entity_manager/ports/core_settings.hpp"

namespace axon::entity_manager {

namespace {

bool isOfOwnership(RefusalCode code) {
    return (code >= RefusalCode::NotHolder && code <= RefusalCode::HandOverRefused) ||
           code == RefusalCode::PermissionDenied;
}

}  // namespace

void JournalWriter::begin(TaskMemory& memory, LeaseNumber last, std::string text) {
    if (journal_ == nullptr || AXON_PLANTED(JournalNotRead)) return;
    journal_->replay([&memory](const JournalRecord& record) {
        if (record.kind == JournalRecord::Kind::Dispatched) memory.dispatched(record.task);
        if (record.kind != JournalRecord::Kind::TaskEnded) return;
        auto state = proto::TASK_UNKNOWN;  // of a later version, perhaps
        proto::TaskState_Parse(record.code, &state);
        memory.ended(record.task, state);
    });
    note({.kind = JournalRecord::Kind::Started, .lease = last, .text = std::move(text)});
    for (const auto& id : memory.unfinished()) {
        memory.ended(id, proto::TASK_UNKNOWN);
        note({.kind = JournalRecord::Kind::TaskEnded,
              .task = id,
              .code = proto::TaskState_Name(proto::TASK_UNKNOWN),
              .text = "The Entity Manager ended while it ran."});
    }
}

void JournalWriter::complete(JournalRecord& record) const {
    if (record.lease == LeaseNumber{} && turn_.held() != nullptr) record.lease = turn_.held()->number;
    if (record.generation == 0) record.generation = turn_.stops().generation;
    record.at_us = toMicroseconds(turn_.now());
}

bool JournalWriter::note(JournalRecord record) {
    if (journal_ == nullptr) return true;
    complete(record);
    return recorded(journal_->append(record));
}

Later<bool> JournalWriter::noteDispatch(JournalRecord record) {
    if (journal_ == nullptr) return true;
    complete(record);
    return journal_->appendDispatch(record);
}

bool JournalWriter::recorded(bool written) {
    if (!written) ++turn_.count().unrecorded;
    if (!written && !failing_)
        turn_.warn("the journal cannot be written; no task begins until it can. Is the disk full?");
    failing_ = !written;
    return written;
}

void JournalWriter::noteRefusal(const Sender& who, LeaseNumber under, const Refusal& refusal) {
    if (!isOfOwnership(refusal.code) || journal_ == nullptr) return;
    if (!refusals_noted_.admit(turn_.now())) {
        ++turn_.count().unrecorded;
        return;
    }
    note({.kind = JournalRecord::Kind::Refused,
          .lease = under,
          .who = named(who),
          .code = std::string(refusalName(refusal.code)),
          .text = refusal.message});
}

}  // namespace axon::entity_manager
