// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/tasks/task_queue.hpp"

#include <algorithm>
#include <utility>

#include "common/planted_bug.hpp"

namespace axon::entity_manager {

Refusal TaskQueue::mayPush() const {
    if (waiting_.size() >= bound_)
        return {RefusalCode::QueueFull,
                std::to_string(bound_) +
                    " tasks are waiting already. Send more when some have ended, or clear the queue.",
                {}};
    return {};
}

void TaskQueue::push(Task task) {
    if (AXON_PLANTED(QueueBackwards))
        waiting_.push_front(std::move(task));
    else
        waiting_.push_back(std::move(task));
}

Task TaskQueue::pop() {
    Task task = std::move(waiting_.front());
    waiting_.pop_front();
    return task;
}

std::optional<Task> TaskQueue::remove(const Id128& id) {
    const auto at =
        std::find_if(waiting_.begin(), waiting_.end(), [&](const Task& task) { return task.id == id; });
    if (at == waiting_.end()) return std::nullopt;
    Task task = std::move(*at);
    waiting_.erase(at);
    return task;
}

std::deque<Task> TaskQueue::clear() {
    return std::exchange(waiting_, {});
}

std::vector<Task> TaskQueue::expire(TimePoint now) {
    std::vector<Task> late;
    for (auto at = waiting_.begin(); at != waiting_.end();) {
        if (at->not_after && now >= *at->not_after) {
            late.push_back(std::move(*at));
            at = waiting_.erase(at);
        } else {
            ++at;
        }
    }
    return late;
}

std::optional<TimePoint> TaskQueue::nextExpiry() const {
    std::optional<TimePoint> first;
    for (const auto& task : waiting_)
        if (task.not_after && (!first || *task.not_after < *first)) first = task.not_after;
    return first;
}

void TaskQueue::restamp(std::uint32_t generation) {
    for (auto& task : waiting_) task.generation = generation;
}

}  // namespace axon::entity_manager
