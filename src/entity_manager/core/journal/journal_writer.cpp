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

JournalRecord refusalOf(const Sender& who, LeaseNumber under, const Refusal& refusal) {
    return {.kind = JournalRecord::Kind::Refused,
            .lease = under,
            .who = named(who),
            .client = who.id,
            .code = std::string(refusalName(refusal.code)),
            .text = refusal.message};
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

void JournalWriter::mention(JournalRecord record) {
    if (journal_ == nullptr) return;
    complete(record);
    journal_->mention(record);
}

void JournalWriter::mentionControl(const Sender& who, const std::string& task_id, std::string_view action) {
    mention({.kind = JournalRecord::Kind::Controlled,
             .who = named(who),
             .client = who.id,
             .task = Id128::fromBytes(task_id).value_or(Id128{}),
             .code = "OK",
             .text = std::string(action)});
}

/// False: it is not one of ownership, or their bound is reached.
bool JournalWriter::noteIfOfOwnership(const JournalRecord& record, RefusalCode code) {
    if (!isOfOwnership(code)) return false;
    if (!refusals_noted_.admit(turn_.now())) {
        ++turn_.count().unrecorded;
        return false;
    }
    note(record);
    return true;
}

void JournalWriter::noteRefusal(const Sender& who, LeaseNumber under, const Refusal& refusal) {
    if (journal_ == nullptr || refusal.ok()) return;
    const auto record = refusalOf(who, under, refusal);
    if (!noteIfOfOwnership(record, refusal.code)) mention(record);
}

void JournalWriter::noteRefusalOfRaw(const Sender& who, LeaseNumber under, const Refusal& refusal) {
    if (journal_ == nullptr) return;
    noteIfOfOwnership(refusalOf(who, under, refusal), refusal.code);
}

}  // namespace axon::entity_manager
