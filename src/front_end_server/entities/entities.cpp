// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/entities/entities.hpp"

#include <utility>

namespace axon::front_end_server {

Entities::Entities(bool alone, OtherServers::Group& servers, const Clock& clock)
    : alone_(alone), servers_(servers), clock_(clock) {}

std::shared_ptr<const std::string> Entities::serverOf(const std::string& entity, Lane lane) const {
    auto record = known_.find(entity, index(lane));
    if (!record) return nullptr;
    const auto* server = &record->registration.server;
    return {std::move(record), server};
}

std::shared_ptr<const std::string> Entities::nameOf(const std::string& entity, Lane lane) const {
    auto record = known_.find(entity, index(lane));
    if (!record) return nullptr;
    const auto* name = &record->registration.name;
    return {std::move(record), name};
}

std::size_t Entities::targets(const std::string& entity) const {
    if (entity.empty()) return known();
    return has(entity, Lane::Signal) ? 1 : 0;
}

Entities::RecordRef Entities::find(const std::string& entity) const {
    const auto found = records_.find(entity);
    return found == records_.end() ? nullptr : found->second;
}

/// A registration or a status of this server has come over the topic.
void Entities::hear(const std::string& server) {
    if (!alone_ && !server.empty()) missed_.heard(server);
}

std::optional<Entities::News> Entities::update(Presence presence, Registration registration,
                                               std::string_view profile) {
    hear(registration.server);
    const auto found = records_.find(registration.entity);
    const bool known = found != records_.end();
    const bool of_another = known && found->second->registration.server != registration.server;
    if (presence == Presence::Left) {
        if (!known || of_another) return {};
        const bool disputed = disputed_.contains(registration.entity);
        return News{presence, takeOut(found), disputed};
    }
    if (of_another && presence == Presence::Changed) {
        disputed_.insert(registration.entity);
        return {};
    }
    if (!alone_ && servers_.lost(registration.server)) return {};  // should it come back it is asked
    if (known && found->second->registration == registration && *found->second->profile == profile)
        return {};  // published again for somebody else
    if (!alone_) servers_.await(registration.server, clock_.now());
    auto next = known ? std::make_shared<Record>(*found->second) : std::make_shared<Record>();
    next->profile = std::make_shared<const std::string>(profile);
    next->status.entity = registration.entity;
    next->status.server = registration.server;
    if (of_another) next->number = 0;  // that server counts for itself
    next->registration = std::move(registration);
    const RecordRef record = std::move(next);
    const bool renamed = known && found->second->registration.name != record->registration.name;
    countBusy(known ? found->second.get() : nullptr, record.get());
    records_[record->registration.entity] = record;
    if (!known || of_another || renamed) known_.put(record->registration.entity, record);
    return News{known ? Presence::Changed : Presence::Joined, record, false};
}

Entities::RecordRef Entities::update(const EntityStatus& status, std::int64_t number, Via via) {
    if (via == Via::Topic) hear(status.server);
    const auto found = records_.find(status.entity);
    if (found == records_.end()) return nullptr;
    const auto before = found->second;
    if (before->registration.server != status.server) {
        if (before->status != status) disputed_.insert(status.entity);
        return nullptr;
    }
    if (number != 0 && number <= before->number) return nullptr;
    const bool same = before->heard && before->status == status;
    if (same && number == 0) return nullptr;
    auto next = std::make_shared<Record>(*before);
    next->number = number;
    if (!same) {
        next->status = status;
        next->heard = true;
        countBusy(before.get(), next.get());
    }
    found->second = std::move(next);
    if (same) return nullptr;
    return before;
}

Entities::Left Entities::forget(const std::string& server, const std::unordered_set<std::string>& but) {
    Left left{{}, false};
    for (auto its = records_.begin(); its != records_.end();) {
        const auto found = its++;
        if (found->second->registration.server != server || but.contains(found->first)) continue;
        left.disputed = left.disputed || disputed_.contains(found->first);
        left.records.push_back(takeOut(found));
    }
    return left;
}

Entities::RecordRef Entities::takeOut(Records::iterator found) {
    auto record = found->second;
    records_.erase(found);
    known_.erase(record->registration.entity);
    disputed_.erase(record->registration.entity);
    countBusy(record.get(), nullptr);
    return record;
}

void Entities::countBusy(const Record* before, const Record* now) {
    if (alone_) return;
    const auto keeps = [](const Record* record) {
        return record != nullptr && record->status.state == EntityState::BUSY ? record->registration.server
                                                                              : std::string();
    };
    servers_.moveTask(keeps(before), keeps(now), clock_.now());
}

}  // namespace axon::front_end_server
