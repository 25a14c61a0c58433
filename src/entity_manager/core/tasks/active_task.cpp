// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/tasks/active_task.hpp"

#include <algorithm>
#include <chrono>
#include <utility>

#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

/// Of the results of all parts together; the oldest are left out then. Each was told when its part ended.
constexpr std::size_t kResultBytes = 512UL * 1024;

}  // namespace

std::string partText(const ServiceProfiler& profiler, const Task& task, std::size_t part) {
    return "part " + std::to_string(part + 1) + " of " + std::to_string(task.plan.parts.size()) + ", " +
           profiler.record(task.plan.parts[part].service).name();
}

double ActiveTask::progress(double of_part) const {
    if (!task.plan.composite) return of_part;
    return (static_cast<double>(part) + std::clamp(of_part, 0.0, 1.0)) /
           static_cast<double>(task.plan.parts.size());
}

void ActiveTask::nameAsWhole(const ServiceProfiler& profiler, proto::TaskEvent& event) const {
    event.set_progress(progress(event.progress()));
    if (!event.feedback().empty()) event.set_feedback(partText(profiler) + ": " + event.feedback());
    const auto& service = profiler.record(order().service).name();
    for (auto& result : *event.mutable_results()) result.set_name(service + '.' + result.name());
}

void ActiveTask::keepResults(const ServiceProfiler& profiler, const proto::TaskEvent& event) {
    const auto& whole = profiler.record(order().way.front());
    for (const auto& result : event.results()) {
        const auto declared = findParamIndex(whole, result.name());
        // FEEDBACK is of the moment, no result of the whole.
        if (declared && whole.params(declared.value()).type() == proto::FEEDBACK) continue;
        std::erase_if(results, [&](const proto::Param& kept) { return kept.name() == result.name(); });
        results.push_back(result);
    }
    std::size_t bytes = 0;
    auto first = results.end();
    while (first != results.begin() && bytes + (first - 1)->ByteSizeLong() <= kResultBytes)
        bytes += (--first)->ByteSizeLong();
    results.erase(results.begin(), first);
}

void ActiveTask::endAsWhole(const ServiceProfiler& profiler, proto::TaskEvent& event) const {
    if (!task.plan.composite) return;
    if (event.state() == proto::TASK_SUCCEEDED)
        event.set_progress(1);
    else if (event.progress() < 0)
        event.set_progress(progress());
    if (event.has_reason())
        event.mutable_reason()->set_message((sent ? "" : "before ") + partText(profiler) + ": " +
                                            event.reason().message());
    event.clear_results();
    for (const auto& result : results) *event.add_results() = result;
}

proto::OnClientLoss ActiveTask::lossPolicy(const ServiceProfiler& profiler, bool grace) const {
    const bool begins = !answered && phase != Phase::Paused;
    return begins || halted ? proto::STOP_TASK : lossPolicyOfParts(profiler, grace);
}

proto::OnClientLoss ActiveTask::lossPolicyOfParts(const ServiceProfiler& profiler, bool grace) const {
    auto strictest = proto::FINISH_TASK;
    for (const auto position : order().way) {
        const auto& service = profiler.record(position);
        if (service.on_client_loss() == proto::FINISH_TASK && service.max_duration_s() <= 0)
            return proto::STOP_TASK;
        strictest = std::min(strictest, service.on_client_loss());
        // Who comes back resumes the whole.
        if (strictest == proto::HOLD_TASK && !profiler.record(task.plan.service).is_pausable())
            return proto::STOP_TASK;
    }
    return strictest == proto::HOLD_TASK && !grace ? proto::STOP_TASK : strictest;
}

TimePoint ActiveTask::finishesUntil(const ServiceProfiler& profiler, TimePoint now) const {
    auto most = profiler.record(order().service).max_duration_s();
    for (const auto position : order().way) most = std::min(most, profiler.record(position).max_duration_s());
    const auto until = now + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(most));
    return finish_until ? std::min(until, *finish_until) : until;
}

}  // namespace axon::entity_manager
