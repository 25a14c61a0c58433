// SPDX-License-Identifier: GPL-2.0-or-later
// What the entity does with others: as the master of a run, as a slave, and as its own participant (ADR
// 0019).
#include <algorithm>
#include <chrono>
#include <set>
#include <utility>

#include "collaboration/sub_lease.hpp"
#include "common/utf8.hpp"
#include "entity_manager/machine.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

using collaboration::isFinal;

namespace {

constexpr const char* kRunsKey = "runs";
constexpr int kRunsKept = 32;
constexpr std::size_t kRunsBytes = 512 * 1024;  ///< together; above it the oldest go
constexpr std::size_t kRunBytes =
    128 * 1024;  ///< of one; of a larger one parameters and results are left out
constexpr auto kReportPeriod = std::chrono::milliseconds{5};

proto::Problem problem(std::int32_t step, const Refusal& refusal) {
    proto::Problem made;
    made.set_step(step);
    *made.mutable_refusal() = toProto(refusal);
    return made;
}

/// A run as it is told later; of a large one the values are left out.
proto::RunRecord trimmed(proto::RunRecord record) {
    if (record.ByteSizeLong() <= kRunBytes) return record;
    for (auto& step : *record.mutable_steps()) {
        step.clear_params();
        step.clear_results();
        step.clear_feedback();
    }
    return record;
}

}  // namespace

// -- the master
// ----------------------------------------------------------------------------------------------------------

void EntityManagerCore::Machine::considerRun(const Incident& incident) {
    auto& request = *incident.body->mutable_collaboration();
    const auto id = Id128::fromBytes(request.run_id());
    if (!id || id->isZero()) {
        refuse(incident, {RefusalCode::Malformed, "run_id must be 16 bytes that are not all zero.", {}});
        return;
    }
    if (const auto again = memory_.whyNotAgain(*id)) {
        refuse(incident, *again);
        return;
    }
    if (!active_.empty() || !queue_.empty()) {
        refuse(
            incident,
            {RefusalCode::WrongState, "The entity has other tasks. Wait for their end, or clear them.", {}});
        return;
    }
    auto problems = collaboration::Collaboration::problemsOf(request, uuid_, lease_.held()->root);
    if (!problems.empty()) {
        proto::RunEvent event;
        event.set_run_id(request.run_id());
        event.set_sequence(1);
        event.set_state(proto::RUN_REFUSED);
        *event.mutable_reason() = problems.front().refusal();
        for (auto& found : problems) event.add_problems()->Swap(&found);
        tellRun(incident.head->sender, event);
        return;
    }
    run_.emplace(std::move(request), uuid_, named(*holder()), random_,
                 collaboration::Pace{.watchdog = settings_.server_watchdog_busy}, clock_.now());
    if (run_->request().check_only()) {
        run_->begin(clock_.now());
    } else {
        memory_.accept(*id);
        run_noted_ = noteDispatch({.kind = JournalRecord::Kind::Dispatched,
                                   .who = named(*holder()),
                                   .task = *id,
                                   .service = run_->request().service().name()});
    }
    fire(Event::CollaborationBegun);
}

/// Before its entry is in the journal nobody hears of a run: a next life would let it begin again.
void EntityManagerCore::Machine::beginRun() {
    if (!run_noted_ || !run_noted_->ready()) return;
    const bool written = recorded(std::exchange(run_noted_, std::nullopt)->value());
    if (!written) {
        run_->abandon(
            proto::RUN_REFUSED,
            {RefusalCode::Overloaded,
             "The Entity Manager cannot write its journal, so it begins no run. Is the disk full? Make "
             "room, then ask again under a new id.",
             {}},
            clock_.now());
        return;
    }
    memory_.dispatched(*Id128::fromBytes(run_->id()));
    keepRun(run_->record(clock_.now()));
    run_->begin(clock_.now());
}

void EntityManagerCore::Machine::refuseRun(const Incident& incident, const Refusal& refusal) {
    const auto& to = incident.head->sender;
    const auto& bytes = incident.body->collaboration().run_id();
    const auto id = Id128::fromBytes(bytes);
    // A copy of the request that is being carried out: a refusal would be taken for its end.
    if (run_ && run_->id() == bytes && holder() != nullptr && holder()->id == to.id) return;
    // This is its end, so a copy that comes later must not begin.
    if (id && !memory_.whyNotAgain(*id) && lease_.check(to, incident.head->held).ok())
        memory_.ended(*id, proto::TASK_REFUSED);
    reply(to, bytes, refusal);
}

void EntityManagerCore::Machine::tellRun(const Sender& to, const proto::RunEvent& event) {
    proto::ToClient message;
    *message.mutable_run() = event;
    tell(to, kMsgRun, message);
}

void EntityManagerCore::Machine::attendRun() {
    if (!run_ || attending_) return;
    beginRun();
    attending_ = true;
    for (auto orders = run_->takeOrders(); !orders.empty(); orders = run_->takeOrders()) {
        for (auto& order : orders) {
            if (run_->isSelf(order.participant)) {
                const Sender self{uuid_, presence_.name(), Role::Operator};
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
            sendToPeer(urgent ? Lane::Signal : Lane::Data, to, kMsgCollaboration, message);
            if (message.from_master().has_end())
                bidFarewell(to, message.from_master(), run_->beatEvery(order.participant));
        }
    }
    attending_ = false;
    while (const auto event = run_->takeEvent(clock_.now()))
        if (holder() != nullptr) tellRun(*holder(), *event);
    if (run_->over()) endRun();
}

void EntityManagerCore::Machine::endRun() {
    const auto record = run_->record(clock_.now());
    const bool kept = !run_->request().check_only();
    run_.reset();
    run_noted_.reset();
    if (kept) {
        keepRun(record);
        const auto id = *Id128::fromBytes(record.run_id());
        const auto state = record.state() == proto::RUN_SUCCEEDED   ? proto::TASK_SUCCEEDED
                           : record.state() == proto::RUN_STOPPED   ? proto::TASK_STOPPED
                           : record.state() == proto::RUN_CANCELLED ? proto::TASK_CANCELLED
                           : record.state() == proto::RUN_REFUSED   ? proto::TASK_REFUSED
                                                                    : proto::TASK_FAILED;
        note({.kind = JournalRecord::Kind::TaskEnded,
              .task = id,
              .service = record.service().name(),
              .code = proto::TaskState_Name(state),
              .text = record.reason().message()});
        memory_.ended(id, state);
    }
    endPart();
    if (state_ == EntityState::BUSY) previous_ = EntityState::REG;
    if (state_ == EntityState::COLLAB || state_ == EntityState::BUSY) fire(Event::CollaborationEnded);
}

/// Pause, resume and cancel of the run as a whole; false when the id is not that of a run.
bool EntityManagerCore::Machine::controlRun(const Incident& incident) {
    const auto& id = incident.body->task_control().task_id();
    if (!run_ || run_->id() != id) return false;
    const auto now = clock_.now();
    const auto refusal = incident.event == Event::Pause    ? run_->pause(now)
                         : incident.event == Event::Resume ? run_->resume(now)
                                                           : run_->cancel(now);
    if (refusal.ok())
        reply(incident.head->sender, id, {});
    else
        refuse(incident, refusal);
    return true;
}

// -- a participant
// ----------------------------------------------------------------------------------------------------------

/// Whether the holder of this entity has given this master the right over it (ADR 0019).
Refusal EntityManagerCore::Machine::checkSubLease(const Sender& master,
                                                  const proto::FromMaster& message) const {
    if (!lease_.held()) return {RefusalCode::NotHolder, "Nobody has checked the entity out.", {}};
    const auto& lease = message.invitation().lease();
    const auto& held = *lease_.held();
    const LeaseNumber number{static_cast<std::int32_t>(lease.epoch()),
                             static_cast<std::int32_t>(lease.number())};
    if (const auto refusal = lease_.check(held.holder, number); !refusal.ok()) return refusal;
    if (lease.root().size() != 16 || lease.root() != held.root ||
        !collaboration::isSealed(lease, {message.run_id(), master.id, uuid_}, held.key.bytes()))
        return {RefusalCode::NotHolder,
                "The master " + inQuotes(master.name) +
                    " has no right over this entity from its holder: both must be checked out by the same "
                    "client.",
                named(held.holder)};
    if (pastRun(message.run_id()) != nullptr)
        return {RefusalCode::Duplicate,
                "The entity has taken part in this run before, and a run has one beginning. Make a new id.",
                {}};
    if (!stops_.allHandled() || lease.stop_generation() < stops_.required())
        return {RefusalCode::OldGeneration,
                "The run was asked for before the newest stop of the entity was known. Look at the entity, "
                "then ask again.",
                {}};
    if (latched_)
        return {RefusalCode::Latched,
                "The entity has been stopped. Rearm it first; that starts nothing by itself.",
                {}};
    if (member_) return {RefusalCode::WrongState, "The entity takes part in another run.", {}};
    if (!active_.empty() || !queue_.empty())
        return {
            RefusalCode::WrongState, "The entity has other tasks. Wait for their end, or clear them.", {}};
    return {};
}

/// All that would make a step fail, so that nothing moves before it is mended.
void EntityManagerCore::Machine::problemsOf(const proto::Invitation& invitation,
                                            proto::InvitationAnswer& answer) const {
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

void EntityManagerCore::Machine::considerInvitation(const Sender& master, const proto::FromMaster& message) {
    if (const auto refusal = checkSubLease(master, message); !refusal.ok()) {
        noteRefusal(master,
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
    answer.set_stop_generation(stops_.generation());
    answer.set_watchdog_ms(static_cast<std::uint32_t>(
        std::chrono::duration_cast<std::chrono::milliseconds>(settings_.server_watchdog_busy).count()));
    if (answer.problems_size() == 0 && !invitation.check_only()) {
        member_.emplace();
        member_->run_id = message.run_id();
        member_->master = master;
        member_->participants.assign(invitation.participants().begin(), invitation.participants().end());
        member_->heard = member_->beat_at = clock_.now();
        member_->beat_every =
            collaboration::beatPeriod(settings_.server_watchdog_busy, invitation.watchdog_ms());
        if (!isMaster(*member_)) fire(Event::CollaborationJoined);
    }
    sendToMaster(Lane::Data, master, reply);
}

void EntityManagerCore::Machine::declineInvitation(const Sender& master, const proto::FromMaster& message,
                                                   const Refusal& refusal) {
    proto::FromSlave reply;
    reply.set_run_id(message.run_id());
    *reply.mutable_answer()->add_problems() = problem(-1, refusal);
    sendToMaster(Lane::Data, master, reply);
}

bool EntityManagerCore::Machine::hearPeer(const Header& head, proto::ToEntity& message) {
    switch (message.body_case()) {
        case proto::ToEntity::kFromMaster:
            if (message.from_master().has_invitation()) return false;  // a request
            hearMaster(head.sender, message.from_master());
            return true;
        case proto::ToEntity::kFromSlave:
            if (message.from_slave().has_departure())
                std::erase_if(farewells_, [&](const Farewell& farewell) {
                    return farewell.entity == head.sender.id &&
                           farewell.message.run_id() == message.from_slave().run_id();
                });
            if (run_) run_->hear(head.sender.id, message.from_slave(), clock_.now());
            return true;
        case proto::ToEntity::kRaw: {
            const auto* from = partner(head.sender.id);
            if (from == nullptr) return false;
            if (latched_ || !stops_.allHandled()) return true;  // nothing may move it now
            proto::EmToEi raw;
            raw.mutable_raw()->mutable_data()->Swap(message.mutable_raw()->mutable_data());
            raw.mutable_raw()->set_from(from->name());
            raw.mutable_raw()->set_stop_generation(stops_.generation());
            if (!back_end_.send(raw)) ++counters_.undelivered;
            return true;
        }
        default:
            return false;
    }
}

void EntityManagerCore::Machine::hearMaster(const Sender& master, const proto::FromMaster& message) {
    if (!member_ || member_->run_id != message.run_id() || member_->master.id != master.id) {
        // It believes that this entity takes part, or asks whether its end has arrived.
        if (message.body_case() != proto::FromMaster::BODY_NOT_SET) {
            // When it left, that may have been lost on its way: the reason is what the master goes by.
            const auto* past = pastRun(message.run_id());
            const bool left = past != nullptr && past->master == master.id && !past->reason.ok();
            depart(master, message.run_id(),
                   left
                       ? past->reason
                       : Refusal{
                             RefusalCode::NotHolder, "The entity takes no part in this run (any more).", {}});
        }
        return;
    }
    member_->heard = clock_.now();
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

void EntityManagerCore::Machine::admitStep(const proto::StepOrder& order) {
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
        refusal = admit(task, 0);
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
void EntityManagerCore::Machine::controlStep(const proto::StepControl& control) {
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
    controlTask(incident);
}

void EntityManagerCore::Machine::endMembership(const proto::CollaborationEnd& end) {
    const bool master = isMaster(*member_);
    // A step of which the master knows no more would go on without anybody who answers for it.
    const bool busy = !active_.empty() || !queue_.empty();
    if (end.stop() || busy) {
        Incident incident{Event::CollaborationStopped};
        incident.cause = StopCause::Requested;
        incident.reason = {RefusalCode::Stopped,
                           end.stop() ? "The run was stopped: " + end.reason().message()
                                      : "The run has ended, and a step of it had not.",
                           {}};
        endPart();
        fire(incident);
        return;
    }
    endPart();
    if (master) return;  // COLLAB ends with the run: endRun()
    if (state_ == EntityState::BUSY) previous_ = EntityState::REG;
    fire(Event::CollaborationEnded);
}

/// A short step begins and ends within a few milliseconds: one message then, not two, and each costs the
/// master. What goes on waits for kReportPeriod; what ends or pauses does not.
void EntityManagerCore::Machine::tellStep(OpenStep& step, proto::TaskEvent& event) {
    const auto now = clock_.now();
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

void EntityManagerCore::Machine::reportStep(const OpenStep& step, const proto::TaskEvent& event) {
    proto::FromSlave message;
    message.set_run_id(member_->run_id);
    auto& report = *message.mutable_report();
    report.set_step(step.number);
    *report.mutable_event() = event;
    if (step.began) report.set_running_s(std::chrono::duration<double>(clock_.now() - *step.began).count());
    sendToMaster(Lane::Data, member_->master, message);
}

void EntityManagerCore::Machine::sendToMaster(Lane lane, const Sender& master,
                                              const proto::FromSlave& message) {
    if (master.id == uuid_) {
        if (run_)
            run_->hear(uuid_, message, clock_.now());  // what follows from it: attendRun(), with settle()
        return;
    }
    proto::ToEntity body;
    *body.mutable_from_slave() = message;
    sendToPeer(lane, master.id, kMsgCollaboration, body);
}

void EntityManagerCore::Machine::depart(const Sender& master, const std::string& run_id,
                                        const Refusal& reason) {
    proto::FromSlave message;
    message.set_run_id(run_id);
    *message.mutable_departure()->mutable_reason() = toProto(reason);
    sendToMaster(Lane::Signal, master, message);
}

/// This entity has been stopped, released, lost: it stops by another way already, and the others must.
void EntityManagerCore::Machine::leaveCollaboration(const Refusal& reason) {
    if (run_ && !run_->over()) {
        run_->abandon(collaboration::isStop(reason) ? proto::RUN_STOPPED : proto::RUN_FAILED,
                      {reason.code, presence_.name() + ": " + reason.message, {}}, clock_.now());
        attendRun();  // now: what follows may take the lease, or the server, from those who are to be told
    }
    if (!member_) return;
    if (!isMaster(*member_)) depart(member_->master, member_->run_id, reason);
    endPart(reason);
}

void EntityManagerCore::Machine::endPart(const Refusal& reason) {
    if (!member_) return;
    past_runs_.push_back({member_->run_id, member_->master.id, reason});
    if (past_runs_.size() > kPastRuns) past_runs_.pop_front();
    member_.reset();
}

const EntityManagerCore::Machine::PastRun* EntityManagerCore::Machine::pastRun(
    const std::string& run_id) const {
    const auto found = std::find_if(past_runs_.begin(), past_runs_.end(),
                                    [&](const PastRun& past) { return past.run_id == run_id; });
    return found != past_runs_.end() ? &*found : nullptr;
}

/// A master beats to those whose answers it has; before, nothing moves.
TimePoint EntityManagerCore::Machine::masterLostAt() const {
    return member_->heard +
           (member_->led ? settings_.server_watchdog_busy : collaboration::Pace{}.answer_within);
}

/// An end waits with the data before it, and a stop's may find no room. Beats, or the stop again, until it is
/// answered: a participant that has finished must not miss its master.
void EntityManagerCore::Machine::bidFarewell(const std::string& entity, const proto::FromMaster& end,
                                             Duration beat_every) {
    if (farewells_.size() == kFarewells) return;
    Farewell farewell{.entity = entity};
    const auto now = clock_.now();
    const auto watchdog = settings_.server_watchdog_busy;
    farewell.every = beat_every;
    farewell.again = now + farewell.every;
    // Who does not hear a stop misses the beats.
    farewell.until = now + (end.end().stop() ? 2 * watchdog : collaboration::Pace{}.answer_within);
    farewell.message.set_run_id(end.run_id());
    if (end.end().stop())
        farewell.message = end;
    else
        farewell.message.mutable_beat();
    farewells_.push_back(std::move(farewell));
}

void EntityManagerCore::Machine::repeatFarewells() {
    const auto now = clock_.now();
    std::erase_if(farewells_, [&](const Farewell& farewell) { return now >= farewell.until; });
    for (auto& farewell : farewells_) {
        if (now < farewell.again) continue;
        farewell.again = now + farewell.every;
        proto::ToEntity message;
        *message.mutable_from_master() = farewell.message;
        sendToPeer(Lane::Signal, farewell.entity, kMsgCollaboration, message);
    }
}

void EntityManagerCore::Machine::expireCollaboration() {
    const auto now = clock_.now();
    repeatFarewells();
    if (run_) run_->onTimer(now);
    if (!member_ || isMaster(*member_)) return;
    if (now >= masterLostAt()) {
        const auto silence = std::chrono::duration_cast<std::chrono::milliseconds>(now - member_->heard);
        Incident incident{Event::MasterLost};
        incident.cause = StopCause::ServerLost;
        incident.reason = {RefusalCode::TimedOut,
                           "The master " + inQuotes(member_->master.name) + " has been silent for " +
                               std::to_string(silence.count()) + " ms.",
                           {}};
        depart(member_->master, member_->run_id, incident.reason);
        endPart(incident.reason);
        fire(incident);
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

void EntityManagerCore::Machine::onPeerRefusal(const Header& head, const Refusal& refusal) {
    if (quit_) return;
    ++counters_.peer_refusals;
    std::erase_if(farewells_, [&](const Farewell& farewell) { return farewell.entity == head.entity; });
    if (run_) run_->lose(head.entity, refusal, clock_.now());
    settle();
}

// -- from robot to robot
// ----------------------------------------------------------------------------------------------------------

void EntityManagerCore::Machine::sendToPeer(Lane lane, const std::string& entity, const char* type,
                                            const proto::ToEntity& message) {
    if (!connected()) return;
    auto head = headFor({uuid_, presence_.name(), Role::Operator}, type);
    head.entity = entity;
    server_.sendToPeer(lane, head, message);
}

/// Another participant by UUID, by name where only one has it, or by role.
const proto::Participant* EntityManagerCore::Machine::partner(std::string_view name) const {
    if (!member_) return nullptr;
    const proto::Participant* found = nullptr;
    for (const auto& participant : member_->participants) {
        if (participant.entity() == uuid_) continue;
        if (participant.entity() == name || std::to_string(participant.role()) == name) return &participant;
        if (participant.name() != name) continue;
        if (found != nullptr) return nullptr;
        found = &participant;
    }
    return found;
}

void EntityManagerCore::Machine::refuseToApplication(const std::string& to, const Refusal& refusal) {
    if (clock_.now() < not_sent_told_ + kRawRefusalPeriod) return;
    not_sent_told_ = clock_.now();
    proto::EmToEi message;
    message.mutable_not_sent()->set_to(std::string(cutUtf8(to, 255)));
    *message.mutable_not_sent()->mutable_reason() = toProto(refusal);
    back_end_.send(message);
}

void EntityManagerCore::Machine::sendRawToPartner(proto::LinkRaw& raw) {
    const auto* to = partner(raw.to());
    if (to == nullptr || !connected()) {
        ++counters_.undelivered;
        refuseToApplication(
            raw.to(),
            !connected() ? Refusal{RefusalCode::NotConnected, "There is no session with the server.", {}}
            : !member_   ? Refusal{RefusalCode::WrongState,
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
    sendToPeer(Lane::Data, to->entity(), kMsgRaw, message);
}

// -- the record
// ----------------------------------------------------------------------------------------------------------

void EntityManagerCore::Machine::loadRuns() {
    const auto kept = storage_.load(kRunsKey);
    if (!kept || !runs_.ParseFromString(*kept)) {
        runs_.Clear();
        return;
    }
    for (auto& run : *runs_.mutable_runs()) {
        if (run.state() >= proto::RUN_SUCCEEDED) continue;
        run.set_state(proto::RUN_UNKNOWN);
        *run.mutable_reason() = toProto(Refusal{
            RefusalCode::OutcomeUnknown,
            "The Entity Manager of the master ended while it ran. The others have stopped by themselves.",
            {}});
        for (auto& step : *run.mutable_steps())
            if (step.state() != proto::TASK_UNSPECIFIED && step.state() < proto::TASK_SUCCEEDED)
                step.set_state(proto::TASK_UNKNOWN);
    }
}

/// In the place of what was kept of the same run.
void EntityManagerCore::Machine::keepRun(const proto::RunRecord& record) {
    proto::RunHistory next;
    auto& newest = *next.add_runs();
    newest = trimmed(record);
    auto bytes = newest.ByteSizeLong();
    for (auto& run : *runs_.mutable_runs()) {
        if (run.run_id() == record.run_id()) continue;
        bytes += run.ByteSizeLong();
        if (next.runs_size() == kRunsKept || bytes > kRunsBytes) break;
        next.add_runs()->Swap(&run);
    }
    runs_.Swap(&next);
    storage_.keep(kRunsKey, runs_.SerializeAsString());
}

void EntityManagerCore::Machine::tellRunHistory(const Incident& incident) {
    const auto& request = incident.body->run_history();
    proto::ToClient message;
    auto& history = *message.mutable_run_history();
    history = runs_;
    history.set_request_id(request.request_id());
    if (run_ && history.runs_size() > 0 && history.runs(0).run_id() == run_->id())
        *history.mutable_runs(0) = trimmed(run_->record(clock_.now()));
    if (request.most() > 0)
        while (static_cast<std::uint32_t>(history.runs_size()) > request.most())
            history.mutable_runs()->RemoveLast();
    tell(incident.head->sender, kMsgRun, message);
}

}  // namespace axon::entity_manager
