// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <utility>

#include "entity_interfacer/frame.hpp"
#include "common/planted_bug.hpp"
#include "entity_manager/machine.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

using collaboration::isFinal;

namespace {

constexpr std::size_t kQuestions = 64;
/// For so long a client may have been gone before its loss was known: the server's watchdog of a client.
constexpr Duration kUnnoticed = std::chrono::seconds{10};
constexpr double kLongestNotAfter_s = 1e6;
/// Some bytes are left for a stop generation that grows while a task waits.
constexpr std::size_t kMessageMax = kFrameMax - 64;

proto::EmToEi dispatchOf(const ServiceProfiler::Order& part, const std::string& service, const Id128& id,
                         std::uint32_t generation) {
    proto::EmToEi message;
    auto& order = *message.mutable_task();
    order.set_task_id(id.bytes());
    order.set_service(service);
    order.set_stop_generation(generation);
    for (const auto& param : part.params) *order.add_params() = param;
    for (const auto& resource : part.resources) *order.add_resources() = resource;
    return message;
}

/// The link has no larger frames, and what cannot be sent would never be answered.
Refusal checkSize(std::size_t bytes) {
    if (bytes <= kMessageMax) return {};
    return {RefusalCode::TooLarge,
            "With all parameters it has " + std::to_string(bytes) +
                " bytes, and the robot application takes at most " + std::to_string(kMessageMax) +
                " at once. Shorten the parameters, or upload a resource.",
            {}};
}

}  // namespace

// -- tasks
// ----------------------------------------------------------------------------------------------------------

void EntityManagerCore::Machine::admitTask(const Incident& incident) {
    if (member_) {
        refuse(incident, {RefusalCode::WrongState,
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
    if (!id || id->isZero()) return {RefusalCode::Malformed, "task_id must be 16 bytes that are not all zero.", {}};
    if (!std::isfinite(request.not_after_s()) || request.not_after_s() < 0)
        return {RefusalCode::Malformed, "not_after_s must be a number of seconds from 0 on.", {}};
    if (const auto again = memory_.whyNotAgain(*id); again && !AXON_PLANTED(TaskIdForgotten)) return *again;
    if (const auto refusal = queue_.mayPush(); !refusal.ok()) return refusal;
    auto plan = profiler_.prepare(request.service(), request.params());
    if (!plan) return plan.refusal();
    const auto& service = profiler_.record(plan->service);
    Task task;
    task.id = *id;
    task.service = service.name();
    task.blocking = service.is_blocking();
    task.plan = std::move(plan).value();
    task.generation = generation_;
    if (request.not_after_s() > 0 && request.not_after_s() < kLongestNotAfter_s && !AXON_PLANTED(ExpiryUnchecked))
        task.not_after = (AXON_PLANTED(ExpiryByTheSendersClock) ? TimePoint{std::chrono::microseconds{sent_at_us}}
                                                                : clock_.now()) +
                         std::chrono::duration_cast<Duration>(std::chrono::duration<double>(request.not_after_s()));
    std::size_t bytes = 0;  // of all parts: a composite takes no more memory than another task
    for (const auto& part : task.plan.parts)
        bytes += dispatchOf(part, profiler_.record(part.service).name(), task.id, generation_).ByteSizeLong();
    if (const auto refusal = checkSize(bytes); !refusal.ok()) return refusal;
    memory_.accept(task.id);
    queue_.push(std::move(task));
    dispatchNext();
    if (!queue_.empty() && queue_.waiting().back().id == *id)
        sendTask(queue_.waiting().back(), proto::TASK_QUEUED, {});
    return {};
}

bool EntityManagerCore::Machine::admissible(const Task& task) const {
    if (task.blocking && !(active_.empty() && lingering_.empty())) return false;
    // Two tasks of one service do not run at the same time, be it as a part of a composite.
    for (const auto& active : active_)
        if (active.halted || active.task.blocking || profiler_.shareParts(active.task.plan.service, task.plan.service))
            return false;
    for (const auto& lingering : lingering_)
        if (lingering.blocking || profiler_.shareParts(lingering.service, task.plan.service)) return false;
    return true;
}

/// After a stop nothing starts before its callback has returned: on its own lane it could arrive after the task and
/// end that one.
bool EntityManagerCore::Machine::mayStart() const {
    return !latched_ && link_up_ && holder() != nullptr && !application_busy_ && standing();
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
        if (queue_.front().generation != stop_gate_.generation() && !AXON_PLANTED(StopsUnderWayOverlooked)) return;
        if (!admissible(queue_.front())) return;
        dispatch(queue_.pop());
    }
}

void EntityManagerCore::Machine::dispatch(Task task) {
    Active active{.task = std::move(task)};
    // Before it is sent, or a next life might send it again.
    if (!AXON_PLANTED(DispatchNotInTheJournal) &&
        !note({.kind = JournalRecord::Kind::Dispatched,
               .who = named(*holder()),
               .task = active.task.id,
               .service = active.task.service,
               .text = active.task.plan.composite ? partText(active) : std::string()})) {
        sendTask(active.task, proto::TASK_REFUSED,
                 {RefusalCode::Overloaded,
                  "The Entity Manager cannot write its journal, so it starts no task. Is the robot's disk "
                  "full? Make room, "
                  "then send it again under a new id.",
                  {}});
        return;
    }
    memory_.dispatched(active.task.id);
    active_.push_back(std::move(active));
    sendPart(active_.back());
    sendTask(active_.back().task, proto::TASK_DISPATCHED, {});
}

/// The present part, to the robot application. It sees ordinary tasks only: each part of a composite has an id of its
/// own, which nobody else knows.
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
    auto message =
        dispatchOf(active.order(), profiler_.record(active.order().service).name(), *active.sent, task.generation);
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
        *event.mutable_reason() =
            toProto(Refusal{RefusalCode::Stopped,
                            active_[at].halted ? "Stopped by a reset." : "Stopped by the robot application itself.",
                            {}});
    if (!event.has_reason() && event.state() == proto::TASK_CANCELLED)
        *event.mutable_reason() = toProto(Refusal{RefusalCode::Cancelled, "Cancelled while it ran.", {}});
    if (!event.has_reason() && event.state() == proto::TASK_FAILED)
        *event.mutable_reason() = toProto(Refusal{RefusalCode::Failed, "The robot application gave no reason.", {}});
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
        profiler_.setExecuting(service, std::any_of(active_.begin(), active_.end(), [service](const Active& active) {
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
        store_.remove(profiler_.record(service).name(), resource);
    sendServices(cleared.changed);
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
    if (controlRun(incident)) return;
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
            message.mutable_pause()->set_stop_generation(generation_);
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
    if (member_) {
        const auto id = Id128::fromBytes(event.task_id());
        if (const auto step = member_->steps.find(*id); step != member_->steps.end()) {
            if (!isFinal(event.state())) {
                tellStep(step->second, event);
                return;
            }
            auto last = std::move(step->second);
            member_->steps.erase(step);  // before it is told: the master's own next order may come of it
            tellStep(last, event);
            return;
        }
    }
    if (holder() == nullptr || !server_up_) return;
    proto::ToClient message;
    message.mutable_task()->Swap(&event);
    tell(*holder(), kMsgTask, message);
}

void EntityManagerCore::Machine::concludeTask(const Task& task, proto::TaskEvent& event) {
    event.set_task_id(task.id.bytes());
    event.set_service(task.service);
    if (memory_.wasDispatched(task.id))
        note({.kind = JournalRecord::Kind::TaskEnded,
              .task = task.id,
              .service = task.service,
              .code = proto::TaskState_Name(event.state()),
              .text = event.reason().message()});
    memory_.ended(task.id, lease_.held() ? lease_.held()->number : LeaseNumber{}, event, clock_.now());
    tellTask(event);
}

void EntityManagerCore::Machine::tellFinals() {
    if (holder() == nullptr) return;
    proto::ToClient message;
    for (auto& event : memory_.finals(lease_.held()->number, lost_at_ - kUnnoticed)) {
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
    while (!questions_.empty() && questions_.begin()->second.until <= now) {
        const auto question = std::move(questions_.begin()->second);
        questions_.erase(questions_.begin());
        if (question.resource >= 0) store_.remove(question.service_name, question.resource_name);
        conclude(question, {RefusalCode::TimedOut,
                            "The robot application has not answered within " + within +
                                ". It may be hanging: look at it, then try again.",
                            {}});
    }
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

// -- parameters and resources
// ---------------------------------------------------------------------------------------

void EntityManagerCore::Machine::askParameter(const Incident& incident) {
    const auto& request = incident.body->set_param();
    auto checked = profiler_.checkParam(request.service(), request.param());
    if (!checked) {
        refuse(incident, checked.refusal());
        return;
    }
    if (questions_.size() >= kQuestions) {
        refuse(incident, {RefusalCode::Overloaded,
                          "The robot application has " + std::to_string(kQuestions) +
                              " requests to answer already. Wait for some answers.",
                          {}});
        return;
    }
    Question question;
    question.asker = incident.head->sender;
    question.lease = incident.head->held;
    question.request_id = request.request_id();
    question.service = checked->first;
    question.param = std::move(checked->second);
    const auto number = next_question_++;
    proto::EmToEi message;
    auto& ask = *message.mutable_param();
    ask.set_request(number);
    ask.set_service(profiler_.record(question.service).name());
    *ask.mutable_param() = question.param;
    ask.set_stop_generation(generation_);
    if (const auto refusal = checkSize(message.ByteSizeLong()); !refusal.ok()) {
        refuse(incident, refusal);
        return;
    }
    question.until = clock_.now() + settings_.answer_within;
    questions_.emplace(number, std::move(question));
    back_end_.send(message);
}

void EntityManagerCore::Machine::answer(const proto::RequestAnswer& answer) {
    const auto at = questions_.find(answer.request());
    if (at == questions_.end()) {
        ++counters_.unexpected;
        return;
    }
    const auto question = std::move(at->second);
    questions_.erase(at);
    Refusal refusal;
    if (answer.has_refusal() && answer.refusal().code() != proto::OK) {
        refusal = toRefusal(answer.refusal());
        if (refusalName(refusal.code) == refusalName(RefusalCode::Internal))
            refusal.code = RefusalCode::Denied;
        if (refusal.message.empty()) refusal.message = "The robot application denied it without a reason.";
    }
    // Between question and answer the lease may have ended; what was meant for it is not kept for the next
    // holder.
    const bool present = lease_.held() && lease_.held()->number == question.lease;
    if (refusal.ok() && !present)
        refusal = {
            RefusalCode::RevokedLease, "The lease ended before the robot application had answered.", {}};
    if (question.resource >= 0) {
        if (refusal.ok())
            profiler_.storeResource(question.service, question.resource, question.path, question.sha256,
                                    question.size);
        else
            store_.remove(question.service_name, question.resource_name);
    } else if (refusal.ok()) {
        profiler_.storeParam(question.service, question.param);
    }
    conclude(question, refusal);
    if (refusal.ok()) sendServices({question.service});
}

void EntityManagerCore::Machine::conclude(const Question& question, const Refusal& refusal) {
    if (question.resource >= 0)
        sendResourceDone(question.asker, question.request_id, question.resource_name, refusal);
    else
        reply(question.asker, question.request_id, refusal);
}

void EntityManagerCore::Machine::abandonRequests(const Refusal& reason) {
    for (const auto& [number, question] : std::exchange(questions_, {})) conclude(question, reason);
}

void EntityManagerCore::Machine::carryResource(const Incident& incident) {
    const auto& to = incident.head->sender;
    if (incident.body->has_resource_offer()) {
        const auto& offer = incident.body->resource_offer();
        const auto place = profiler_.findResource(offer.service(), offer.resource());
        if (!place) {
            refuse(incident, place.refusal());
            return;
        }
        // The names of the profile, not the spelling of the client: they become a path.
        auto named = offer;
        const auto& service = profiler_.record(place->first);
        named.set_service(service.name());
        named.set_resource(service.resources(place->second).name());
        const auto progress = uploads_.offer(named, place->first, place->second);
        if (!progress)
            refuse(incident, progress.refusal());
        else
            uploadProgress(offer.transfer_id(), progress.value());
        return;
    }
    const auto& chunk = incident.body->resource_chunk();
    const auto* upload = uploads_.find(chunk.transfer_id());
    const std::string resource = upload != nullptr ? upload->offer.resource() : std::string();
    const auto progress = uploads_.chunk(chunk);
    if (progress) {
        uploadProgress(chunk.transfer_id(), progress.value());
    } else if (upload != nullptr) {
        sendResourceDone(to, chunk.transfer_id(), resource, progress.refusal());
    } else {
        refuse(incident, progress.refusal());
    }
}

/// On a thread of its own the store has written what a client has sent.
void EntityManagerCore::Machine::onResourcesWritten() {
    if (quit_) return;
    for (const auto& [upload, progress] : uploads_.written()) {
        const auto& id = upload.offer.transfer_id();
        if (progress)
            uploadProgress(id, progress.value());
        else if (holder() != nullptr)
            sendResourceDone(*holder(), id, upload.offer.resource(), progress.refusal());
    }
    settle();
}

void EntityManagerCore::Machine::uploadProgress(const std::string& transfer_id,
                                                const UploadDesk::Progress& progress) {
    if (progress.window > 0 && holder() != nullptr) {
        proto::ToClient message;
        auto& credit = *message.mutable_resource_credit();
        credit.set_transfer_id(transfer_id);
        credit.set_offset(progress.offset);
        credit.set_window(progress.window);
        tell(*holder(), kMsgResource, message);
    }
    if (!progress.complete || holder() == nullptr) return;
    const auto upload = *uploads_.find(transfer_id);
    const auto path = uploads_.finish(transfer_id);
    if (!path) {
        sendResourceDone(*holder(), transfer_id, upload.offer.resource(), path.refusal());
        return;
    }
    Question question;
    question.asker = *holder();
    question.lease = lease_.held()->number;
    question.request_id = transfer_id;
    question.service = upload.service;
    question.resource = upload.resource;
    question.service_name = upload.offer.service();
    question.resource_name = upload.offer.resource();
    question.path = path.value();
    question.sha256 = upload.offer.sha256();
    question.size = upload.offer.size();
    if (questions_.size() >= kQuestions) {
        store_.remove(question.service_name, question.resource_name);
        conclude(question, {RefusalCode::Overloaded,
                            "The robot application has too many requests to answer. Try again.",
                            {}});
        return;
    }
    const auto number = next_question_++;
    proto::EmToEi message;
    auto& ask = *message.mutable_resource();
    ask.set_request(number);
    ask.set_service(question.service_name);
    ask.set_resource(question.resource_name);
    ask.set_path(question.path);
    ask.set_size(question.size);
    question.until = clock_.now() + settings_.answer_within;
    questions_.emplace(number, std::move(question));
    back_end_.send(message);
}

void EntityManagerCore::Machine::suspendUploads(const Refusal& reason) {
    for (const auto& upload : uploads_.suspendAll())
        if (holder() != nullptr)
            sendResourceDone(*holder(), upload.offer.transfer_id(), upload.offer.resource(), reason);
}

void EntityManagerCore::Machine::sendService(int service) {
    if (holder() == nullptr || !server_up_) return;
    proto::ToClient message;
    *message.mutable_service() = profiler_.record(service);
    tell(*holder(), kMsgService, message);
}

void EntityManagerCore::Machine::sendResourceDone(const Sender& to, const std::string& transfer_id,
                                                  const std::string& resource, const Refusal& refusal) {
    proto::ToClient message;
    auto& done = *message.mutable_resource_done();
    done.set_transfer_id(transfer_id);
    done.set_resource(resource);
    if (!refusal.ok()) *done.mutable_refusal() = toProto(refusal);
    tell(to, kMsgResource, message);
}

}  // namespace axon::entity_manager
