// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/requests.hpp"

#include <cassert>

namespace axon::client {

void Requests::await(Id128 id, Pending pending) {
    const Key key{pending.what.index(), id};
    assert(!pending_.contains(key) && "the id of a request is new");
    if (pending.deadline == TimePoint{}) pending.deadline = clock_.now() + timeout_;
    deadlines_.insert({pending.deadline, key});
    if (pending.sequence != 0) by_sequence_[pending.sequence] = key;
    of_entity_[pending.entity].insert(key);
    pending_.emplace(key, std::move(pending));
}

Requests::Pending* Requests::find(Key key) {
    const auto found = pending_.find(key);
    return found == pending_.end() ? nullptr : &found->second;
}

std::optional<Requests::Pending> Requests::take(Key key) {
    const auto found = pending_.find(key);
    if (found == pending_.end()) return std::nullopt;
    std::optional pending = std::move(found->second);
    pending_.erase(found);
    deadlines_.erase({pending->deadline, key});
    by_sequence_.erase(pending->sequence);
    if (const auto of = of_entity_.find(pending->entity); of != of_entity_.end()) {
        of->second.erase(key);
        if (of->second.empty()) of_entity_.erase(of);
    }
    return pending;
}

bool Requests::settle(Key key, const Result<void>& result) {
    auto pending = take(key);
    if (!pending) return false;
    const auto settled = visit(*pending, [&](auto& what) { return what.settle(result); });
    if (!settled) refused_(pending->entity, pending->lease, settled.refusal());
    return true;
}

void Requests::postpone(Key key, TimePoint deadline) {
    auto& pending = pending_.at(key);
    deadlines_.erase({pending.deadline, key});
    pending.deadline = deadline;
    deadlines_.insert({deadline, key});
}

void Requests::resend(Key key, std::int64_t sequence) {
    auto& pending = pending_.at(key);
    by_sequence_.erase(pending.sequence);
    pending.sequence = sequence;
    by_sequence_[sequence] = key;
}

std::vector<Requests::Key> Requests::all() const {
    std::vector<Key> keys;
    for (const auto& [key, pending] : pending_) keys.push_back(key);
    return keys;
}

std::vector<Requests::Key> Requests::of(const std::string& entity) const {
    const auto of = of_entity_.find(entity);
    return of == of_entity_.end() ? std::vector<Key>{} : std::vector(of->second.begin(), of->second.end());
}

std::optional<Requests::Key> Requests::bySequence(std::int64_t sequence) const {
    const auto found = by_sequence_.find(sequence);
    return found == by_sequence_.end() ? std::nullopt : std::optional(found->second);
}

std::optional<Requests::Key> Requests::due(TimePoint now) const {
    if (deadlines_.empty() || deadlines_.begin()->first > now) return std::nullopt;
    return deadlines_.begin()->second;
}

}  // namespace axon::client
