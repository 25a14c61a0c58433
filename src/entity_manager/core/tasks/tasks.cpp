// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/tasks/tasks.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "collaboration/collaboration.hpp"
#include "common/planted_bug.hpp"
#include "entity_manager/core/services/message_size.hpp"
#include "entity_manager/core/services/tell_services.hpp"
#include "entity_manager/ports/core_settings.hpp"
#include "entity_manager/ports/journal_record.hpp"
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

}  // namespace

Tasks::Tasks(Turn& turn, Others& others, JournalWriter& journal, BackEndPort& back_end, ResourceStore& store,
             StopGenerations& stop_generations, RandomSource& random, ServiceProfiler& profiler,
             TaskMemory& memory, Settings settings)
    : turn_(turn),
      others_(others),
      journal_(journal),
      back_end_(back_end),
      store_(store),
      stop_generations_(stop_generations),
      random_(random),
      profiler_(profiler),
      memory_(memory),
      settings_(settings),
      queue_(settings.queue_bound) {}

void Tasks::consider(const Incident& incident) {
    if (others_.isReserved()) {
        turn_.refuse(
            incident,
            {RefusalCode::WrongState,
             "The entity takes part in a collaboration and takes tasks of its master alone. Wait for its "
             "end, or stop it.",
             {}});
        return;
    }
    if (const auto refusal = admit(incident.body->task(), incident.head->sent_at_us); !refusal.ok())
        turn_.refuse(incident, refusal);
}

Refusal Tasks::admit(const proto::TaskRequest& request, std::int64_t sent_at_us) {
    const auto id = Id128::fromBytes(request.task_id());
    if (!id || id->isZero())
        return {RefusalCode::Malformed, "task_id must be 16 bytes that are not all zero.", {}};
    if (!std::isfinite(request.not_after_s()) || request.not_after_s() < 0)
        return {RefusalCode::Malformed, "not_after_s must be a number of seconds from 0 on.", {}};
    if (const auto again = memory_.whyNotAgain(*id); again && !AXON_PLANTED(TaskIdForgotten)) return *again;
    if (const auto refusal = queue_.mayPush(); !refusal.ok()) return refusal;
    auto plan = profiler_.prepare(request.service(), request.params());
    if (!plan && plan.refusal().code == RefusalCode::MissingDependency && profiler_.hasUrls()) {
        others_.lookAgain();  // for this task where the disk answers at once, else for the next
        plan = profiler_.prepare(request.service(), request.params());
    }
    if (!plan) return plan.refusal();
    const auto& service = profiler_.record(plan->service);
    Task task;
    task.id = *id;
    task.service = service.name();
    task.blocking = service.is_blocking();
    task.plan = std::move(plan).value();
    task.generation = turn_.stops().generation;
    if (request.not_after_s() > 0 && request.not_after_s() < kLongestNotAfter_s &&
        !AXON_PLANTED(ExpiryUnchecked))
        task.not_after =
            (AXON_PLANTED(ExpiryByTheSendersClock) ? TimePoint{std::chrono::microseconds{sent_at_us}}
                                                   : turn_.now()) +
            std::chrono::duration_cast<Duration>(std::chrono::duration<double>(request.not_after_s()));
    if (const auto refusal = checkSize(dispatchBytes(task.plan, 0)); !refusal.ok()) return refusal;
    memory_.accept(task.id);
    queue_.push(std::move(task));
    dispatchNext();
    if (queue_.empty() || queue_.waiting().back().id != *id) return {};
    // What waits for nothing but the disk is about to begin.
    if (queue_.front().id == *id && queue_.front().preparing())
        queue_.front().tell_at = turn_.now() + kQueuedUntold;
    else
        sendTask(queue_.waiting().back(), proto::TASK_QUEUED, {});
    return {};
}

bool Tasks::admissible(const Task& task) const {
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
bool Tasks::mayStart() const {
    return !turn_.latched() && turn_.linked() && turn_.holder() != nullptr && !application_busy_ &&
           turn_.stops().standing;
}

/// A stop that the signal thread has passed on and that has not come here yet voids the queue.
bool Tasks::isOvertakenByAStop(const Task& task) const {
    return task.generation != stop_generations_.generation() && !AXON_PLANTED(StopsUnderWayOverlooked);
}

/// In order of arrival: a task that must wait holds back those behind it, or it might wait for ever.
void Tasks::dispatchNext() {
    continueParts();
    while (!queue_.empty() && mayStart()) {
        if (queue_.front().not_after && turn_.now() >= *queue_.front().not_after) {
            expireQueue();
            continue;
        }
        if (isOvertakenByAStop(queue_.front())) return;
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
Result<bool> Tasks::prepare(Task& task) {
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
        task.noted = journal_.noteDispatch(
            {.kind = JournalRecord::Kind::Dispatched,
             .who = named(*turn_.holder()),
             .client = turn_.holder()->id,
             .task = task.id,
             .service = task.service,
             .text = task.plan.composite ? partText(profiler_, task, 0) : std::string()});
    if (!task.noted->ready()) return false;
    if (journal_.recorded(task.noted->value())) return true;
    task.noted.reset();
    return Refusal{RefusalCode::Overloaded,
                   "The Entity Manager cannot write its journal, so it starts no task. Is the robot's disk "
                   "full? Make room, "
                   "then send it again under a new id.",
                   {}};
}

/// The resources whose files are gone are ready no longer, whoever removed them.
Refusal Tasks::missingFiles(const Task& task) {
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
    tellServices(turn_, profiler_, changed);
    return {RefusalCode::MissingDependency,
            "The file of a resource is no longer on the robot's machine: " +
                (missing.empty() ? absent.front() : missing) + ". Upload it again, then send the task again.",
            {}};
}

void Tasks::refusePrepared(const Refusal& refusal) {
    const auto task = queue_.pop();
    sendTask(task, proto::TASK_REFUSED, refusal);
}

void Tasks::dispatch(Task task) {
    ActiveTask active{.task = std::move(task)};
    memory_.dispatched(active.task.id);
    active_.push_back(std::move(active));
    sendPart(active_.back());
    sendTask(active_.back().task, proto::TASK_DISPATCHED, {});
}

bool Tasks::anyRuns() const {
    return std::any_of(active_.begin(), active_.end(), [](const ActiveTask& active) {
        return active.phase != ActiveTask::Phase::Dispatched;
    });
}

ActiveTask* Tasks::findActive(const Id128& id) {
    for (auto& active : active_)
        if (active.task.id == id) return &active;
    return nullptr;
}

/// By the id that the robot application knows.
ActiveTask* Tasks::findSent(const Id128& id) {
    for (auto& active : active_)
        if (active.sent == id) return &active;
    return nullptr;
}

void Tasks::granted(ActiveTask& active) {
    active.answered = true;
    const bool first = active.phase == ActiveTask::Phase::Dispatched;
    active.phase = ActiveTask::Phase::Running;
    proto::TaskEvent event;
    event.set_task_id(active.task.id.bytes());
    event.set_service(active.task.service);
    event.set_state(proto::TASK_RUNNING);
    event.set_progress(active.progress());
    if (active.task.plan.composite) event.set_feedback(active.partText(profiler_));
    if (first) turn_.fire(Event::TaskGranted);  // the row may dispatch, and then `active` moves
    tellTask(event);
}

void Tasks::answered(const proto::TaskAnswer& answer) {
    const auto id = Id128::fromBytes(answer.task_id());
    auto* active = id ? findSent(*id) : nullptr;
    const bool denied = answer.has_refusal() && answer.refusal().code() != proto::OK;
    if (active == nullptr) {
        if (!(id && denied && lingeringEnded(*id))) ++turn_.count().unexpected;
        return;
    }
    if (active->answered) {
        ++turn_.count().unexpected;
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

void Tasks::updated(proto::TaskEvent& update) {
    const auto id = Id128::fromBytes(update.task_id());
    auto* active = id ? findSent(*id) : nullptr;
    if (active == nullptr) {
        // A task whose end has been told already: it was stopped, and now its handler has returned.
        if (!(id && isFinal(update.state()) && lingeringEnded(*id))) ++turn_.count().unexpected;
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
    if (update.state() == proto::TASK_PAUSED) active->phase = ActiveTask::Phase::Paused;
    if (update.state() == proto::TASK_RUNNING) active->phase = ActiveTask::Phase::Running;
    // Without having been asked for: the next part of a composite waits all the same, or goes on.
    if (active->phase != before) active->hold = active->phase == ActiveTask::Phase::Paused;
    watchHeld(*active);
    update.set_state(active->phase == ActiveTask::Phase::Paused ? proto::TASK_PAUSED : proto::TASK_RUNNING);
    update.set_task_id(active->task.id.bytes());
    update.set_service(active->task.service);
    if (active->task.plan.composite) active->nameAsWhole(profiler_, update);
    tellTask(update);
}

bool Tasks::lingeringEnded(const Id128& id) {
    if (std::erase_if(lingering_, [&](const Lingering& lingering) { return lingering.id == id; }) == 0)
        return false;
    turn_.fire(Event::TaskEnded);
    return true;
}

void Tasks::endTask(std::size_t at, proto::TaskState state, const Refusal& reason) {
    proto::TaskEvent event;
    event.set_state(state);
    event.set_progress(-1);
    if (!reason.ok()) *event.mutable_reason() = toProto(reason);
    endTask(at, std::move(event));
}

/// The robot application has said how it ended.
void Tasks::endTask(std::size_t at, proto::TaskEvent event) {
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
    active.endAsWhole(profiler_, event);
    concludeTask(active.task, event);
    taskGone();
}

void Tasks::taskGone() {
    const bool last = !anyRuns() && !application_busy_ && turn_.state() == EntityState::BUSY;
    turn_.fire(last ? Event::LastTaskEnded : Event::TaskEnded);
}

/// This side ends them. `linger`: the robot application still has to say that their handlers have returned.
void Tasks::end(const Incident& incident, proto::TaskState state, bool linger) {
    auto ended = std::exchange(active_, {});
    auto reason = incident.reason;
    if (state == proto::TASK_UNKNOWN) reason.code = RefusalCode::OutcomeUnknown;
    for (auto& active : ended) {
        leaveService(active.task, true);
        proto::TaskEvent event;
        event.set_state(state);
        event.set_progress(-1);
        if (!reason.ok()) *event.mutable_reason() = toProto(reason);
        active.endAsWhole(profiler_, event);
        concludeTask(active.task, event);
        if (linger && turn_.linked() && active.sent)
            lingering_.push_back({*active.sent, active.order().service, active.task.blocking});
    }
}

void Tasks::halt() {
    for (auto& active : active_) active.halted = true;  // between two parts: continueParts()
}

/// Of the task's service and of its parts, whether a task that is active uses them.
void Tasks::markExecuting(const Task& task) {
    const auto mark = [this](int service) {
        profiler_.setExecuting(
            service, std::any_of(active_.begin(), active_.end(), [service](const ActiveTask& active) {
                return active.task.plan.service == service ||
                       (active.sent && active.order().service == service);
            }));
    };
    mark(task.plan.service);
    if (task.plan.composite)
        for (const auto& part : task.plan.parts) mark(part.service);
}

void Tasks::leaveService(const Task& task, bool clear) {
    markExecuting(task);
    if (!clear) return;
    const auto cleared = profiler_.clearAfterTask(task.plan);
    for (const auto& [service, resource] : cleared.files)
        others_.removeResource(profiler_.record(service).name(), resource);
    tellServices(turn_, profiler_, cleared.changed);
}

void Tasks::voidQueue(const Incident& incident) {
    if (AXON_PLANTED(QueueNotVoided)) return;
    const auto state = incident.event == Event::Clear ? proto::TASK_CANCELLED
                       : incident.event == Event::LinkDown || incident.event == Event::LinkEnded
                           ? proto::TASK_REFUSED
                           : proto::TASK_STOPPED;
    auto reason = incident.reason;
    if (incident.event == Event::Clear) reason.code = RefusalCode::Cancelled;
    for (const auto& task : queue_.clear()) sendTask(task, state, reason);
}

void Tasks::expireQueue() {
    for (const auto& task : queue_.expire(turn_.now()))
        sendTask(
            task, proto::TASK_REFUSED,
            {RefusalCode::Expired, "It waited longer than its not_after allows and was not started.", {}});
}

void Tasks::control(const Incident& incident) {
    const auto& control = incident.body->task_control();
    const auto& to = incident.head->sender;
    const auto id = Id128::fromBytes(control.task_id());
    auto* active = id ? findActive(*id) : nullptr;
    if (active == nullptr) {
        if (id && incident.event == Event::Cancel) {
            if (const auto task = queue_.remove(*id)) {
                journal_.mentionControl(to, control.task_id(), toString(incident.event));
                turn_.reply(to, control.task_id(), {});
                sendTask(*task, proto::TASK_CANCELLED,
                         {RefusalCode::Cancelled, "Cancelled while it waited.", {}});
                dispatchNext();
                return;
            }
        }
        turn_.refuse(
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
            turn_.refuse(incident,
                         {RefusalCode::NotPausable,
                          "Service " + inQuotes(active->task.service) + " cannot be paused. Cancel it.",
                          {}});
            return;
        }
        const auto needed = resume ? ActiveTask::Phase::Paused : ActiveTask::Phase::Running;
        if (active->phase != needed) {
            turn_.refuse(incident, {RefusalCode::WrongState,
                                    resume ? "The task is not paused." : "The task is not running.",
                                    {}});
            return;
        }
        if (active->sent) {
            message.mutable_pause()->set_task_id(active->sent->bytes());
            message.mutable_pause()->set_resume(resume);
            message.mutable_pause()->set_stop_generation(turn_.stops().generation);
        }
    }
    if (active->sent && !turn_.toApplication(message)) {
        turn_.refuse(incident, {RefusalCode::TooLarge,
                                "The link to the robot application does not take it: it is too large.",
                                {}});
        return;
    }
    journal_.mentionControl(to, control.task_id(), toString(incident.event));
    turn_.reply(to, control.task_id(), {});
    if (incident.event == Event::Cancel)
        active->cancelled = true;
    else
        active->hold = !resume;
    if (!active->sent) controlBetweenParts(*active);
}

void Tasks::sendTask(const Task& task, proto::TaskState state, const Refusal& reason) {
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

void Tasks::tellTask(proto::TaskEvent& event) {
    if (others_.tellStep(event)) return;
    if (turn_.holder() == nullptr || !turn_.connected()) return;
    proto::ToClient message;
    message.mutable_task()->Swap(&event);
    turn_.tell(*turn_.holder(), kMsgTask, message);
}

void Tasks::concludeTask(const Task& task, proto::TaskEvent& event) {
    event.set_task_id(task.id.bytes());
    event.set_service(task.service);
    JournalRecord record{.kind = JournalRecord::Kind::TaskEnded,
                         .task = task.id,
                         .service = task.service,
                         .code = proto::TaskState_Name(event.state()),
                         .text = event.reason().message()};
    if (turn_.holder() != nullptr) record.client = turn_.holder()->id;
    if (memory_.wasDispatched(task.id) || task.noted)
        journal_.note(std::move(record));
    else
        journal_.mention(std::move(record));
    memory_.ended(task.id, turn_.held() ? turn_.held()->number : LeaseNumber{}, event, turn_.now());
    tellTask(event);
}

void Tasks::tellFinals(TimePoint lost_at) {
    if (turn_.holder() == nullptr) return;
    proto::ToClient message;
    for (auto& event : memory_.finals(turn_.held()->number, lost_at - kUnnoticed)) {
        message.mutable_task()->Swap(&event);
        turn_.tell(*turn_.holder(), kMsgTask, message);
    }
}

/// An application that does not answer must not leave its asker waiting for ever.
void Tasks::expireAnswers() {
    const auto now = turn_.now();
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
        turn_.toApplication(cancel);
        lingering_.push_back({*active.sent, active.order().service, active.task.blocking});
        endTask(i, proto::TASK_UNKNOWN,
                {RefusalCode::TimedOut,
                 "The robot application has neither granted nor denied it within " + within +
                     ". It has been cancelled and may have begun: look at the robot.",
                 {}});
    }
}

/// A task that the disk holds up: its client is told that it waits.
void Tasks::tellHeldUp() {
    if (queue_.empty()) return;
    auto& first = queue_.front();
    if (!first.tell_at || turn_.now() < *first.tell_at) return;
    first.tell_at.reset();
    sendTask(first, proto::TASK_QUEUED, {});
}

void Tasks::applicationIs(const proto::StatusNote& note) {
    if (!note.text().empty()) {
        if (turn_.holder() != nullptr) {
            proto::ToClient text;
            text.mutable_text()->set_text(note.text());
            turn_.tell(*turn_.holder(), kMsgText, text);
        } else {
            ++turn_.count().undelivered;
        }
    }
    if (note.busy() == application_busy_) return;
    application_busy_ = note.busy();
    if (application_busy_)
        turn_.fire(Event::ApplicationBusy);
    else
        turn_.fire(turn_.state() == EntityState::BUSY && !anyRuns() ? Event::LastTaskEnded
                                                                    : Event::ApplicationReady);
}

void Tasks::settle() {
    // A stop that the signal thread has passed on may end the last task before this strand hears of the stop:
    // it finds a robot that moves.
    const bool occupied = !active_.empty() || !lingering_.empty() || application_busy_ ||
                          (busy_told_ && !turn_.stops().all_handled);
    if (occupied != busy_told_) {
        busy_told_ = occupied;
        back_end_.setBusy(occupied);  // without a link too: the next one begins with what was said last
    }
    stop_generations_.spareClientLoss(survivesClientLoss());
}

void Tasks::shutDown() {
    if (busy_told_ && turn_.linked()) back_end_.setBusy(false);
}

void Tasks::onTimer() {
    expireQueue();
    expireAnswers();
    expireSpared();
    tellHeldUp();
}

TimePoint Tasks::nextDeadline() const {
    auto next = queue_.nextExpiry().value_or(TimePoint::max());
    if (!queue_.empty() && queue_.front().tell_at) next = std::min(next, *queue_.front().tell_at);
    for (const auto& active : active_) {
        if (active.sent && !active.answered) next = std::min(next, active.answer_until);
        if (active.alone_until) next = std::min(next, *active.alone_until);
    }
    return next;
}

void Tasks::restamp() {
    if (turn_.stops().all_handled) queue_.restamp(turn_.stops().generation);
}

void Tasks::describe(proto::EntityStatus& status) const {
    for (const auto& active : active_) {
        auto& task = *status.add_tasks();
        task.set_task_id(active.task.id.bytes());
        task.set_service(active.task.service);
        task.set_state(active.phase == ActiveTask::Phase::Dispatched ? proto::TASK_DISPATCHED
                       : active.phase == ActiveTask::Phase::Paused   ? proto::TASK_PAUSED
                                                                     : proto::TASK_RUNNING);
        task.set_progress(active.progress());
    }
    for (const auto& waiting : queue_.waiting()) {
        auto& task = *status.add_tasks();
        task.set_task_id(waiting.id.bytes());
        task.set_service(waiting.service);
        task.set_state(proto::TASK_QUEUED);
        task.set_progress(-1);
    }
}

void Tasks::refuse(const Incident& incident, const Refusal& refusal) {
    const auto& to = incident.head->sender;
    proto::ToClient message;
    auto& event = *message.mutable_task();
    event.set_task_id(incident.body->task().task_id());
    event.set_service(incident.body->task().service());
    event.set_state(proto::TASK_REFUSED);
    event.set_progress(-1);
    // Of a task that was accepted before, its sender must not think that this is its end.
    const auto id = Id128::fromBytes(incident.body->task().task_id());
    const auto again = id ? memory_.whyNotAgain(*id) : std::nullopt;
    *event.mutable_reason() = toProto(again ? *again : refusal);
    if (again && again->code == RefusalCode::OutcomeUnknown) event.set_state(proto::TASK_UNKNOWN);
    // This is its end, so a copy that comes later must not begin. Others than the holder cannot fill
    // the memory.
    if (id && !again && turn_.checkLease(to, incident.head->held).ok())
        memory_.ended(*id, turn_.held()->number, event, turn_.now());
    turn_.tell(to, kMsgTask, message);
}

}  // namespace axon::entity_manager
