// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <utility>

#include "common/planted_bug.hpp"
#include "entity_manager/machine.hpp"
#include "entity_manager/message_size.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

using collaboration::isFinal;

namespace {

/// So long a task may wait for the disk alone before its client is told that it waits.
constexpr Duration kQueuedUntold = std::chrono::milliseconds{100};
/// For so long a client may have been gone before its loss was known: the server's watchdog of a client.
constexpr Duration kUnnoticed = std::chrono::seconds{10};
constexpr double kLongestNotAfter_s = 1e6;

proto::EmToEi dispatchOf(const ServiceProfiler::Order& part, const std::string& service, const Id128& id,
                         std::uint32_t generation) {
    proto::EmToEi message;
    auto& order = *message.mutable_task();
    order.set_task_id(id.bytes());
    order.set_service(service);
    order.set_stop_generation(generation);
    for (const auto& [param, level] : part.params) *order.add_params() = param;
    for (const auto& resource : part.resources) *order.add_resources() = resource;
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

// -- tasks
// ----------------------------------------------------------------------------------------------------------

void EntityManagerCore::Machine::admitTask(const Incident& incident) {
    if (teamwork_.isReserved()) {
        refuse(incident,
               {RefusalCode::WrongState,
                "The entity takes part in a collaboration and takes tasks of its master alone. Wait for its "
                "end, or stop it.",
                {}});
        return;
    }
    if (const auto refusal = admit(incident.body->task(), incident.head->sent_at_us); !refusal.ok())
        refuse(incident, refusal);
}

Refusal EntityManagerCore::Machine::admit(const proto::TaskRequest& request, std::int64_t sent_at_us) {
    const auto id = Id128::fromBytes(request.task_id());
    if (!id || id->isZero())
        return {RefusalCode::Malformed, "task_id must be 16 bytes that are not all zero.", {}};
    if (!std::isfinite(request.not_after_s()) || request.not_after_s() < 0)
        return {RefusalCode::Malformed, "not_after_s must be a number of seconds from 0 on.", {}};
    if (const auto again = memory_.whyNotAgain(*id); again && !AXON_PLANTED(TaskIdForgotten)) return *again;
    if (const auto refusal = queue_.mayPush(); !refusal.ok()) return refusal;
    auto plan = profiler_.prepare(request.service(), request.params());
    if (!plan && plan.refusal().code == RefusalCode::MissingDependency && profiler_.hasUrls()) {
        lookAgain();  // for this task where the disk answers at once, else for the next
        plan = profiler_.prepare(request.service(), request.params());
    }
    if (!plan) return plan.refusal();
    const auto& service = profiler_.record(plan->service);
    Task task;
    task.id = *id;
    task.service = service.name();
    task.blocking = service.is_blocking();
    task.plan = std::move(plan).value();
    task.generation = stops_.generation();
    if (request.not_after_s() > 0 && request.not_after_s() < kLongestNotAfter_s &&
        !AXON_PLANTED(ExpiryUnchecked))
        task.not_after =
            (AXON_PLANTED(ExpiryByTheSendersClock) ? TimePoint{std::chrono::microseconds{sent_at_us}}
                                                   : clock_.now()) +
            std::chrono::duration_cast<Duration>(std::chrono::duration<double>(request.not_after_s()));
    if (const auto refusal = checkSize(dispatchBytes(task.plan)); !refusal.ok()) return refusal;
    memory_.accept(task.id);
    queue_.push(std::move(task));
    dispatchNext();
    if (queue_.empty() || queue_.waiting().back().id != *id) return {};
    // What waits for nothing but the disk is about to begin.
    if (queue_.front().id == *id && queue_.front().preparing())
        queue_.front().tell_at = clock_.now() + kQueuedUntold;
    else
        sendTask(queue_.waiting().back(), proto::TASK_QUEUED, {});
    return {};
}

/// Of all parts: a composite takes no more memory than another task.
std::size_t EntityManagerCore::Machine::dispatchBytes(const ServiceProfiler::Plan& plan) const {
    std::size_t bytes = 0;
    for (const auto& part : plan.parts) {
        auto message = dispatchOf(part, profiler_.record(part.service).name(), {}, stops_.generation());
        if (&part == &plan.parts.front()) addGiven(message, plan, profiler_);
        bytes += message.ByteSizeLong();
    }
    return bytes;
}

bool EntityManagerCore::Machine::admissible(const Task& task) const {
    if (task.blocking && !(active_.empty() && lingering_.empty())) return false;
    // Two tasks of one service do not run at the same time, be it as a part of a composite.
    for (const auto& active : active_)
        if (active.halted || active.task.blocking ||
            profiler_.shareParts(active.task.plan.service, task.plan.service))
            return false;
    for (const auto& lingering : lingering_)
        if (lingering.blocking || profiler_.shareParts(lingering.service, task.plan.service)) return false;
    return true;
}

/// After a stop nothing starts before its callback has returned: on its own lane it could arrive after the
/// task and end that one.
bool EntityManagerCore::Machine::mayStart() const {
    return !latched_ && link_up_ && holder() != nullptr && !application_busy_ && stops_.standing();
}

/// In order of arrival: a task that must wait holds back those behind it, or it might wait for ever.
void EntityManagerCore::Machine::dispatchNext() {
    continueParts();
    while (!queue_.empty() && mayStart()) {
        if (queue_.front().not_after && clock_.now() >= *queue_.front().not_after) {
            expireTasks();
            continue;
        }
        // A stop that the signal thread has passed on and that has not come here yet: it voids the queue.
        if (queue_.front().generation != stop_gate_.generation() && !AXON_PLANTED(StopsUnderWayOverlooked))
            return;
        if (!admissible(queue_.front())) return;
        if (const auto prepared = prepare(queue_.front()); !prepared) {
            refusePrepared(prepared.refusal());
        } else if (prepared.value()) {
            dispatch(queue_.pop());
        } else {
            return;
        }
    }
}

/// Whether all is on the disk that must be there before the task begins: the files that it is given, and its
/// entry in the journal, or a next life might send it again. Nobody waits for that: the task does, at the
/// head of the queue, where whatever voids the queue voids it too.
Result<bool> EntityManagerCore::Machine::prepare(Task& task) {
    if (!task.looked) {
        std::vector<std::string> files;
        for (const auto& part : task.plan.parts)
            for (const auto& resource : part.resources)
                if (resource.url().starts_with('/')) files.push_back(resource.url());
        task.looked =
            files.empty() ? Later<std::vector<std::string>>(files) : store_.absent(std::move(files));
    }
    if (!task.looked->ready()) return false;
    if (!task.looked->value().empty()) return missingFiles(task);
    if (AXON_PLANTED(DispatchNotInTheJournal)) return true;
    if (!task.noted)
        task.noted = noteDispatch({.kind = JournalRecord::Kind::Dispatched,
                                   .who = named(*holder()),
                                   .task = task.id,
                                   .service = task.service,
                                   .text = task.plan.composite ? partText(task, 0) : std::string()});
    if (!task.noted->ready()) return false;
    if (recorded(task.noted->value())) return true;
    task.noted.reset();
    return Refusal{RefusalCode::Overloaded,
                   "The Entity Manager cannot write its journal, so it starts no task. Is the robot's disk "
                   "full? Make room, "
                   "then send it again under a new id.",
                   {}};
}

/// The resources whose files are gone are ready no longer, whoever removed them.
Refusal EntityManagerCore::Machine::missingFiles(const Task& task) {
    const auto& absent = task.looked->value();
    std::string missing;
    std::vector<int> changed;
    for (const auto& part : task.plan.parts)
        for (const auto& resource : part.resources) {
            if (std::find(absent.begin(), absent.end(), resource.url()) == absent.end()) continue;
            const auto& service = profiler_.record(part.service).name();
            if (!profiler_.loseResource(part.service, resource.name(), resource.url())) continue;
            missing += (missing.empty() ? "" : ", ") + inQuotes(resource.name()) + " of " +
                       inQuotes(service) + " (" + resource.url() + ')';
            changed.push_back(part.service);
        }
    tellServices(changed);
    return {RefusalCode::MissingDependency,
            "The file of a resource is no longer on the robot's machine: " +
                (missing.empty() ? absent.front() : missing) + ". Upload it again, then send the task again.",
            {}};
}

void EntityManagerCore::Machine::refusePrepared(const Refusal& refusal) {
    const auto task = queue_.pop();
    sendTask(task, proto::TASK_REFUSED, refusal);
}

void EntityManagerCore::Machine::dispatch(Task task) {
    Active active{.task = std::move(task)};
    memory_.dispatched(active.task.id);
    active_.push_back(std::move(active));
    sendPart(active_.back());
    sendTask(active_.back().task, proto::TASK_DISPATCHED, {});
}

/// The present part, to the robot application. It sees ordinary tasks only: each part of a composite has an
/// id of its own, which nobody else knows.
void EntityManagerCore::Machine::sendPart(Active& active) {
    if (!busy_told_) {
        // Before the task, so that the short watchdog is running when the robot starts.
        busy_told_ = true;
        back_end_.setBusy(true);
    }
    stop_gate_.spareClientLoss(false);
    const auto& task = active.task;
    active.sent = task.plan.composite ? Id128::random(random_) : task.id;
    active.answered = false;
    active.answer_until = clock_.now() + settings_.answer_within;
    auto message = dispatchOf(active.order(), profiler_.record(active.order().service).name(), *active.sent,
                              task.generation);
    if (active.part == 0) addGiven(message, task.plan, profiler_);
    if (task.not_after && active.part == 0) {
        const auto left =
            std::chrono::duration_cast<std::chrono::milliseconds>(*task.not_after - clock_.now());
        message.mutable_task()->set_start_within_ms(static_cast<std::uint32_t>(
            std::clamp<std::int64_t>(left.count(), 1, std::numeric_limits<std::int32_t>::max())));
    }
    markExecuting(task);
    back_end_.send(message);
}

/// Granted ones: what has only been dispatched does not make BUSY.
bool EntityManagerCore::Machine::anyRuns() const {
    return std::any_of(active_.begin(), active_.end(),
                       [](const Active& active) { return active.phase != Active::Phase::Dispatched; });
}

EntityManagerCore::Machine::Active* EntityManagerCore::Machine::findActive(const Id128& id) {
    for (auto& active : active_)
        if (active.task.id == id) return &active;
    return nullptr;
}

/// By the id that the robot application knows.
EntityManagerCore::Machine::Active* EntityManagerCore::Machine::findSent(const Id128& id) {
    for (auto& active : active_)
        if (active.sent == id) return &active;
    return nullptr;
}

void EntityManagerCore::Machine::granted(Active& active) {
    active.answered = true;
    const bool first = active.phase == Active::Phase::Dispatched;
    active.phase = Active::Phase::Running;
    proto::TaskEvent event;
    event.set_task_id(active.task.id.bytes());
    event.set_service(active.task.service);
    event.set_state(proto::TASK_RUNNING);
    event.set_progress(progressOf(active));
    if (active.task.plan.composite) event.set_feedback(partText(active));
    if (first) fire(Event::TaskGranted);  // the row may dispatch, and then `active` moves
    tellTask(event);
}

void EntityManagerCore::Machine::taskAnswer(const proto::TaskAnswer& answer) {
    const auto id = Id128::fromBytes(answer.task_id());
    auto* active = id ? findSent(*id) : nullptr;
    const bool denied = answer.has_refusal() && answer.refusal().code() != proto::OK;
    if (active == nullptr) {
        if (!(id && denied && lingeringEnded(*id))) ++counters_.unexpected;
        return;
    }
    if (active->answered) {
        ++counters_.unexpected;
        return;
    }
    if (!denied) {
        granted(*active);
        return;
    }
    proto::TaskEvent event;
    event.set_state(active->halted ? proto::TASK_STOPPED : proto::TASK_REFUSED);
    event.set_progress(-1);
    auto reason = toRefusal(answer.refusal());
    if (refusalName(reason.code) == refusalName(RefusalCode::Internal)) reason.code = RefusalCode::Denied;
    if (reason.message.empty()) reason.message = "The robot application denied the task without a reason.";
    if (active->halted) reason.code = RefusalCode::Stopped;
    *event.mutable_reason() = toProto(reason);
    endTask(static_cast<std::size_t>(active - active_.data()), std::move(event));
}

void EntityManagerCore::Machine::taskUpdate(proto::TaskEvent& update) {
    const auto id = Id128::fromBytes(update.task_id());
    auto* active = id ? findSent(*id) : nullptr;
    if (active == nullptr) {
        // A task whose end has been told already: it was stopped, and now its handler has returned.
        if (!(id && isFinal(update.state()) && lingeringEnded(*id))) ++counters_.unexpected;
        return;
    }
    // A part that has succeeded has been granted, and the composite runs.
    if (active->task.plan.composite && !active->answered && update.state() == proto::TASK_SUCCEEDED) {
        granted(*active);
        active = findSent(*id);
        if (active == nullptr) return;
    }
    if (isFinal(update.state())) {
        endTask(static_cast<std::size_t>(active - active_.data()), std::move(update));
        return;
    }
    if (!active->answered) {
        granted(*active);  // it runs, so it was granted
        active = findSent(*id);
        if (active == nullptr) return;
    }
    const auto before = active->phase;
    if (update.state() == proto::TASK_PAUSED) active->phase = Active::Phase::Paused;
    if (update.state() == proto::TASK_RUNNING) active->phase = Active::Phase::Running;
    // Without having been asked for: the next part of a composite waits all the same, or goes on.
    if (active->phase != before) active->hold = active->phase == Active::Phase::Paused;
    watchHeld(*active);
    update.set_state(active->phase == Active::Phase::Paused ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    update.set_task_id(active->task.id.bytes());
    update.set_service(active->task.service);
    if (active->task.plan.composite) nameAsWhole(*active, update);
    tellTask(update);
}

bool EntityManagerCore::Machine::lingeringEnded(const Id128& id) {
    if (std::erase_if(lingering_, [&](const Lingering& lingering) { return lingering.id == id; }) == 0)
        return false;
    fire(Event::TaskEnded);
    return true;
}

void EntityManagerCore::Machine::endTask(std::size_t at, proto::TaskState state, const Refusal& reason) {
    proto::TaskEvent event;
    event.set_state(state);
    event.set_progress(-1);
    if (!reason.ok()) *event.mutable_reason() = toProto(reason);
    endTask(at, std::move(event));
}

/// The robot application has said how it ended.
void EntityManagerCore::Machine::endTask(std::size_t at, proto::TaskEvent event) {
    if (active_[at].task.plan.composite && goOn(at, event)) return;
    if (!event.has_reason() && event.state() == proto::TASK_STOPPED)
        *event.mutable_reason() = toProto(
            Refusal{RefusalCode::Stopped,
                    active_[at].halted ? "Stopped by a reset." : "Stopped by the robot application itself.",
                    {}});
    if (!event.has_reason() && event.state() == proto::TASK_CANCELLED)
        *event.mutable_reason() = toProto(Refusal{RefusalCode::Cancelled, "Cancelled while it ran.", {}});
    if (!event.has_reason() && event.state() == proto::TASK_FAILED)
        *event.mutable_reason() =
            toProto(Refusal{RefusalCode::Failed, "The robot application gave no reason.", {}});
    const auto active = std::move(active_[at]);
    active_.erase(active_.begin() + static_cast<std::ptrdiff_t>(at));
    leaveService(active.task, event.state() != proto::TASK_REFUSED);
    endAsWhole(active, event);
    concludeTask(active.task, event);
    taskGone();
}

void EntityManagerCore::Machine::taskGone() {
    const bool last = !anyRuns() && !application_busy_ && state_ == EntityState::BUSY;
    fire(last ? Event::LastTaskEnded : Event::TaskEnded);
}

/// This side ends them. `linger`: the robot application still has to say that their handlers have returned.
void EntityManagerCore::Machine::endTasks(const Incident& incident, proto::TaskState state, bool linger) {
    auto ended = std::exchange(active_, {});
    auto reason = incident.reason;
    if (state == proto::TASK_UNKNOWN) reason.code = RefusalCode::OutcomeUnknown;
    for (auto& active : ended) {
        leaveService(active.task, true);
        proto::TaskEvent event;
        event.set_state(state);
        event.set_progress(-1);
        if (!reason.ok()) *event.mutable_reason() = toProto(reason);
        endAsWhole(active, event);
        concludeTask(active.task, event);
        if (linger && link_up_ && active.sent)
            lingering_.push_back({*active.sent, active.order().service, active.task.blocking});
    }
}

void EntityManagerCore::Machine::haltTasks() {
    for (auto& active : active_) active.halted = true;  // between two parts: continueParts()
}

/// Of the task's service and of its parts, whether a task that is active uses them.
void EntityManagerCore::Machine::markExecuting(const Task& task) {
    const auto mark = [this](int service) {
        profiler_.setExecuting(service,
                               std::any_of(active_.begin(), active_.end(), [service](const Active& active) {
                                   return active.task.plan.service == service ||
                                          (active.sent && active.order().service == service);
                               }));
    };
    mark(task.plan.service);
    if (task.plan.composite)
        for (const auto& part : task.plan.parts) mark(part.service);
}

void EntityManagerCore::Machine::leaveService(const Task& task, bool clear) {
    markExecuting(task);
    if (!clear) return;
    const auto cleared = profiler_.clearAfterTask(task.plan);
    for (const auto& [service, resource] : cleared.files)
        inputs_.remove(profiler_.record(service).name(), resource);
    tellServices(cleared.changed);
}

void EntityManagerCore::Machine::voidQueue(const Incident& incident) {
    const auto state = incident.event == Event::Clear ? proto::TASK_CANCELLED
                       : incident.event == Event::LinkDown || incident.event == Event::LinkEnded
                           ? proto::TASK_REFUSED
                           : proto::TASK_STOPPED;
    auto reason = incident.reason;
    if (incident.event == Event::Clear) reason.code = RefusalCode::Cancelled;
    for (const auto& task : queue_.clear()) sendTask(task, state, reason);
}

void EntityManagerCore::Machine::expireTasks() {
    for (const auto& task : queue_.expire(clock_.now()))
        sendTask(
            task, proto::TASK_REFUSED,
            {RefusalCode::Expired, "It waited longer than its not_after allows and was not started.", {}});
}

void EntityManagerCore::Machine::controlTask(const Incident& incident) {
    if (!teamwork_.control(incident)) controlOwnTask(incident);
}

void EntityManagerCore::Machine::controlOwnTask(const Incident& incident) {
    const auto& control = incident.body->task_control();
    const auto& to = incident.head->sender;
    const auto id = Id128::fromBytes(control.task_id());
    auto* active = id ? findActive(*id) : nullptr;
    if (active == nullptr) {
        if (id && incident.event == Event::Cancel) {
            if (const auto task = queue_.remove(*id)) {
                reply(to, control.task_id(), {});
                sendTask(*task, proto::TASK_CANCELLED,
                         {RefusalCode::Cancelled, "Cancelled while it waited.", {}});
                dispatchNext();
                return;
            }
        }
        refuse(
            incident,
            {RefusalCode::UnknownTask, "No task with this id is running or, to be cancelled, waiting.", {}});
        return;
    }
    proto::EmToEi message;
    const bool resume = incident.event == Event::Resume;
    if (incident.event == Event::Cancel) {
        if (active->sent) message.mutable_cancel()->set_task_id(active->sent->bytes());
    } else {
        if (!profiler_.record(active->task.plan.service).is_pausable()) {
            refuse(incident, {RefusalCode::NotPausable,
                              "Service " + inQuotes(active->task.service) + " cannot be paused. Cancel it.",
                              {}});
            return;
        }
        const auto needed = resume ? Active::Phase::Paused : Active::Phase::Running;
        if (active->phase != needed) {
            refuse(incident, {RefusalCode::WrongState,
                              resume ? "The task is not paused." : "The task is not running.",
                              {}});
            return;
        }
        if (active->sent) {
            message.mutable_pause()->set_task_id(active->sent->bytes());
            message.mutable_pause()->set_resume(resume);
            message.mutable_pause()->set_stop_generation(stops_.generation());
        }
    }
    if (active->sent && !back_end_.send(message)) {
        refuse(incident, {RefusalCode::TooLarge,
                          "The link to the robot application does not take it: it is too large.",
                          {}});
        return;
    }
    reply(to, control.task_id(), {});
    if (incident.event == Event::Cancel)
        active->cancelled = true;
    else
        active->hold = !resume;
    if (!active->sent) controlBetweenParts(*active);
}

void EntityManagerCore::Machine::sendTask(const Task& task, proto::TaskState state, const Refusal& reason) {
    proto::TaskEvent event;
    event.set_state(state);
    event.set_progress(-1);
    if (!reason.ok()) *event.mutable_reason() = toProto(reason);
    if (isFinal(state)) {
        concludeTask(task, event);
        return;
    }
    event.set_task_id(task.id.bytes());
    event.set_service(task.service);
    tellTask(event);
}

void EntityManagerCore::Machine::tellTask(proto::TaskEvent& event) {
    if (teamwork_.tellStep(event)) return;
    if (holder() == nullptr || !connected()) return;
    proto::ToClient message;
    message.mutable_task()->Swap(&event);
    tell(*holder(), kMsgTask, message);
}

void EntityManagerCore::Machine::concludeTask(const Task& task, proto::TaskEvent& event) {
    event.set_task_id(task.id.bytes());
    event.set_service(task.service);
    if (memory_.wasDispatched(task.id) || task.noted)
        note({.kind = JournalRecord::Kind::TaskEnded,
              .task = task.id,
              .service = task.service,
              .code = proto::TaskState_Name(event.state()),
              .text = event.reason().message()});
    memory_.ended(task.id, held() ? held()->number : LeaseNumber{}, event, clock_.now());
    tellTask(event);
}

void EntityManagerCore::Machine::tellFinals() {
    if (holder() == nullptr) return;
    proto::ToClient message;
    for (auto& event : memory_.finals(held()->number, ownership_.lostAt() - kUnnoticed)) {
        message.mutable_task()->Swap(&event);
        tell(*holder(), kMsgTask, message);
    }
}

/// An application that does not answer must not leave its asker waiting for ever.
void EntityManagerCore::Machine::expireAnswers() {
    const auto now = clock_.now();
    const std::string within =
        std::to_string(
            std::chrono::duration_cast<std::chrono::milliseconds>(settings_.answer_within).count()) +
        " ms";
    for (std::size_t i = 0; i < active_.size();) {
        if (!active_[i].sent || active_[i].answered || active_[i].answer_until > now) {
            ++i;
            continue;
        }
        // It may still begin, so it is cancelled, and nothing that it excludes starts before it has ended
        // there.
        const auto& active = active_[i];
        proto::EmToEi cancel;
        cancel.mutable_cancel()->set_task_id(active.sent->bytes());
        back_end_.send(cancel);
        lingering_.push_back({*active.sent, active.order().service, active.task.blocking});
        endTask(i, proto::TASK_UNKNOWN,
                {RefusalCode::TimedOut,
                 "The robot application has neither granted nor denied it within " + within +
                     ". It has been cancelled and may have begun: look at the robot.",
                 {}});
    }
}

/// What has been accepted can still be sent with it.
Refusal EntityManagerCore::Machine::leavesRoom(int service, const proto::Param& param) const {
    const auto fits = [&](const ServiceProfiler::Plan& plan) {
        std::size_t parts = 0;
        for (const auto& part : plan.parts)
            if (std::find(part.way.begin(), part.way.end(), service) != part.way.end()) ++parts;
        return parts == 0 || checkSize(dispatchBytes(plan) + (parts + 1) * param.ByteSizeLong()).ok();
    };
    bool all = true;
    for (const auto& task : queue_.waiting()) all = all && fits(task.plan);
    for (const auto& active : active_) all = all && (active.lastPart() || fits(active.task.plan));
    if (all) return {};
    return {RefusalCode::TooLarge,
            "A task that has been accepted would become larger with it than the robot application takes at "
            "once. Wait for its end, or set a shorter value.",
            {}};
}

void EntityManagerCore::Machine::reconfigure(int service, const proto::Param& param) {
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
    back_end_.send(message);
}

/// A task that the disk holds up: its client is told that it waits.
void EntityManagerCore::Machine::tellHeldUp() {
    if (queue_.empty()) return;
    auto& first = queue_.front();
    if (!first.tell_at || clock_.now() < *first.tell_at) return;
    first.tell_at.reset();
    sendTask(first, proto::TASK_QUEUED, {});
}

}  // namespace axon::entity_manager
