// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/collaboration/teamwork.hpp"

#include <algorithm>
#include <chrono>
#include <set>
#include <utility>

#include "collaboration/sub_lease.hpp"
#include "common/utf8.hpp"
#include "entity_manager/ports/core_settings.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

using collaboration::isFinal;

namespace {

constexpr std::size_t kPastRuns = 64;
constexpr auto kReportPeriod = std::chrono::milliseconds{5};

proto::Problem problem(std::int32_t step, const Refusal& refusal) {
    proto::Problem made;
    made.set_step(step);
    *made.mutable_refusal() = toProto(refusal);
    return made;
}

}  // namespace

Teamwork::Teamwork(Turn& turn, Others& others, JournalWriter& journal, Storage& storage, RandomSource& random,
                   const ServiceProfiler& profiler, TaskMemory& memory, Settings settings)
    : turn_(turn),
      others_(others),
      journal_(journal),
      random_(random),
      profiler_(profiler),
      memory_(memory),
      settings_(std::move(settings)),
      farewells_(settings_.watchdog),
      records_(storage) {}

void Teamwork::considerRun(const Incident& incident) {
    auto& request = *incident.body->mutable_collaboration();
    const auto id = Id128::fromBytes(request.run_id());
    if (!id || id->isZero()) {
        turn_.refuse(incident,
                     {RefusalCode::Malformed, "run_id must be 16 bytes that are not all zero.", {}});
        return;
    }
    if (const auto again = memory_.whyNotAgain(*id)) {
        turn_.refuse(incident, *again);
        return;
    }
    if (others_.hasTasks()) {
        turn_.refuse(
            incident,
            {RefusalCode::WrongState, "The entity has other tasks. Wait for their end, or clear them.", {}});
        return;
    }
    auto problems = collaboration::Collaboration::problemsOf(request, settings_.entity, turn_.held()->root);
    if (!problems.empty()) {
        proto::RunEvent event;
        event.set_run_id(request.run_id());
        event.set_sequence(1);
        event.set_state(proto::RUN_REFUSED);
        *event.mutable_reason() = problems.front().refusal();
        journal_.noteRefusal(incident.head->sender, incident.head->held,
                             toRefusal(problems.front().refusal()));
        for (auto& found : problems) event.add_problems()->Swap(&found);
        tellRun(incident.head->sender, event);
        return;
    }
    run_.emplace(std::move(request), settings_.entity, named(*turn_.holder()), random_,
                 collaboration::Pace{.watchdog = settings_.watchdog}, turn_.now());
    if (run_->request().check_only()) {
        run_->begin(turn_.now());
    } else {
        memory_.accept(*id);
        run_noted_ = journal_.noteDispatch({.kind = JournalRecord::Kind::Dispatched,
                                            .who = named(*turn_.holder()),
                                            .client = turn_.holder()->id,
                                            .task = *id,
                                            .service = run_->request().service().name()});
    }
    turn_.fire(Event::CollaborationBegun);
}

/// Before its entry is in the journal nobody hears of a run: a next life would let it begin again.
void Teamwork::beginRun() {
    if (!run_noted_ || !run_noted_->ready()) return;
    const bool written = journal_.recorded(std::exchange(run_noted_, std::nullopt)->value());
    if (!written) {
        run_->abandon(
            proto::RUN_REFUSED,
            {RefusalCode::Overloaded,
             "The Entity Manager cannot write its journal, so it begins no run. Is the disk full? Make "
             "room, then ask again under a new id.",
             {}},
            turn_.now());
        return;
    }
    memory_.dispatched(*Id128::fromBytes(run_->id()));
    records_.keep(run_->record(turn_.now()));
    run_->begin(turn_.now());
}

void Teamwork::refuseRun(const Incident& incident, const Refusal& refusal) {
    const auto& to = incident.head->sender;
    const auto& bytes = incident.body->collaboration().run_id();
    const auto id = Id128::fromBytes(bytes);
    // A copy of the request that is being carried out: a refusal would be taken for its end.
    if (run_ && run_->id() == bytes && turn_.holder() != nullptr && turn_.holder()->id == to.id) return;
    // This is its end, so a copy that comes later must not begin.
    if (id && !memory_.whyNotAgain(*id) && turn_.checkLease(to, incident.head->held).ok())
        memory_.ended(*id, proto::TASK_REFUSED);
    turn_.reply(to, bytes, refusal);
}

void Teamwork::tellRun(const Sender& to, const proto::RunEvent& event) {
    proto::ToClient message;
    *message.mutable_run() = event;
    turn_.tell(to, kMsgRun, message);
}

void Teamwork::settle() {
    if (!run_ || settling_) return;
    beginRun();
    settling_ = true;
    for (auto orders = run_->takeOrders(); !orders.empty(); orders = run_->takeOrders()) {
        for (auto& order : orders) {
            if (run_->isSelf(order.participant)) {
                const Sender self{settings_.entity, others_.self().name, Role::Operator};
                if (order.message.has_invitation())
                    considerInvitation(self, order.message);
                else
                    hearMaster(self, order.message);
                continue;
            }
            proto::ToEntity message;
            message.mutable_from_master()->Swap(&order.message);
            const bool urgent = message.from_master().has_beat() ||
                                (message.from_master().has_end() && message.from_master().end().stop());
            const auto& to = run_->participant(order.participant).entity();
            others_.tellPeer(urgent ? Lane::Signal : Lane::Data, to, kMsgCollaboration, message);
            if (message.from_master().has_end())
                farewells_.sent(to, message.from_master(), run_->beatEvery(order.participant), turn_.now());
        }
    }
    settling_ = false;
    while (const auto event = run_->takeEvent(turn_.now()))
        if (turn_.holder() != nullptr) tellRun(*turn_.holder(), *event);
    if (run_->over()) endRun();
}

void Teamwork::endRun() {
    const auto record = run_->record(turn_.now());
    const bool kept = !run_->request().check_only();
    run_.reset();
    run_noted_.reset();
    if (kept) {
        records_.keep(record);
        const auto id = *Id128::fromBytes(record.run_id());
        const auto state = record.state() == proto::RUN_SUCCEEDED   ? proto::TASK_SUCCEEDED
                           : record.state() == proto::RUN_STOPPED   ? proto::TASK_STOPPED
                           : record.state() == proto::RUN_CANCELLED ? proto::TASK_CANCELLED
                           : record.state() == proto::RUN_REFUSED   ? proto::TASK_REFUSED
                                                                    : proto::TASK_FAILED;
        journal_.note({.kind = JournalRecord::Kind::TaskEnded,
                       .task = id,
                       .service = record.service().name(),
                       .code = proto::TaskState_Name(state),
                       .text = record.reason().message()});
        memory_.ended(id, state);
    }
    endPart();
    const auto state = turn_.state();
    if (state == EntityState::COLLAB || state == EntityState::BUSY) turn_.fire(Event::CollaborationEnded);
}

/// Pause, resume and cancel of the run as a whole; false when the id is not that of a run.
bool Teamwork::control(const Incident& incident) {
    const auto& id = incident.body->task_control().task_id();
    if (!run_ || run_->id() != id) return false;
    const auto now = turn_.now();
    const auto refusal = incident.event == Event::Pause    ? run_->pause(now)
                         : incident.event == Event::Resume ? run_->resume(now)
                                                           : run_->cancel(now);
    if (refusal.ok()) {
        journal_.mentionControl(incident.head->sender, id, toString(incident.event));
        turn_.reply(incident.head->sender, id, {});
    } else {
        turn_.refuse(incident, refusal);
    }
    return true;
}

/// Whether the holder of this entity has given this master the right over it (ADR 0019).
Refusal Teamwork::checkSubLease(const Sender& master, const proto::FromMaster& message) const {
    if (turn_.held() == nullptr) return {RefusalCode::NotHolder, "Nobody has checked the entity out.", {}};
    const auto& lease = message.invitation().lease();
    const auto& held = *turn_.held();
    const LeaseNumber number{static_cast<std::int32_t>(lease.epoch()),
                             static_cast<std::int32_t>(lease.number())};
    if (const auto refusal = turn_.checkLease(held.holder, number); !refusal.ok()) return refusal;
    if (lease.root().size() != 16 || lease.root() != held.root ||
        !collaboration::isSealed(lease, {message.run_id(), master.id, settings_.entity}, held.key.bytes()))
        return {RefusalCode::NotHolder,
                "The master " + inQuotes(master.name) +
                    " has no right over this entity from its holder: both must be checked out by the same "
                    "client.",
                named(held.holder)};
    if (pastRun(message.run_id()) != nullptr)
        return {RefusalCode::Duplicate,
                "The entity has taken part in this run before, and a run has one beginning. Make a new id.",
                {}};
    if (!turn_.stops().all_handled || lease.stop_generation() < turn_.stops().required)
        return {RefusalCode::OldGeneration,
                "The run was asked for before the newest stop of the entity was known. Look at the entity, "
                "then ask again.",
                {}};
    if (turn_.latched())
        return {RefusalCode::Latched,
                "The entity has been stopped. Rearm it first; that starts nothing by itself.",
                {}};
    if (member_) return {RefusalCode::WrongState, "The entity takes part in another run.", {}};
    if (others_.hasTasks())
        return {
            RefusalCode::WrongState, "The entity has other tasks. Wait for their end, or clear them.", {}};
    return {};
}

/// All that would make a step fail, so that nothing moves before it is fixed.
void Teamwork::problemsOf(const proto::Invitation& invitation, proto::InvitationAnswer& answer) const {
    int more = 0;
    const auto add = [&](const proto::Problem& found) {
        if (answer.problems_size() < collaboration::kProblemsMax)
            *answer.add_problems() = found;
        else
            ++more;
    };
    std::set<std::int32_t> blocked;  // one word for each is enough
    for (const auto& step : invitation.steps()) {
        const std::vector<std::string> later(step.later().begin(), step.later().end());
        const std::vector<std::string> wanted(step.wanted().begin(), step.wanted().end());
        for (const auto& refusal :
             profiler_.problems(step.task().service(), step.task().params(), later, wanted))
            add(problem(step.step(), refusal));
        const auto service = profiler_.find(step.task().service());
        if (!service) continue;
        if (profiler_.record(service.value()).is_pausable()) answer.add_pausable(step.step());
        for (const auto& other : invitation.steps()) {
            if (other.step() <= step.step() || other.preced() != step.preced() ||
                blocked.contains(other.step()))
                continue;
            const auto beside = profiler_.find(other.task().service());
            if (!beside) continue;
            const auto& one = profiler_.record(service.value());
            const auto& two = profiler_.record(beside.value());
            if (!one.is_blocking() && !two.is_blocking() &&
                !profiler_.shareParts(service.value(), beside.value()))
                continue;
            blocked.insert(other.step());
            add(problem(other.step(),
                        {RefusalCode::Blocked,
                         "It is to run at the same time as " + inQuotes(one.name()) + " (both have preced " +
                             std::to_string(step.preced()) +
                             "), and one of the two lets nothing run beside it. Give them different "
                             "preceds.",
                         {}}));
        }
    }
    if (more > 0) *answer.add_problems() = collaboration::andMore(more);
}

void Teamwork::considerInvitation(const Sender& master, const proto::FromMaster& message) {
    if (const auto refusal = checkSubLease(master, message); !refusal.ok()) {
        journal_.noteRefusal(master,
                             {static_cast<std::int32_t>(message.invitation().lease().epoch()),
                              static_cast<std::int32_t>(message.invitation().lease().number())},
                             refusal);
        declineInvitation(master, message, refusal);
        return;
    }
    const auto& invitation = message.invitation();
    proto::FromSlave reply;
    reply.set_run_id(message.run_id());
    auto& answer = *reply.mutable_answer();
    problemsOf(invitation, answer);
    answer.set_stop_generation(turn_.stops().generation);
    answer.set_watchdog_ms(static_cast<std::uint32_t>(
        std::chrono::duration_cast<std::chrono::milliseconds>(settings_.watchdog).count()));
    if (answer.problems_size() == 0 && !invitation.check_only()) {
        member_.emplace();
        member_->run_id = message.run_id();
        member_->master = master;
        member_->participants.assign(invitation.participants().begin(), invitation.participants().end());
        member_->heard = member_->beat_at = turn_.now();
        member_->beat_every = collaboration::beatPeriod(settings_.watchdog, invitation.watchdog_ms());
        if (!isMaster(*member_)) turn_.fire(Event::CollaborationJoined);
    }
    sendToMaster(Lane::Data, master, reply);
}

void Teamwork::declineInvitation(const Sender& master, const proto::FromMaster& message,
                                 const Refusal& refusal) {
    proto::FromSlave reply;
    reply.set_run_id(message.run_id());
    *reply.mutable_answer()->add_problems() = problem(-1, refusal);
    sendToMaster(Lane::Data, master, reply);
}

bool Teamwork::hear(const Header& head, proto::ToEntity& message) {
    switch (message.body_case()) {
        case proto::ToEntity::kFromMaster:
            if (message.from_master().has_invitation()) return false;  // a request
            hearMaster(head.sender, message.from_master());
            return true;
        case proto::ToEntity::kFromSlave:
            if (message.from_slave().has_departure())
                farewells_.answered(head.sender.id, message.from_slave().run_id());
            if (run_) run_->hear(head.sender.id, message.from_slave(), turn_.now());
            return true;
        case proto::ToEntity::kRaw: {
            const auto* from = partner(head.sender.id);
            if (from == nullptr) return false;
            if (turn_.latched() || !turn_.stops().all_handled) return true;  // nothing may move it now
            proto::EmToEi raw;
            raw.mutable_raw()->mutable_data()->Swap(message.mutable_raw()->mutable_data());
            raw.mutable_raw()->set_from(from->name());
            raw.mutable_raw()->set_stop_generation(turn_.stops().generation);
            if (!turn_.toApplication(raw)) ++turn_.count().undelivered;
            return true;
        }
        default:
            return false;
    }
}

void Teamwork::hearMaster(const Sender& master, const proto::FromMaster& message) {
    if (!member_ || member_->run_id != message.run_id() || member_->master.id != master.id) {
        // It believes that this entity takes part, or asks whether its end has arrived.
        if (message.body_case() != proto::FromMaster::BODY_NOT_SET) {
            // When it left, that may have been lost on its way: the reason is what the master goes by.
            const auto* past = pastRun(message.run_id());
            const bool left = past != nullptr && past->master == master.id && !past->reason.ok();
            depart(master, message.run_id(),
                   left ? past->reason
                        : Refusal{RefusalCode::NotHolder,
                                  "The entity does not take part in this run, or no longer does.",
                                  {}});
        }
        return;
    }
    member_->heard = turn_.now();
    member_->led = true;
    switch (message.body_case()) {
        case proto::FromMaster::kOrder:
            admitStep(message.order());
            break;
        case proto::FromMaster::kControl:
            controlStep(message.control());
            break;
        case proto::FromMaster::kEnd:
            endMembership(message.end());
            break;
        case proto::FromMaster::kInvitation:
        case proto::FromMaster::kBeat:
        case proto::FromMaster::BODY_NOT_SET:
            break;
    }
}

void Teamwork::admitStep(const proto::StepOrder& order) {
    auto task = order.task();
    const auto id = Id128::fromBytes(task.task_id());
    Refusal refusal;
    const std::vector<std::string> told(order.later().begin(), order.later().end());
    if (auto typed = profiler_.typed(task.service(), task.params(), told); !typed)
        refusal = typed.refusal();
    else
        task.mutable_params()->Swap(&typed.value());
    const OpenStep step{.number = order.step()};
    if (refusal.ok() && id && member_->steps.emplace(*id, step).second) {
        refusal = others_.admitStep(task);
        // Its end, if it has come already, has been told.
        if (refusal.ok()) return;
        if (member_) member_->steps.erase(*id);
    }
    if (refusal.ok()) refusal = {RefusalCode::Malformed, "task_id must be 16 bytes, new for each step.", {}};
    proto::TaskEvent event;
    event.set_task_id(task.task_id());
    event.set_service(task.service());
    event.set_state(proto::TASK_REFUSED);
    event.set_progress(-1);
    *event.mutable_reason() = toProto(refusal);
    reportStep(step, event);
}

/// As the client's own pause, resume or cancel; what cannot be done now the master sees from the reports.
void Teamwork::controlStep(const proto::StepControl& control) {
    const auto step = std::find_if(member_->steps.begin(), member_->steps.end(),
                                   [&](const auto& known) { return known.second.number == control.step(); });
    if (step == member_->steps.end()) return;
    proto::ToEntity body;
    body.mutable_task_control()->set_task_id(step->first.bytes());
    body.mutable_task_control()->set_action(control.action());
    const Header nobody;  // so that the answer goes nowhere
    Incident incident{control.action() == proto::PAUSE    ? Event::Pause
                      : control.action() == proto::RESUME ? Event::Resume
                                                          : Event::Cancel,
                      &nobody, &body};
    others_.controlTask(incident);
}

void Teamwork::endMembership(const proto::CollaborationEnd& end) {
    const bool master = isMaster(*member_);
    // A step of which the master knows no more would go on without anybody who answers for it.
    const bool busy = others_.hasTasks();
    if (end.stop() || busy) {
        Incident incident{Event::CollaborationStopped};
        incident.cause = StopCause::Requested;
        incident.reason = {RefusalCode::Stopped,
                           end.stop() ? "The run was stopped: " + end.reason().message()
                                      : "The run has ended, and a step of it had not.",
                           {}};
        endPart();
        turn_.fire(incident);
        return;
    }
    endPart();
    if (master) return;  // COLLAB ends with the run: endRun()
    turn_.fire(Event::CollaborationEnded);
}

bool Teamwork::tellStep(proto::TaskEvent& event) {
    if (!member_) return false;
    const auto step = member_->steps.find(*Id128::fromBytes(event.task_id()));
    if (step == member_->steps.end()) return false;
    if (!isFinal(event.state())) {
        holdOrTell(step->second, event);
        return true;
    }
    auto last = std::move(step->second);
    member_->steps.erase(step);  // before it is told: the master's own next order may come of it
    holdOrTell(last, event);
    return true;
}

/// A short step begins and ends within a few milliseconds: one message then, not two, and each costs the
/// master. What goes on waits for kReportPeriod; what ends or pauses does not.
void Teamwork::holdOrTell(OpenStep& step, proto::TaskEvent& event) {
    const auto now = turn_.now();
    if (event.state() == proto::TASK_RUNNING && !step.began) step.began = now;
    if (step.held) {
        // Each event says all that is known, or nothing, of these.
        if (event.progress() < 0) event.set_progress(step.held->progress());
        if (event.feedback().empty()) event.set_feedback(step.held->feedback());
        if (event.results().empty()) event.mutable_results()->Swap(step.held->mutable_results());
        step.held.reset();
    } else {
        step.due = now + kReportPeriod;
    }
    const bool goes_on = !isFinal(event.state()) && event.state() != proto::TASK_PAUSED;
    if (goes_on && !isMaster(*member_) && now < step.due) {
        step.held.emplace().Swap(&event);
        return;
    }
    reportStep(step, event);
}

void Teamwork::reportStep(const OpenStep& step, const proto::TaskEvent& event) {
    proto::FromSlave message;
    message.set_run_id(member_->run_id);
    auto& report = *message.mutable_report();
    report.set_step(step.number);
    *report.mutable_event() = event;
    if (step.began) report.set_running_s(std::chrono::duration<double>(turn_.now() - *step.began).count());
    sendToMaster(Lane::Data, member_->master, message);
}

void Teamwork::sendToMaster(Lane lane, const Sender& master, const proto::FromSlave& message) {
    if (master.id == settings_.entity) {
        if (run_) run_->hear(settings_.entity, message, turn_.now());  // what follows from it: settle()
        return;
    }
    proto::ToEntity body;
    *body.mutable_from_slave() = message;
    others_.tellPeer(lane, master.id, kMsgCollaboration, body);
}

void Teamwork::depart(const Sender& master, const std::string& run_id, const Refusal& reason) {
    proto::FromSlave message;
    message.set_run_id(run_id);
    *message.mutable_departure()->mutable_reason() = toProto(reason);
    sendToMaster(Lane::Signal, master, message);
}

/// This entity has been stopped, released, lost: it stops by another way already, and the others must.
void Teamwork::leave(const Refusal& reason) {
    if (run_ && !run_->over()) {
        run_->abandon(collaboration::isStop(reason) ? proto::RUN_STOPPED : proto::RUN_FAILED,
                      {reason.code, others_.self().name + ": " + reason.message, {}}, turn_.now());
        settle();  // now: what follows may take the lease, or the server, from those who are to be told
    }
    if (!member_) return;
    if (!isMaster(*member_)) depart(member_->master, member_->run_id, reason);
    endPart(reason);
}

void Teamwork::endPart(const Refusal& reason) {
    if (!member_) return;
    past_runs_.push_back({member_->run_id, member_->master.id, reason});
    if (past_runs_.size() > kPastRuns) past_runs_.pop_front();
    member_.reset();
}

const Teamwork::PastRun* Teamwork::pastRun(const std::string& run_id) const {
    const auto found = std::find_if(past_runs_.begin(), past_runs_.end(),
                                    [&](const PastRun& past) { return past.run_id == run_id; });
    return found != past_runs_.end() ? &*found : nullptr;
}

/// A master beats to those whose answers it has; before, nothing moves.
TimePoint Teamwork::masterLostAt() const {
    return member_->heard + (member_->led ? settings_.watchdog : collaboration::Pace{}.answer_within);
}

void Teamwork::onTimer() {
    const auto now = turn_.now();
    for (auto& [entity, said] : farewells_.takeDue(now)) {
        proto::ToEntity message;
        message.mutable_from_master()->Swap(&said);
        others_.tellPeer(Lane::Signal, entity, kMsgCollaboration, message);
    }
    if (run_) run_->onTimer(now);
    if (!member_ || isMaster(*member_)) return;
    if (now >= masterLostAt()) {
        masterLost();
        return;
    }
    for (auto& [id, step] : member_->steps) {
        if (!step.held || now < step.due) continue;
        reportStep(step, *step.held);
        step.held.reset();
    }
    if (now < member_->beat_at) return;
    member_->beat_at = now + member_->beat_every;
    proto::FromSlave message;
    message.set_run_id(member_->run_id);
    message.mutable_beat()->set_sequence(++member_->beat);
    sendToMaster(Lane::Signal, member_->master, message);
}

void Teamwork::masterLost() {
    const auto silence = std::chrono::duration_cast<std::chrono::milliseconds>(turn_.now() - member_->heard);
    Incident incident{Event::MasterLost};
    incident.cause = StopCause::ServerLost;
    incident.reason = {RefusalCode::TimedOut,
                       "The master " + inQuotes(member_->master.name) + " has been silent for " +
                           std::to_string(silence.count()) + " ms.",
                       {}};
    depart(member_->master, member_->run_id, incident.reason);
    endPart(incident.reason);
    turn_.fire(incident);
}

TimePoint Teamwork::nextDeadline() const {
    auto next = farewells_.nextDeadline();
    if (run_) next = std::min(next, run_->nextDeadline());
    if (member_ && !isMaster(*member_)) {
        next = std::min({next, member_->beat_at, masterLostAt()});
        for (const auto& [id, step] : member_->steps)
            if (step.held) next = std::min(next, step.due);
    }
    return next;
}

void Teamwork::unreachable(const std::string& entity, const Refusal& refusal) {
    farewells_.unreachable(entity);
    if (run_) run_->lose(entity, refusal, turn_.now());
}

/// Another participant by UUID, by name where only one has it, or by role.
const proto::Participant* Teamwork::partner(std::string_view name) const {
    if (!member_) return nullptr;
    const proto::Participant* found = nullptr;
    for (const auto& participant : member_->participants) {
        if (participant.entity() == settings_.entity) continue;
        if (participant.entity() == name || std::to_string(participant.role()) == name) return &participant;
        if (participant.name() != name) continue;
        if (found != nullptr) return nullptr;
        found = &participant;
    }
    return found;
}

void Teamwork::refuseToApplication(const std::string& to, const Refusal& refusal) {
    if (turn_.now() < not_sent_told_ + kRawRefusalPeriod) return;
    not_sent_told_ = turn_.now();
    proto::EmToEi message;
    message.mutable_not_sent()->set_to(std::string(cutUtf8(to, 255)));
    *message.mutable_not_sent()->mutable_reason() = toProto(refusal);
    turn_.toApplication(message);
}

void Teamwork::sendRaw(proto::LinkRaw& raw) {
    const auto* to = partner(raw.to());
    if (to == nullptr || !turn_.connected()) {
        ++turn_.count().undelivered;
        refuseToApplication(
            raw.to(),
            !turn_.connected()
                ? Refusal{RefusalCode::NotConnected, "There is no session with the server.", {}}
            : !member_ ? Refusal{RefusalCode::WrongState,
                                 "Robots talk to each other within a run of a global service, and this one "
                                 "takes part in none. Send it from a task that is a step of a run.",
                                 {}}
                       : Refusal{RefusalCode::UnknownEntity,
                                 "No other participant of this run is called so, by name (of which there "
                                 "may be one only), UUID or role.",
                                 {}});
        return;
    }
    proto::ToEntity message;
    message.mutable_raw()->mutable_data()->Swap(raw.mutable_data());
    others_.tellPeer(Lane::Data, to->entity(), kMsgRaw, message);
}

void Teamwork::tellHistory(const Incident& incident) {
    const auto& request = incident.body->run_history();
    const auto present = run_ ? std::optional(run_->record(turn_.now())) : std::nullopt;
    proto::ToClient message;
    auto& history = *message.mutable_run_history();
    history = records_.history(present ? &*present : nullptr, request.most());
    history.set_request_id(request.request_id());
    turn_.tell(incident.head->sender, kMsgRun, message);
}

}  // namespace axon::entity_manager
