// SPDX-License-Identifier: GPL-2.0-or-later
// Tasks of composite services: one part after the other, as tasks of their own to the robot application and
// as one task to everybody else (docs/reference/profiles.md).
#include <algorithm>
#include <utility>

#include "entity_manager/machine.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

/// Of the results of all parts together; the oldest are left out then. Each was told when its part ended.
constexpr std::size_t kResultBytes = 512UL * 1024;

}  // namespace

/// "part 2 of 3, Turning".
std::string EntityManagerCore::Machine::partText(const Task& task, std::size_t part) const {
    return "part " + std::to_string(part + 1) + " of " + std::to_string(task.plan.parts.size()) + ", " +
           profiler_.record(task.plan.parts[part].service).name();
}

/// Of the whole, 0 to 1: the parts that are done, and the present one as far as it says. Of a simple task
/// what it says itself.
double EntityManagerCore::Machine::progressOf(const Active& active, double of_part) const {
    if (!active.task.plan.composite) return of_part;
    return (static_cast<double>(active.part) + std::clamp(of_part, 0.0, 1.0)) /
           static_cast<double>(active.task.plan.parts.size());
}

/// What the application has said of the present part.
void EntityManagerCore::Machine::nameAsWhole(const Active& active, proto::TaskEvent& event) const {
    event.set_progress(progressOf(active, event.progress()));
    if (!event.feedback().empty()) event.set_feedback(partText(active) + ": " + event.feedback());
    const auto& part = profiler_.record(active.order().service).name();
    for (auto& result : *event.mutable_results()) result.set_name(part + '.' + result.name());
}

void EntityManagerCore::Machine::keepResults(Active& active, const proto::TaskEvent& event) const {
    const auto& whole = profiler_.record(active.order().way.front());
    for (const auto& result : event.results()) {
        const auto declared = findParamIndex(whole, result.name());
        // FEEDBACK is of the moment, no result of the whole.
        if (declared && whole.params(declared.value()).type() == proto::FEEDBACK) continue;
        std::erase_if(active.results, [&](const proto::Param& kept) { return kept.name() == result.name(); });
        active.results.push_back(result);
    }
    std::size_t bytes = 0;
    auto first = active.results.end();
    while (first != active.results.begin() && bytes + (first - 1)->ByteSizeLong() <= kResultBytes)
        bytes += (--first)->ByteSizeLong();
    active.results.erase(active.results.begin(), first);
}

/// The robot application has said how the present part ended. False: so ends the whole, as `event` says.
bool EntityManagerCore::Machine::goOn(std::size_t at, proto::TaskEvent& event) {
    auto& active = active_[at];
    if (!active.sent) return false;  // ended by this side, between two parts
    nameAsWhole(active, event);
    keepResults(active, event);
    // REFUSED would say that nothing has run.
    if (event.state() == proto::TASK_REFUSED && active.part > 0) event.set_state(proto::TASK_FAILED);
    if (event.state() != proto::TASK_SUCCEEDED || active.lastPart()) return false;
    if (active.halted || active.cancelled) {
        event.set_state(active.halted ? proto::TASK_STOPPED : proto::TASK_CANCELLED);
        return false;
    }
    event.set_task_id(active.task.id.bytes());
    event.set_service(active.task.service);
    if (event.feedback().empty()) event.set_feedback(partText(active) + ": done");
    ++active.part;
    active.sent.reset();
    active.answered = false;
    markExecuting(active.task);
    // Without its client only a part begins that may.
    const auto policy = orphaned() ? lossPolicyOfParts(active) : proto::FINISH_TASK;
    if (policy == proto::HOLD_TASK) active.hold = true;
    active.phase = active.hold ? Active::Phase::Paused : Active::Phase::Running;
    if (orphaned()) active.alone_until.reset();
    if (orphaned() && !active.hold) active.alone_until = finishesUntil(active);
    event.set_state(active.hold ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    event.set_progress(progressOf(active));
    const auto next = partText(active);
    tellTask(event);
    if (policy == proto::STOP_TASK)
        endSpared("The client was lost, and " + next + ", does not begin without it.");
    else
        continueParts();
    return true;
}

/// What the application has said of its end, if anything, has been through goOn().
void EntityManagerCore::Machine::endAsWhole(const Active& active, proto::TaskEvent& event) const {
    if (!active.task.plan.composite) return;
    if (event.state() == proto::TASK_SUCCEEDED)
        event.set_progress(1);
    else if (event.progress() < 0)
        event.set_progress(progressOf(active));
    if (event.has_reason())
        event.mutable_reason()->set_message((active.sent ? "" : "before ") + partText(active) + ": " +
                                            event.reason().message());
    event.clear_results();
    for (const auto& result : active.results) *event.add_results() = result;
}

/// Composites between two parts: the next one, as soon as it may start. Nothing of the queue comes between,
/// since the whole stays active.
void EntityManagerCore::Machine::continueParts() {
    for (std::size_t at = 0; at < active_.size();) {
        auto& active = active_[at];
        if (!active.sent && active.halted) {
            endTask(at, proto::TASK_STOPPED, {});
            at = 0;
            continue;
        }
        if (active.sent || active.phase == Active::Phase::Paused || !mayStart()) {
            ++at;
            continue;
        }
        // For people only: that the task is not begun again is noted with its first part, and costs the disk
        // no more.
        note({.kind = JournalRecord::Kind::Part,
              .who = named(*holder()),
              .task = active.task.id,
              .service = active.task.service,
              .text = partText(active)});
        active.task.generation = stops_.generation();
        sendPart(active);
        ++at;
    }
}

/// A pause, resume or cancel that the robot application need not hear of.
void EntityManagerCore::Machine::controlBetweenParts(Active& active) {
    if (active.cancelled) {
        endTask(static_cast<std::size_t>(&active - active_.data()), proto::TASK_CANCELLED,
                {RefusalCode::Cancelled, "Cancelled.", {}});
        return;
    }
    active.phase = active.hold ? Active::Phase::Paused : Active::Phase::Running;
    proto::TaskEvent event;
    event.set_task_id(active.task.id.bytes());
    event.set_service(active.task.service);
    event.set_state(active.hold ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    event.set_progress(progressOf(active));
    tellTask(event);
    continueParts();
}

}  // namespace axon::entity_manager
