// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/tasks.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "client/core/content.hpp"
#include "client/core/entities.hpp"
#include "client/core/leases.hpp"
#include "client/core/server_watch.hpp"
#include "client/core/task_control.hpp"
#include "messages/values.hpp"

namespace axon::client {
namespace {

/// Duplicates and late-comers must not turn a task back: only pause and resume go both ways.
bool follows(TaskState now, TaskState next) {
    if (isFinal(now)) return false;
    return next >= now || (now == TaskState::Paused && next == TaskState::Running);
}

}  // namespace

std::optional<TaskReport> Tasks::report(const Id128& task) const {
    const auto found = tasks_.find(task);
    if (found == tasks_.end()) return std::nullopt;
    return found->second.report;
}

Id128 Tasks::run(const Held& held, std::string_view service, const std::vector<Argument>& arguments,
                 Duration not_after) {
    const auto id = Id128::uuid(parts_.context.random);
    auto& entry = tasks_[id];
    ++open_count_;
    entry.held = held;
    entry.report.id = id.toString();
    entry.report.entity = held.entity;
    entry.report.service = std::string(service);
    open_[held].insert(id);

    const auto refusal = parts_.leases.ready(held);
    if (!refusal.ok()) {
        finish(id, TaskState::Refused, refusal);
        return id;
    }
    const auto& services = parts_.leases.find(held)->services;
    const auto index = findServiceIndex(services, service);
    if (!index) {
        finish(id, TaskState::Refused, index.refusal());
        return id;
    }
    const auto& chosen = services.services(index.value());
    auto params = toParams(chosen, arguments);
    if (!params) {
        finish(id, TaskState::Refused, params.refusal());
        return id;
    }
    entry.report.service = chosen.name();
    proto::ToEntity body;
    auto& request = *body.mutable_task();
    request.set_task_id(id.bytes());
    request.set_service(chosen.name());
    for (auto& param : params.value()) *request.add_params() = std::move(param);
    request.set_not_after_s(Seconds(not_after).count());
    const auto sequence = parts_.context.send(held.entity, kMsgTask, held.lease, body);
    parts_.requests.await(
        id, {.entity = held.entity, .lease = held.lease, .sequence = sequence, .what = request::StartTask{}});
    parts_.server.pace();
    return id;
}

void Tasks::onEvent(const std::string& entity, const proto::TaskEvent& event) {
    const auto id = Id128::fromBytes(event.task_id());
    const auto state = taskStateFromProto(event.state());
    if (!id || !state) {
        ++parts_.context.malformed;
        return;
    }
    const auto found = tasks_.find(*id);
    if (found == tasks_.end() || found->second.held.entity != entity) return;
    parts_.requests.settle<request::StartTask>(*id, {});
    auto& entry = found->second;
    auto& report = entry.report;
    if (isFinal(report.state)) {
        // Given up here, alive there: a task whose outcome this client has called unknown must not go on.
        if (report.state == TaskState::Unknown && !isFinal(*state) && parts_.leases.holds(entry.held))
            sendControl(parts_.context, *id, entry.held, proto::CANCEL);
        return;
    }
    if (!follows(report.state, *state)) return;
    report.state = *state;
    report.accepted = report.accepted || *state < TaskState::Succeeded;
    if (event.progress() >= 0)
        report.progress = std::max(report.progress, event.progress() + 0.0);  // makes -0 a 0
    if (!event.feedback().empty()) report.feedback = event.feedback();
    for (const auto& param : event.results()) {
        auto& values = report.results[param.name()];
        values.clear();
        for (const auto& value : param.values()) values.push_back(fromProto(value));
    }
    report.reason = toRefusal(event.reason());
    // Copies: what follows may end other tasks, and the oldest that is over is forgotten.
    const auto told = report;
    const auto under = entry.held.lease;
    if (isFinal(told.state)) {
        noteFinal(*id);
    } else if (!parts_.leases.holds(entry.held)) {
        awaitEnd(*id, entry);
    }
    // The report first: whoever waited for the pause finds the task paused.
    parts_.context.observer.onTask(told);
    settleControl(parts_.requests, *id, told.state, "task");
    if (*state == TaskState::Refused) parts_.leases.onRefusal(entity, under, told.reason);
    parts_.server.pace();
}

void Tasks::awaitEnd(Id128 task, const Entry& entry) {
    if (parts_.requests.contains(Requests::keyOf<request::StartTask>(task))) return;
    parts_.requests.await(
        task, {.entity = entry.held.entity, .lease = entry.held.lease, .what = request::StartTask{}});
}

void Tasks::awaitEnds(const Held& held) {
    for (const auto task : open(held)) awaitEnd(task, tasks_.at(task));
}

void Tasks::finish(Id128 task, TaskState state, const Refusal& why) {
    const auto found = tasks_.find(task);
    if (found == tasks_.end() || isFinal(found->second.report.state)) return;
    parts_.requests.settle<request::StartTask>(task, {});
    found->second.report.state = state;
    found->second.report.reason = why;
    // A copy: what follows may end other tasks, and the oldest that is over is forgotten.
    const auto report = found->second.report;
    noteFinal(task);
    parts_.context.observer.onTask(report);
    settleControl(parts_.requests, task, report.state, "task");
    parts_.server.pace();
}

void Tasks::finishAll(const Held& held, const Refusal& unknown) {
    for (const auto task : open(held)) finish(task, TaskState::Unknown, unknown);
}

void Tasks::finishUnheld(const Refusal& unknown) {
    std::vector<Id128> tasks;
    for (const auto& [held, open] : open_) {
        if (!parts_.leases.holds(held)) tasks.insert(tasks.end(), open.begin(), open.end());
    }
    for (const auto task : tasks) finish(task, TaskState::Unknown, unknown);
}

std::vector<Id128> Tasks::open(const Held& held) const {
    const auto open = open_.find(held);
    return open == open_.end() ? std::vector<Id128>{} : std::vector(open->second.begin(), open->second.end());
}

void Tasks::noteFinal(Id128 task) {
    --open_count_;
    if (const auto open = open_.find(tasks_.at(task).held); open != open_.end()) {
        open->second.erase(task);
        if (open->second.empty()) open_.erase(open);
    }
    finished_.push_back(task);
    while (finished_.size() > std::max<std::size_t>(parts_.context.settings.tasks_kept, 1)) {
        tasks_.erase(finished_.front());
        finished_.pop_front();
    }
}

void Tasks::onDue(Id128 task) {
    // It may or may not run: say so, and make an end of it if it does.
    const auto held = tasks_.at(task).held;
    if (parts_.leases.ready(held).ok()) sendControl(parts_.context, task, held, proto::CANCEL);
    finish(task, TaskState::Unknown,
           {RefusalCode::OutcomeUnknown,
            parts_.entities.label(held.entity) + " has not answered the request in time.",
            {}});
}

void Tasks::askAfter(const Held& held) {
    auto tasks = open(held);
    if (tasks.empty()) return;
    const auto id = Id128::random(parts_.context.random);
    proto::ToEntity body;
    body.mutable_status_request()->set_request_id(id.bytes());
    const auto sequence = parts_.context.send(held.entity, kMsgStatus, held.lease, body);
    parts_.requests.await(id, {.entity = held.entity,
                               .lease = held.lease,
                               .sequence = sequence,
                               .what = request::AskAfterTasks{{}, std::move(tasks)}});
}

bool Tasks::onAnswer(Id128 request, const proto::EntityStatus& status) {
    auto pending = parts_.requests.take<request::AskAfterTasks>(request);
    if (!pending) return false;
    std::set<Id128> alive;
    for (const auto& event : status.tasks()) {
        if (const auto id = Id128::fromBytes(event.task_id())) alive.insert(*id);
    }
    for (const auto task : pending->as<request::AskAfterTasks>().tasks) {
        if (alive.contains(task)) continue;
        finish(task, TaskState::Unknown,
               {RefusalCode::OutcomeUnknown,
                parts_.entities.label(pending->entity) + " has no record of how it ended.",
                {}});
    }
    return true;
}

void Tasks::onAskAfterDue(Id128 request) {
    auto pending = *parts_.requests.take<request::AskAfterTasks>(request);
    for (const auto task : pending.as<request::AskAfterTasks>().tasks) {
        finish(task, TaskState::Unknown,
               {RefusalCode::OutcomeUnknown,
                parts_.entities.label(pending.entity) + " has not said in time what became of it.",
                {}});
    }
}

void Tasks::control(const Id128& task, proto::TaskAction action, Done done) {
    const auto found = tasks_.find(task);
    if (found == tasks_.end())
        return done(Refusal{RefusalCode::UnknownTask, "This client has no record of such a task.", {}});
    const auto& entry = found->second;
    requestControl(parts_, task, entry.held, entry.report.state, action, "task", std::move(done));
}

}  // namespace axon::client
