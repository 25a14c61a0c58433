// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/entity_manager_core.hpp"

#include <algorithm>
#include <utility>

#include "common/planted_bug.hpp"
#include "entity_manager/core/kept_identity.hpp"

namespace axon::entity_manager {

EntityManagerCore::EntityManagerCore(EntityManagerCoreSettings settings, const Clock& clock,
                                     RandomSource& random, BackEndPort& back_end, ServerPort& server,
                                     Storage& storage, ResourceStore& resources,
                                     StopGenerations& stop_generations, Journal* journal)
    : settings_(std::move(settings)),
      clock_(clock),
      back_end_(back_end),
      server_(server),
      parts_lost_(partsAreLost(storage)),
      uuid_(loadUuid(storage, random, settings_.uuid)),
      latch_(storage, parts_lost_),
      journal_(*this, journal),
      readiness_(settings_.application),
      outgoing_(*this, server, uuid_),
      presence_(
          *this, server,
          {uuid_, settings_.application, settings_.server_watchdog_busy, settings_.server_watchdog_idle}),
      ownership_(*this, *this, journal_, storage, random, profiler_,
                 {settings_.lease_grace, settings_.resource_bytes_max}),
      stops_(*this, storage, stop_generations, back_end),
      stop_orders_(*this, stops_, journal_),
      tasks_(*this, *this, journal_, back_end, resources, stop_generations, random, profiler_, memory_,
             {settings_.task_queue_bound, settings_.answer_within, settings_.lease_grace}),
      profiles_(*this, *this, readiness_, resources, profiler_,
                {uuid_, settings_.application, settings_.profiles_within}),
      teamwork_(*this, *this, journal_, storage, random, profiler_, memory_,
                {uuid_, settings_.server_watchdog_busy}),
      inputs_(*this, *this, storage, resources, profiler_,
              {settings_.answer_within, settings_.resource_bytes_max, settings_.resource_window}),
      status_(*this, *this, readiness_, memory_, uuid_) {
    if (parts_lost_) {
        warning_ =
            "parts of the state folder are missing (uuid, lease or stop_generation), so the robot comes up "
            "latched; fix: look whether all commands for it are new, then rearm it";
    }
    keepState();  // the latch says it now, and nobody holds it
    journal_.begin(memory_, ownership_.lease().last(), "entity " + uuid_);
    for (const auto& finding : inputs_.findings()) {
        if (!parts_lost_) warning_ = finding.message();
    }
}

void EntityManagerCore::fire(Incident& incident) {
    const auto* row = findRow(state_, incident.event);
    if (row == nullptr) {
        refuse(incident, refusalFor(state_, incident.event, whyNotReady()));
        return;
    }
    const auto before = state_;
    if (row->next.kind == Next::Kind::To) state_ = row->next.state;
    if (row->next.kind == Next::Kind::Previous) state_ = previous_;
    if (state_ == EntityState::BUSY && before != EntityState::BUSY) previous_ = before;
    if (state_ != before) readiness_.stateIs(state_);
    for (const auto action : row->actions) perform(action, incident);
}

/// A request: the row, then what it must prove, then the row's actions.
void EntityManagerCore::process(Event event, Who who, const Header& head, proto::ToEntity* body) {
    Incident incident{event, &head, body};
    if (head.sender.id.empty()) {
        ++counters_.anonymous;  // an answer without a recipient would go to everybody
        return;
    }
    if (findRow(state_, event) == nullptr) {
        // Free, but the sender may have held it: that is the reason it can act upon.
        const bool was_held =
            state_ == EntityState::IDLE && (who == Who::Holder || who == Who::HolderOrAdmin);
        refuse(incident,
               was_held ? checkLease(head.sender, head.held) : refusalFor(state_, event, whyNotReady()));
        return;
    }
    if (const auto refusal = guard(event, who, head); !refusal.ok()) {
        refuse(incident, refusal);
        return;
    }
    StopOrders::giveReason(incident);
    fire(incident);
}

/// OK, or why a request that is the holder's is not carried out for this sender.
Refusal EntityManagerCore::whyNotHolder(Who who, const Header& head) const {
    const bool must_hold =
        who == Who::Holder || (who == Who::HolderOrAdmin && head.sender.role != Role::Admin);
    return must_hold && !AXON_PLANTED(StrangersObeyed) ? checkLease(head.sender, head.held) : Refusal{};
}

bool EntityManagerCore::latchForbids(Event event) const {
    return needsOf(event).not_latched && latched() && !AXON_PLANTED(LatchUnchecked);
}

Refusal EntityManagerCore::guard(Event event, Who who, const Header& head) const {
    if (who == Who::Operator && head.sender.role == Role::Observer)
        return {RefusalCode::PermissionDenied,
                "Observers may watch and stop, but not check out. Log in as an operator.",
                {}};
    if (auto refusal = whyNotHolder(who, head); !refusal.ok()) return refusal;
    // An invitation shows a seal of its own (Teamwork::considerInvitation).
    if (who == Who::Nobody && event != Event::CollaborationRequest)
        return {RefusalCode::PermissionDenied, "No client may ask an entity for this.", {}};
    if (needsOf(event).stop_generation) {
        if (auto refusal = stops_.whyNot(head.stop_generation); !refusal.ok()) return refusal;
    }
    if (latchForbids(event))
        return {RefusalCode::Latched,
                "The entity has been stopped. Rearm it first; that starts nothing by itself.",
                {}};
    return {};
}

void EntityManagerCore::perform(Action action, Incident& incident) {
    switch (action) {
#define AXON_ACTION(name, call) \
    case Action::name:          \
        call;                   \
        break;
#include "entity_manager/core/turn/actions.def"
#undef AXON_ACTION
    }
}

void EntityManagerCore::latch(const Incident& incident) {
    if (mustLatch(incident, holder())) latch_.set();
}

void EntityManagerCore::unlatch(const Incident& incident) {
    latch_.release();
    stops_.rearmed();
    journal_.note({.kind = JournalRecord::Kind::Rearmed,
                   .who = named(incident.head->sender),
                   .client = incident.head->sender.id});
    reply(incident.head->sender, incident.body->rearm().request_id(), {});
}

void EntityManagerCore::sendGrant(const Incident& incident) {
    ownership_.sendGrant(incident.phase);
    streams_.holderBegan();
}

void EntityManagerCore::noteWatch(const Incident& incident) {
    if (const auto taken = streams_.watch(incident.head->sender.id, incident.body->watch()); !taken)
        refuse(incident, taken.refusal());
}

/// After each event: what follows from the state as a whole.
void EntityManagerCore::settle() {
    stops_.settle();
    teamwork_.settle();
    ownership_.passOn();
    tasks_.dispatchNext();
    tasks_.settle();
    presence_.setBusy(state_ == EntityState::BUSY);
    tellStatus();
    keepState();
}

void EntityManagerCore::start() {
    if (!quit_) server_.wantConnection(true);
}

void EntityManagerCore::onApplicationSought(const std::string& finding) {
    if (quit_ || link_up_) return;
    readiness_.sought(finding);
    tellStatus();
}

void EntityManagerCore::onLinkUp() {
    if (quit_) return;
    if (link_up_) onLinkDown("the robot application has connected again", LinkEnd::Closed);
    link_up_ = true;
    readiness_.sought({});
    stops_.linkUp();
    profiles_.linkUp();
    streams_.linkUp();
    tasks_.linkChanged();
    fire(Event::LinkUp);
    tasks_.linkIsNew();
    settle();
}

void EntityManagerCore::onLinkDown(const std::string& reason, LinkEnd end) {
    if (quit_) return;
    stops_.linkDown(reason, end);
    link_up_ = false;
    readiness_.sought({});
    profiles_.linkDown();
    readiness_.notReady("the link to the robot application is down: " + reason);
    Incident incident{end == LinkEnd::GoodBye ? Event::LinkEnded : Event::LinkDown};
    incident.cause = StopCause::LinkLost;
    incident.reason = {RefusalCode::Unavailable, "The link to the robot application was lost: " + reason, {}};
    tasks_.linkChanged();
    fire(incident);
    settle();
}

bool EntityManagerCore::hear(proto::EiToEm& message) {
    if (quit_ || !link_up_) {
        ++counters_.unexpected;
        return true;
    }
    if (AXON_PLANTED(WatchdogFedByTheApplication)) presence_.heard();
    switch (message.body_case()) {
#define AXON_REPORT(name, call) \
    case proto::EiToEm::name:   \
        call;                   \
        break;
#include "entity_manager/core/turn/reports.def"
#undef AXON_REPORT
    }
    if (message.has_sample() || message.has_raw()) return false;  // passed on, or counted as undelivered
    settle();
    return true;
}

void EntityManagerCore::profilesAreGood(const proto::BasicProfile& basic) {
    presence_.profileIs(basic);
    auto amiss = inputs_.restore();
    for (const auto& finding : profiler_.findings()) amiss += (amiss.empty() ? "" : "; ") + finding.message();
    if (!amiss.empty()) warning_ = std::move(amiss);
    inputs_.tellConfiguration();
    streams_.tellPresent();
    fire(Event::ProfilesGood);
}

/// On a thread of its own a store has done what it was asked for. What waits in the queue for it: settle().
void EntityManagerCore::onStored() {
    if (quit_) return;
    profiles_.onStored();
    inputs_.onStored();
    settle();
}

void EntityManagerCore::onServerUp() {
    if (quit_) return;
    presence_.sessionBegan();
    settle();
}

void EntityManagerCore::onServerDown(const std::string& reason) {
    if (quit_ || !connected()) return;
    presence_.sessionEnded(reason);
    settle();
}

void EntityManagerCore::onStopSignal(const Header& head, StopCause cause, std::uint32_t generation) {
    if (quit_) return;
    Incident incident{Event::Stop, &head};
    incident.cause = cause;
    incident.generation = generation;
    incident.reason = {
        RefusalCode::Stopped, "Stopped by " + named(head.sender) + " (" + toString(cause) + ").", {}};
    stop_orders_.arrived(incident);
    fire(incident);
    settle();
}

/// Neither a row of the table nor an event after which anything is due.
void EntityManagerCore::onDrill(const Header& head, std::uint32_t number) {
    if (!quit_) stops_.drill(head, number);
}

void EntityManagerCore::onSignal(Event event, const Header& head) {
    if (quit_ || passed_signals_.seen(head)) return;
    process(event, rightOfSignal(event == Event::Reset ? kResetOperation : kClearOperation).who, head,
            nullptr);
    settle();
}

void EntityManagerCore::onStopRepeated(const Header& head, StopCause cause, std::uint32_t generation) {
    if (quit_) return;
    stops_.repeated(head, cause, generation, tasks_.anyRuns());
}

void EntityManagerCore::onClientUpdate(const Header& head, ClientChange change) {
    if (quit_) return;
    const bool lost = change == ClientChange::Lost;
    Incident incident{lost ? Event::ClientLost : Event::ClientEnded, &head};
    incident.cause = lost ? StopCause::ClientLost : StopCause::Released;
    incident.reason = {lost ? RefusalCode::ClientLost : RefusalCode::Stopped,
                       named(head.sender) + (lost ? " was lost." : " has left."),
                       {}};
    streams_.forget(head.sender.id);
    if (holder() != nullptr && holder()->id != head.sender.id) {
        // Of a client that is not the holder, or no longer is, only what it waits for is left to end.
        ownership_.dismissWaiting(incident);
    } else if (lost && holder() != nullptr) {
        // Of tasks that go on without it the loss is known.
        if (!orphaned() || !tasks_.survivesClientLoss()) loseHolder(incident);
    } else {
        fire(incident);
    }
    settle();
}

void EntityManagerCore::loseHolder(Incident& lost) {
    lost.event = tasks_.survivesClientLoss() ? Event::ClientSpared : Event::ClientLost;
    fire(lost);
}

void EntityManagerCore::granted(Incident& granted) {
    latch_.granted();  // before anybody is told
    const bool resumed = granted.event == Event::LeaseResumed;
    if (resumed) tasks_.attend();
    fire(granted);
    if (resumed)
        tasks_.tellFinals(ownership_.lostAt());
    else if (tasks_.applicationBusy())
        fire(Event::ApplicationBusy);
}

bool EntityManagerCore::onClientMsg(const Header& head, std::string_view bytes) {
    if (quit_) return true;
    const auto request = reader_.read(head, bytes, teamwork_.isPartner(head.sender.id));
    if (!request) return true;
    if (teamwork_.hear(head, *request->body)) {
        settle();
        return true;
    }
    const auto event = request->event;
    if (event == Event::Quit) {
        reader_.refuseOther(head, *request);
        return true;
    }
    // What is over must not win because its timer is late.
    if (event == Event::CheckOut || event == Event::HandOver) ownership_.onTimer();
    const auto refused = counters_.raw_refused;
    process(event, request->right->who, head, request->body);
    if (event == Event::Raw) return counters_.raw_refused != refused;  // a refusal may ask a direct path
    settle();
    return true;
}

void EntityManagerCore::onPeerRefusal(const Header& head, const Refusal& refusal) {
    if (quit_) return;
    ++counters_.peer_refusals;
    teamwork_.unreachable(head.entity, refusal);
    settle();
}

/// Each kind of request is refused with its own kind of answer.
void EntityManagerCore::refuse(const Incident& incident, const Refusal& refusal) {
    if (incident.head == nullptr || !isRequest(incident.event)) {
        ++counters_.unexpected;
        return;
    }
    const auto& to = incident.head->sender;
    if (incident.event == Event::Raw)
        journal_.noteRefusalOfRaw(to, incident.head->held, refusal);
    else if (incident.event != Event::CheckOut)
        journal_.noteRefusal(to, incident.head->held, refusal);
    switch (incident.event) {
#define AXON_FACT(name) \
    case Event::name:   \
        break;
#define AXON_REQUEST(name, needs, wish, is, refuse) \
    case Event::name:                               \
        refuse;                                     \
        break;
#include "entity_manager/core/turn/events.def"
#undef AXON_FACT
#undef AXON_REQUEST
    }
}

void EntityManagerCore::describeServices(proto::EntityStatus& status) {
    profiles_.lookAgain();
    *status.mutable_services() = profiler_.profile().services();
    for (auto& finding : inputs_.findings()) status.add_findings()->Swap(&finding);
    for (auto& finding : profiler_.findings()) status.add_findings()->Swap(&finding);
}

void EntityManagerCore::onTimer() {
    if (quit_) return;
    eachOwner(*this, [](Owner& owner) { owner.onTimer(); });
    settle();
}

TimePoint EntityManagerCore::nextDeadline() const {
    auto next = TimePoint::max();
    if (quit_) return next;
    eachOwner(*this, [&](const Owner& owner) { next = std::min(next, owner.nextDeadline()); });
    return next;
}

void EntityManagerCore::shutDown() {
    if (quit_) return;
    readiness_.notReady("the Entity Manager has been ended by its operator");
    Incident incident{Event::Quit};
    incident.cause = StopCause::Shutdown;
    incident.reason = {RefusalCode::Unavailable, "The Entity Manager has been ended by its operator.", {}};
    fire(incident);
    teamwork_.settle();
    tasks_.shutDown();
    keepState();
    quit_ = true;
}

}  // namespace axon::entity_manager
