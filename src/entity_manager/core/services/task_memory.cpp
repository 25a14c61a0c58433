// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/services/task_memory.hpp"

namespace axon::entity_manager {

void TaskMemory::remember(const Id128& id, Fate fate) {
    const auto [at, fresh] = fates_.try_emplace(id, fate);
    if (!fresh) {
        fate.dispatched = fate.dispatched || at->second.dispatched;
        at->second = fate;
        return;
    }
    order_.push_back(id);
    if (order_.size() <= kIds) return;
    fates_.erase(order_.front());
    order_.pop_front();
}

void TaskMemory::ended(const Id128& id, LeaseNumber lease, const proto::TaskEvent& event, TimePoint at) {
    remember(id, Fate{.end = event.state()});
    if (lease_ != lease) finals_.clear();
    lease_ = lease;
    auto& kept = finals_.emplace_back(Final{event, at}).event;
    if (kept.ByteSizeLong() > kFinalBytes) {
        kept.clear_results();
        kept.clear_feedback();
    }
    if (finals_.size() > kFinals) finals_.pop_front();
}

bool TaskMemory::wasDispatched(const Id128& id) const {
    const auto at = fates_.find(id);
    return at != fates_.end() && at->second.dispatched;
}

std::optional<Refusal> TaskMemory::whyNotAgain(const Id128& id) const {
    const auto at = fates_.find(id);
    if (at == fates_.end()) return std::nullopt;
    const auto& fate = at->second;
    if (fate.end == proto::TASK_UNKNOWN)
        return Refusal{
            RefusalCode::OutcomeUnknown,
            "A task with this id has been given to the robot application before, and how it ended is not "
            "known. It is not run twice: look at the robot, then make a new id.",
            {}};
    if (fate.end == proto::TASK_UNSPECIFIED)
        return Refusal{RefusalCode::Duplicate,
                       "A task with this id has been accepted before and is not run twice. Make a new id.",
                       {}};
    return Refusal{RefusalCode::Duplicate,
                   "A task with this id has ended before (" + proto::TaskState_Name(fate.end) +
                       ") and is not run twice. Make a new id.",
                   {}};
}

std::vector<Id128> TaskMemory::unfinished() const {
    std::vector<Id128> ids;
    for (const auto& id : order_)
        if (const auto& fate = fates_.at(id); fate.dispatched && fate.end == proto::TASK_UNSPECIFIED)
            ids.push_back(id);
    return ids;
}

std::vector<proto::TaskEvent> TaskMemory::finals(LeaseNumber lease, TimePoint since) const {
    std::vector<proto::TaskEvent> events;
    if (lease != lease_) return events;
    for (const auto& kept : finals_)
        if (kept.at >= since) events.push_back(kept.event);
    return events;
}

}  // namespace axon::entity_manager
