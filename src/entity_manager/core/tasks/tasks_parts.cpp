// SPDX-License-Identifier: GPL-2.0-or-later
// What the robot application is given of a task, and of a composite one part after the other.
#include <algorithm>
#include <chrono>
#include <limits>
#include <utility>

#include "entity_manager/core/services/message_size.hpp"
#include "entity_manager/core/tasks/tasks.hpp"
#include "entity_manager/ports/journal_record.hpp"

namespace axon::entity_manager {

namespace {

/// All but its parameters.
proto::EmToEi headOf(const ServiceProfiler::Order& part, const std::string& service, const Id128& id,
                     std::uint32_t generation) {
    proto::EmToEi message;
    auto& order = *message.mutable_task();
    order.set_task_id(id.bytes());
    order.set_service(service);
    order.set_stop_generation(generation);
    for (const auto& resource : part.resources) *order.add_resources() = resource;
    return message;
}

proto::EmToEi dispatchOf(const ServiceProfiler::Order& part, const std::string& service, const Id128& id,
                         std::uint32_t generation) {
    auto message = headOf(part, service, id, generation);
    for (const auto& [param, level] : part.params) *message.mutable_task()->add_params() = param;
    return message;
}

/// What the application is asked about before the whole begins.
void addGiven(proto::EmToEi& message, const ServiceProfiler::Plan& plan, const ServiceProfiler& profiler) {
    for (const auto& [service, param] : plan.given) {
        auto& given = *message.mutable_task()->add_given();
        given.set_service(profiler.record(service).name());
        *given.mutable_param() = param;
    }
}

}  // namespace

/// Of all parts from this one on: a composite takes no more memory than another task. A few bytes more than
/// they really have, so that nothing needs to be copied.
std::size_t Tasks::dispatchBytes(const ServiceProfiler::Plan& plan, std::size_t from) const {
    constexpr auto kHead = ServiceProfiler::kFieldHead;
    auto bytes = ServiceProfiler::bytesOf(plan, from);
    for (auto part = from; part < plan.parts.size(); ++part) {
        const auto& order = plan.parts[part];
        const auto& service = profiler_.record(order.service).name();
        bytes += kHead + headOf(order, service, {}, turn_.stops().generation).ByteSizeLong();
    }
    if (from > 0) return bytes;
    for (const auto& [service, param] : plan.given)
        bytes += 2 * kHead + profiler_.record(service).name().size();
    return bytes;
}

/// The present part, to the robot application. It sees ordinary tasks only: each part of a composite has an
/// id of its own, which nobody else knows.
void Tasks::sendPart(ActiveTask& active) {
    if (!busy_told_) {
        // Before the task, so that the short watchdog is running when the robot starts.
        busy_told_ = true;
        back_end_.setBusy(true);
    }
    stop_generations_.spareClientLoss(false);
    const auto& task = active.task;
    active.sent = task.plan.composite ? Id128::random(random_) : task.id;
    active.answered = false;
    active.answer_until = turn_.now() + settings_.answer_within;
    auto message = dispatchOf(active.order(), profiler_.record(active.order().service).name(), *active.sent,
                              task.generation);
    if (active.part == 0) addGiven(message, task.plan, profiler_);
    if (task.not_after && active.part == 0) {
        const auto left =
            std::chrono::duration_cast<std::chrono::milliseconds>(*task.not_after - turn_.now());
        message.mutable_task()->set_start_within_ms(static_cast<std::uint32_t>(
            std::clamp<std::int64_t>(left.count(), 1, std::numeric_limits<std::int32_t>::max())));
    }
    markExecuting(task);
    turn_.toApplication(message);
}

/// The robot application has said how the present part ended. False: so ends the whole, as `event` says.
bool Tasks::goOn(std::size_t at, proto::TaskEvent& event) {
    auto& active = active_[at];
    if (!active.sent) return false;  // ended by this side, between two parts
    active.nameAsWhole(profiler_, event);
    active.keepResults(profiler_, event);
    // REFUSED would say that nothing has run.
    if (event.state() == proto::TASK_REFUSED && active.part > 0) event.set_state(proto::TASK_FAILED);
    if (event.state() != proto::TASK_SUCCEEDED || active.lastPart()) return false;
    if (active.halted || active.cancelled) {
        event.set_state(active.halted ? proto::TASK_STOPPED : proto::TASK_CANCELLED);
        return false;
    }
    event.set_task_id(active.task.id.bytes());
    event.set_service(active.task.service);
    if (event.feedback().empty()) event.set_feedback(active.partText(profiler_) + ": done");
    // It has been sent; later ones that a CONFIG value makes larger would take memory beside it.
    active.task.plan.parts[active.part].params.clear();
    ++active.part;
    active.sent.reset();
    active.answered = false;
    markExecuting(active.task);
    // Without its client only a part begins that may.
    const auto policy = turn_.orphaned() ? lossPolicyOfParts(active) : proto::FINISH_TASK;
    if (policy == proto::HOLD_TASK) active.hold = true;
    active.phase = active.hold ? ActiveTask::Phase::Paused : ActiveTask::Phase::Running;
    if (turn_.orphaned()) active.alone_until.reset();
    if (turn_.orphaned() && !active.hold) active.alone_until = finishesUntil(active);
    event.set_state(active.hold ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    event.set_progress(active.progress());
    const auto next = active.partText(profiler_);
    tellTask(event);
    if (policy == proto::STOP_TASK)
        endSpared("The client was lost, and " + next + ", does not begin without it.");
    else
        continueParts();
    return true;
}

/// Composites between two parts: the next one, as soon as it may start. Nothing of the queue comes between,
/// since the whole stays active.
void Tasks::continueParts() {
    for (std::size_t at = 0; at < active_.size();) {
        auto& active = active_[at];
        if (!active.sent && active.halted) {
            endTask(at, proto::TASK_STOPPED, {});
            at = 0;
            continue;
        }
        if (active.sent || active.phase == ActiveTask::Phase::Paused || !mayStart()) {
            ++at;
            continue;
        }
        // For people only: that the task is not begun again is noted with its first part, and costs the disk
        // no more.
        journal_.note({.kind = JournalRecord::Kind::Part,
                       .who = named(*turn_.holder()),
                       .client = turn_.holder()->id,
                       .task = active.task.id,
                       .service = active.task.service,
                       .text = active.partText(profiler_)});
        active.task.generation = turn_.stops().generation;
        sendPart(active);
        ++at;
    }
}

/// A pause, resume or cancel that the robot application need not hear of.
void Tasks::controlBetweenParts(ActiveTask& active) {
    if (active.cancelled) {
        endTask(static_cast<std::size_t>(&active - active_.data()), proto::TASK_CANCELLED,
                {RefusalCode::Cancelled, "Cancelled.", {}});
        return;
    }
    active.phase = active.hold ? ActiveTask::Phase::Paused : ActiveTask::Phase::Running;
    proto::TaskEvent event;
    event.set_task_id(active.task.id.bytes());
    event.set_service(active.task.service);
    event.set_state(active.hold ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    event.set_progress(active.progress());
    tellTask(event);
    continueParts();
}

/// What has been accepted can still be sent with it.
Refusal Tasks::leavesRoom(int service, const proto::Param& param) const {
    const auto fits = [&](const ServiceProfiler::Plan& plan, std::size_t from) {
        const auto more = profiler_.growth(plan, from, service, param);
        return more <= 0 || checkSize(dispatchBytes(plan, from) + static_cast<std::size_t>(more)).ok();
    };
    bool all = true;
    for (const auto& task : queue_.waiting()) all = all && fits(task.plan, 0);
    for (const auto& active : active_)
        all = all && fits(active.task.plan, active.part + (active.sent ? 1 : 0));
    if (all) return {};
    return {RefusalCode::TooLarge,
            "A task that has been accepted would become larger with it than the robot application takes at "
            "once. Wait for its end, or set a shorter value.",
            {}};
}

void Tasks::reconfigure(int service, const proto::Param& param) {
    for (auto& task : queue_.waiting())
        static_cast<void>(profiler_.reconfigure(task.plan, 0, service, param));
    proto::EmToEi message;
    auto& one = *message.mutable_configuration()->add_params();
    one.set_service(profiler_.record(service).name());
    *one.mutable_param() = param;
    // Two tasks that share a service do not run side by side, so that one at most takes it.
    for (auto& active : active_)
        if (profiler_.reconfigure(active.task.plan, active.part, service, param) && active.sent)
            message.mutable_configuration()->set_task_id(active.sent->bytes());
    turn_.toApplication(message);
}

}  // namespace axon::entity_manager
