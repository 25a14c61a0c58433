// SPDX-License-Identifier: GPL-2.0-or-later
#include "datagrams/stop_repeater.hpp"

#include <algorithm>

namespace axon::datagrams {
namespace {

constexpr std::size_t kAcknowledgedKept = 16;

}  // namespace

void StopRepeater::admit(const std::string& entity, Target target) {
    if (target.key.size() != kLeaseKeyBytes || target.sender.isZero()) return;
    auto& known = targets_[entity];
    if (known.target.lease != target.lease || known.target.sender != target.sender) {
        known.acknowledged.clear();
        std::erase_if(rows_, [&](const Row& row) { return row.entity == entity; });
    }
    known.target = std::move(target);
}

void StopRepeater::forget(const std::string& entity, LeaseNumber lease) {
    const auto known = targets_.find(entity);
    if (known == targets_.end() || known->second.target.lease != lease) return;
    targets_.erase(known);
    std::erase_if(rows_, [&](const Row& row) { return row.entity == entity; });
}

void StopRepeater::stop(const std::string& entity, std::int64_t sequence, std::uint32_t generation) {
    if (entity.empty()) {
        for (auto& [id, known] : targets_) begin(id, known, sequence, generation);
        return;
    }
    const auto known = targets_.find(entity);
    if (known != targets_.end()) begin(entity, known->second, sequence, generation);
}

void StopRepeater::begin(const std::string& entity, Known& known, std::int64_t sequence,
                         std::uint32_t generation) {
    if (std::find(known.acknowledged.begin(), known.acknowledged.end(), sequence) != known.acknowledged.end())
        return;
    const bool runs = std::any_of(rows_.begin(), rows_.end(), [&](const Row& row) {
        return row.sequence == sequence && row.entity == entity;
    });
    if (runs) return;
    if (rows_.size() == kRows) rows_.pop_front();
    sendDue(rows_.emplace_back(Row{entity, sequence, generation, clock_.now(), 0}), known.target);
}

/// Copies that were missed because the thread slept are not caught up: one of them says it all.
void StopRepeater::sendDue(Row& row, const Target& target) {
    const auto now = clock_.now();
    const auto before = row.copies;
    while (row.copies < kCopiesAt.size() && row.begun + kCopiesAt[row.copies] <= now) ++row.copies;
    if (row.copies == before) return;
    StopDatagram datagram;
    datagram.lease = target.lease;
    datagram.generation = row.generation;
    datagram.sequence = row.sequence;
    datagram.sent_at_us = toMicroseconds(now);
    datagram.sender = target.sender;
    outgoing_.push_back({target.to, encode(datagram, target.key)});
}

std::optional<StopRepeater::Acknowledged> StopRepeater::onDatagram(const Endpoint& from,
                                                                   std::string_view bytes) {
    const auto lease = leaseOf(bytes);
    if (!lease) return std::nullopt;
    for (auto row = rows_.begin(); row != rows_.end(); ++row) {
        auto& known = targets_.at(row->entity);
        if (known.target.to != from || known.target.lease != *lease) continue;
        const auto ack = decode(bytes, known.target.key);
        if (!ack || ack->kind != StopDatagram::Kind::Ack || ack->sender != known.target.sender ||
            ack->sequence != row->sequence)
            continue;
        known.acknowledged.push_back(row->sequence);
        if (known.acknowledged.size() > kAcknowledgedKept) known.acknowledged.pop_front();
        Acknowledged acknowledged{row->entity, ack->sender, row->sequence, ack->generation};
        rows_.erase(row);
        return acknowledged;
    }
    return std::nullopt;
}

void StopRepeater::onTimer() {
    for (auto row = rows_.begin(); row != rows_.end();) {
        sendDue(*row, targets_.at(row->entity).target);
        // The row stays until an answer to its last copy could have come.
        const bool over = row->copies == kCopiesAt.size() &&
                          clock_.now() >= row->begun + kCopiesAt.back() + (kCopiesAt.back() - kCopiesAt[7]);
        row = over ? rows_.erase(row) : std::next(row);
    }
}

TimePoint StopRepeater::nextDeadline() const {
    auto next = TimePoint::max();
    for (const auto& row : rows_) {
        const auto after = row.copies < kCopiesAt.size()
                               ? kCopiesAt[row.copies]
                               : kCopiesAt.back() + (kCopiesAt.back() - kCopiesAt[7]);
        next = std::min<TimePoint>(next, row.begun + after);
    }
    return next;
}

}  // namespace axon::datagrams
