// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/session_core.hpp"

#include <axon/messages.pb.h>

#include <algorithm>

#include "client/content.hpp"
#include "common/planted_bug.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::client {
namespace {

constexpr std::size_t kChunkMax = 64 * 1024;
/// Signs of life in each of the server's watchdogs (safety.md, "Watchdogs"), and no more of them than this,
/// whatever it says.
constexpr int kBeatsInWatchdog = 5;
constexpr Duration kShortestBeat = std::chrono::milliseconds{10};

bool parse(google::protobuf::MessageLite& message, std::string_view bytes) {
    return message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()));
}

bool moves(EntityState state) {
    return state == EntityState::BUSY || state == EntityState::COLLAB || state == EntityState::SLAVE;
}

/// An EM in one of these has no lease to give or to keep.
bool withoutLease(EntityState state) {
    return state == EntityState::UNAV || state == EntityState::INIT || state == EntityState::ENVCONN ||
           state == EntityState::ERR;
}

bool leaseIsGone(RefusalCode code) {
    return code == RefusalCode::NotHolder || code == RefusalCode::OlderLease ||
           code == RefusalCode::RevokedLease || code == RefusalCode::WrongEpoch;
}

LeaseNumber numberOf(const proto::Lease& lease) {
    return {static_cast<std::int32_t>(lease.epoch()), static_cast<std::int32_t>(lease.number())};
}

/// Duplicates and late-comers must not turn a task back: only pause and resume go both ways.
bool follows(TaskState now, TaskState next) {
    if (isFinal(now)) return false;
    return next >= now || (now == TaskState::Paused && next == TaskState::Running);
}

}  // namespace

SessionCore::SessionCore(CoreSettings settings, const Clock& clock, RandomSource& random, ServerLink& link,
                         SessionObserver& observer, SignalMarks& marks)
    : settings_(settings),
      clock_(clock),
      random_(random),
      link_(link),
      observer_(observer),
      marks_(marks),
      server_(settings.server_silence_busy, settings.server_silence_idle, clock.now()) {}

// ---- messages out

Header SessionCore::header(const std::string& entity, const char* msg_type, LeaseNumber lease) {
    Header head;
    head.sender = self_;
    head.entity = entity;
    head.msg_type = msg_type;
    head.held = lease;
    head.stop_generation = marks_.of(entity);
    head.sequence = ++sequence_;
    head.sent_at_us = toMicroseconds(clock_.now());
    return head;
}

std::int64_t SessionCore::send(const std::string& entity, const char* msg_type, LeaseNumber lease,
                               const proto::ToEntity& body) {
    const auto head = header(entity, msg_type, lease);
    if (body.has_check_out() && self_.role != Role::Observer && asked_.insert(entity).second) {
        countMoving(entity);
        pace();
    }
    link_.sendToEntity(head, body.SerializeAsString());
    return head.sequence;
}

// ---- refusals

Refusal SessionCore::notConnected() const {
    return {RefusalCode::NotConnected,
            "There is no connection to the server at the moment. Try again when it is back.",
            {}};
}

Refusal SessionCore::notHolder(const Held& held) const {
    return {RefusalCode::NotHolder,
            "This client does not hold " + label(held.entity) + " (any more). Check it out first.",
            {}};
}

Refusal SessionCore::ready(const Held& held) const {
    const auto* mine = lease(held);
    if (!connected_) return notConnected();
    if (mine == nullptr) return notHolder(held);
    if (mine->orphaned) {
        return {RefusalCode::NotConnected,
                "The connection was lost, and the check-out of " + mine->name +
                    " is not resumed yet. Try again in a moment.",
                {}};
    }
    return {};
}

SessionCore::Lease* SessionCore::lease(const Held& held) {
    const auto found = leases_.find(held.entity);
    return found != leases_.end() && found->second.number == held.lease ? &found->second : nullptr;
}

const SessionCore::Lease* SessionCore::lease(const Held& held) const {
    const auto found = leases_.find(held.entity);
    return found != leases_.end() && found->second.number == held.lease ? &found->second : nullptr;
}

// ---- requests that wait for an answer

void SessionCore::await(Ask ask, Id128 id, Pending pending) {
    pending.ask = ask;
    if (pending.deadline == TimePoint{}) pending.deadline = clock_.now() + settings_.timeout;
    deadlines_.insert({pending.deadline, {ask, id}});
    if (pending.sequence != 0) by_sequence_[pending.sequence] = {ask, id};
    of_entity_[pending.entity].insert({ask, id});
    pending_.emplace(std::pair{ask, id}, std::move(pending));
}

SessionCore::Pending SessionCore::take(Pendings::iterator found) {
    const auto key = found->first;
    auto pending = std::move(found->second);
    pending_.erase(found);
    deadlines_.erase({pending.deadline, key});
    by_sequence_.erase(pending.sequence);
    if (const auto of = of_entity_.find(pending.entity); of != of_entity_.end()) {
        of->second.erase(key);
        if (of->second.empty()) of_entity_.erase(of);
    }
    return pending;
}

void SessionCore::postpone(Pendings::iterator found, TimePoint deadline) {
    deadlines_.erase({found->second.deadline, found->first});
    found->second.deadline = deadline;
    deadlines_.insert({deadline, found->first});
}

bool SessionCore::answer(Ask ask, Id128 id, const Result<void>& result) {
    const auto found = pending_.find({ask, id});
    if (found == pending_.end()) return false;
    const auto pending = take(found);
    if (ask == Ask::Upload) transfers_.erase(id);
    if (pending.done) pending.done(result);
    if (pending.details_done) pending.details_done(result.refusal());
    if (pending.global_services_done) pending.global_services_done(result.refusal());
    if (pending.run_records_done) pending.run_records_done(result.refusal());
    if (!result) noteRefusal(pending.entity, pending.lease, result.refusal());
    return true;
}

std::vector<SessionCore::Key> SessionCore::pendingOf(const std::string& entity) const {
    std::vector<Key> keys;
    if (const auto of = of_entity_.find(entity); of != of_entity_.end())
        keys.assign(of->second.begin(), of->second.end());
    return keys;
}

void SessionCore::answerAll(const std::string& entity, const Refusal& why) {
    for (const auto& [ask, id] : pendingOf(entity)) {
        if (ask == Ask::CheckOut) {
            if (check_outs_.contains(id)) onPartyRefused(id, entity, why);  // a query looks for another
        } else if (ask != Ask::Task && ask != Ask::Run && ask != Ask::Resume) {
            answer(ask, id, ask == Ask::Release ? Result<void>{} : Result<void>{why});
        }
    }
}

void SessionCore::endReleases(const std::string& entity, const std::function<bool(LeaseNumber)>& which) {
    for (const auto& [ask, id] : pendingOf(entity)) {
        if (ask != Ask::Release) continue;
        const auto found = pending_.find({ask, id});
        if (found != pending_.end() && which(found->second.lease)) answer(ask, id, {});
    }
}

void SessionCore::noteRefusal(const std::string& entity, LeaseNumber under, const Refusal& refusal) {
    if (!leaseIsGone(refusal.code) || under == LeaseNumber{}) return;
    if (lease({entity, under}) == nullptr) return;
    endLease(entity, refusal, true);
}

// ---- connection

void SessionCore::onConnected(const Sender& self, int entities, const Watchdogs& watchdogs) {
    connected_ = true;
    self_ = self;
    asked_.clear();
    promised_ = entities;
    watchdogs_ = watchdogs;
    server_.feed(clock_.now());
    next_heartbeat_ = clock_.now();
    for (const auto& [entity, mine] : leases_) {
        if (const auto known = entities_.find(entity); known != entities_.end() && known->second.there()) {
            sendResume(entity);
        }
    }
    for (const auto& [entity, streams] : watches_) {
        if (const auto known = entities_.find(entity); known != entities_.end() && known->second.there()) {
            sendWatches(entity);
        }
    }
}

void SessionCore::onDisconnected(const std::string& reason, bool for_good) {
    const bool was_connected = std::exchange(connected_, false);
    next_heartbeat_ = TimePoint::max();
    const Refusal lost{RefusalCode::NotConnected, "The connection to the server was lost: " + reason, {}};
    const Refusal unknown{RefusalCode::OutcomeUnknown,
                          "The connection to the server was lost while it was under way: " + reason,
                          {}};

    std::vector<Id128> check_outs;
    for (const auto& [id, order] : check_outs_) check_outs.push_back(id);
    for (const auto id : check_outs) failCheckOut(id, lost);
    for (const auto& held : this->held()) {
        const auto& mine = leases_.at(held.entity);
        if (for_good || !settings_.resume || mine.grace <= Duration{}) {
            endLease(held.entity, lost, true);
        } else if (was_connected) {
            orphan(held.entity, false, lost.message);
        }
    }

    std::vector<Key> keys;
    for (const auto& [key, pending] : pending_) {
        if (key.first != Ask::Resume) keys.push_back(key);
    }
    for (const auto& [ask, id] : keys)
        answer(ask, id, ask == Ask::Release ? Result<void>{} : Result<void>{unknown});
    // Those of a lease that may be resumed are asked after then; the others nobody can ask after.
    std::vector<Id128> tasks;
    for (const auto& [held, open] : open_tasks_) {
        if (lease(held) == nullptr) tasks.insert(tasks.end(), open.begin(), open.end());
    }
    for (const auto id : tasks) finishTask(id, TaskState::Unknown, unknown);
    for (const auto id : std::vector(open_runs_.begin(), open_runs_.end())) {
        if (lease(runs_.at(id).master) == nullptr) finishRun(id, RunState::Unknown, unknown);
    }

    auto gone = std::move(entities_);
    entities_.clear();
    names_.clear();
    present_ = 0;
    promised_ = 0;
    for (auto& [id, known] : gone) {
        marks_.forget(id);
        if (known.there() && known.facts.ready) observer_.onEntity(Presence::Left, known.facts);
    }
    moving_.clear();
    busy_.clear();
    server_.setBusy(false, clock_.now());
}

void SessionCore::onServerHeartbeat() {
    server_.feed(clock_.now());
}

void SessionCore::onServerText(int code, const std::string& text) {
    observer_.onServerText(code, text);
}

// ---- entities

void SessionCore::onProfile(Presence presence, const Registration& registration, std::string_view profile) {
    server_.feed(clock_.now());
    const std::string& id = registration.entity;
    if (presence == Presence::Left) {
        const auto known = entities_.find(id);
        if (known == entities_.end()) return;
        const Refusal why{RefusalCode::Unavailable,
                          label(id) + " has left: its Entity Manager is no longer connected to the server.",
                          {}};
        // Its Entity Manager may only have lost the server for a moment, or the server may be about to end.
        if (const auto mine = leases_.find(id);
            mine != leases_.end() && settings_.resume && mine->second.grace > Duration{}) {
            orphan(id, true, why.message);
        } else {
            endLease(id, why, true);
        }
        answerAll(id, why);
        for (const auto& order_id : std::vector(parked_.begin(), parked_.end())) {
            const auto& wanted = check_outs_.at(order_id).wanted;
            if (std::find(wanted.begin(), wanted.end(), id) != wanted.end()) failCheckOut(order_id, why);
        }
        const Entity facts = std::move(known->second.facts);
        const bool was_there = known->second.there();
        entities_.erase(known);
        names_.remove(id);
        marks_.forget(id);
        countMoving(id);
        pace();  // the server beats slowly again
        if (was_there && facts.ready) observer_.onEntity(Presence::Left, facts);
        return;
    }

    proto::BasicProfile basic;
    if (!parse(basic, profile)) ++malformed_;  // the registration alone is enough to show it
    auto& known = entities_[id];
    Entity& facts = known.facts;
    const bool was_there = known.there();
    const bool was_told = was_there && facts.ready;
    known.announced = true;
    facts.id = id;
    facts.name = registration.name;
    facts.category = registration.category;
    facts.type = registration.type;
    facts.descr = basic.descr();
    facts.x_mm = basic.xpos();
    facts.y_mm = basic.ypos();
    facts.z_mm = basic.zpos();
    facts.ready = !profile.empty();
    if (!known.there()) return;
    if (!was_there) {
        join(known);
        return;
    }
    names_.put(id, facts.name, facts.ready);
    if (facts.ready)
        observer_.onEntity(was_told ? Presence::Changed : Presence::Joined, facts);
    else if (was_told)
        observer_.onEntity(Presence::Left, facts);
}

void SessionCore::join(const KnownEntity& known) {
    const auto& facts = known.facts;
    ++present_;
    names_.put(facts.id, facts.name, facts.ready);
    if (facts.ready) observer_.onEntity(Presence::Joined, facts);
    if (!connected_) return;
    sendResume(facts.id);
    sendWatches(facts.id);
}

void SessionCore::onStatus(const EntityStatus& status) {
    server_.feed(clock_.now());
    marks_.raise(status.entity, status.stop_generation);
    auto& known = entities_[status.entity];
    const bool joins = known.announced && !known.heard;
    known.heard = true;
    Entity& facts = known.facts;
    facts.id = status.entity;
    known.told = facts.state = status.state;
    facts.latched = status.latched;
    facts.stop_generation = std::max(facts.stop_generation, status.stop_generation);
    facts.holder = status.holder;
    facts.reason = status.reason;
    facts.orphaned = status.orphaned;
    facts.waiting = status.waiting;
    facts.stop_latency.reset();
    if (status.stop_latency_us > 0) facts.stop_latency = std::chrono::microseconds(status.stop_latency_us);
    countMoving(status.entity);
    if (joins) join(known);

    if (const auto mine = leases_.find(status.entity); mine != leases_.end()) {
        if (status.held > mine->second.number && status.holder.id != self_.id) {
            endLease(status.entity,
                     {RefusalCode::RevokedLease,
                      label(status.entity) + " was given to " + status.holder.name + ".", status.holder.name},
                     true);
        } else if (!mine->second.orphaned && status.holder.id.empty() && withoutLease(status.state)) {
            endLease(status.entity,
                     {RefusalCode::Unavailable,
                      label(status.entity) + " is " + toString(status.state) +
                          (status.reason.empty() ? std::string(".") : ": " + status.reason),
                      {}},
                     true);
        }
    }
    if (status.holder.id != self_.id) {
        endReleases(status.entity, [&](LeaseNumber number) { return status.held >= number; });
    }
    wakeParked();
    pace();
    if (!joins) tellChanged(known);
}

void SessionCore::onServiceRecord(const Header& head, std::string_view record) {
    server_.feed(clock_.now());
    proto::Service service;
    if (!parse(service, record)) {
        ++malformed_;
        return;
    }
    onService(head.entity, service);
}

void SessionCore::onService(const std::string& entity, const proto::Service& service) {
    const auto mine = leases_.find(entity);
    if (mine == leases_.end()) return;
    auto& services = *mine->second.services.mutable_services();
    auto same = std::find_if(services.begin(), services.end(),
                             [&](const proto::Service& s) { return s.name() == service.name(); });
    if (same == services.end()) {
        *services.Add() = service;
    } else {
        *same = service;
    }
    observer_.onService({entity, mine->second.number}, fromProto(service));
}

void SessionCore::tellChanged(const KnownEntity& known) {
    if (known.there() && known.facts.ready) observer_.onEntity(Presence::Changed, known.facts);
}

std::vector<Entity> SessionCore::entities(Listed listed) const {
    std::vector<Entity> list;
    for (const auto& id : names_.ids()) {
        const auto& facts = entities_.at(id).facts;
        if (facts.ready || listed == Listed::All) list.push_back(facts);
    }
    return list;
}

Result<Entity> SessionCore::find(std::string_view name) const {
    if (!connected_) return notConnected();
    const auto id = names_.resolve(name);
    if (!id) return id.refusal();
    return entity(id.value());
}

Result<Entity> SessionCore::entity(const std::string& id) const {
    const auto known = entities_.find(id);
    if (known == entities_.end() || !known->second.there()) {
        return Refusal{RefusalCode::UnknownEntity,
                       "The entity " + id + " is not connected to the server (any more).",
                       {}};
    }
    return known->second.facts;
}

// ---- messages of entities

void SessionCore::onEntityMsg(const Header& head, std::string_view bytes, bool of_server) {
    if (of_server) server_.feed(clock_.now());
    proto::ToClient message;
    if (!parse(message, bytes)) {
        ++malformed_;
        return;
    }
    const std::string& entity = head.entity;
    const auto mine = leases_.find(entity);
    switch (message.body_case()) {
        case proto::ToClient::kCheckOut:
            onCheckOutReply(head, message.check_out());
            break;
        case proto::ToClient::kLeaseEnded: {
            const auto number = numberOf(message.lease_ended().lease());
            endReleases(entity, [&](LeaseNumber ended) { return ended == number; });
            if (mine == leases_.end() || mine->second.number != number) break;
            auto why = toRefusal(message.lease_ended().reason());
            if (why.ok())
                why = {RefusalCode::RevokedLease, "The lease of " + label(entity) + " has ended.", {}};
            endLease(entity, why, true);
            break;
        }
        case proto::ToClient::kReply:
            onReply(head, message.reply());
            break;
        case proto::ToClient::kTask:
            onTaskEvent(entity, message.task());
            break;
        case proto::ToClient::kStatus:
            onStatusMsg(head, message.status());
            break;
        case proto::ToClient::kReceipt:
            break;
        case proto::ToClient::kResourceCredit: {
            const auto& credit = message.resource_credit();
            const auto id = Id128::fromBytes(credit.transfer_id());
            if (!id) break;
            const auto found = pending_.find({Ask::Upload, *id});
            if (found == pending_.end()) break;
            postpone(found, clock_.now() + settings_.timeout);
            if (credit.window() == 0) break;  // it is not forgotten
            observer_.onTransferCredit(*id, credit.offset(), credit.offset() + credit.window());
            break;
        }
        case proto::ToClient::kResourceDone: {
            const auto id = Id128::fromBytes(message.resource_done().transfer_id());
            if (id) answer(Ask::Upload, *id, toRefusal(message.resource_done().refusal()));
            break;
        }
        case proto::ToClient::kText:
            if (mine != leases_.end()) observer_.onText({entity, mine->second.number}, message.text().text());
            break;
        case proto::ToClient::kRaw:
            if (mine == leases_.end()) break;
            for (const auto& piece : message.raw().data())
                observer_.onRaw({entity, mine->second.number}, piece);
            break;
        case proto::ToClient::kSample: {
            if (watches_.count(entity) == 0) break;
            const auto& sample = message.sample();
            observer_.onSample({entity, sample.stream(), sample.sequence(), {}, sample.SerializeAsString()});
            break;
        }
        case proto::ToClient::kService:
            onService(entity, message.service());
            break;
        case proto::ToClient::kPosition: {
            const auto known = entities_.find(entity);
            if (known == entities_.end()) break;
            known->second.facts.x_mm = message.position().xpos();
            known->second.facts.y_mm = message.position().ypos();
            known->second.facts.z_mm = message.position().zpos();
            tellChanged(known->second);
            break;
        }
        case proto::ToClient::kHandOver:
            onHandOver(entity, message.hand_over());
            break;
        case proto::ToClient::kRun:
            onRunEvent(entity, message.run());
            break;
        case proto::ToClient::kRunHistory:
            onRunHistory(entity, message.run_history());
            break;
        case proto::ToClient::kGlobalServices: {
            const auto id = Id128::fromBytes(message.global_services().request_id());
            const auto found = id ? pending_.find({Ask::GlobalServices, *id}) : pending_.end();
            // Of the server, which is no entity.
            if (found == pending_.end() || !entity.empty()) break;
            take(found).global_services_done(fromProto(message.global_services()));
            break;
        }
        case proto::ToClient::kWay:
            break;  // of the direct path, which the core does not know
        case proto::ToClient::BODY_NOT_SET:
            ++malformed_;  // or a message of a newer version: nothing this one could do with it
            break;
    }
}

void SessionCore::onReply(const Header& head, const proto::Reply& reply) {
    const auto id = Id128::fromBytes(reply.request_id());
    const auto refusal = toRefusal(reply.refusal());
    const auto mine = leases_.find(head.entity);
    if (!id) {
        // Text, raw data, reset and the like have no request of their own: a refusal is all that comes back.
        // The entity's header says which lease it obeys now; while that is ours, the refusal is about an
        // earlier one.
        if (refusal.ok()) {
            ++malformed_;
            return;
        }
        if (mine != leases_.end() && head.held != mine->second.number) {
            noteRefusal(head.entity, mine->second.number, refusal);
        }
        observer_.onServerText(static_cast<int>(refusal.code), label(head.entity) + ": " + refusal.message);
        return;
    }
    for (const Ask ask : {Ask::Set, Ask::Rearm, Ask::Release}) {
        if (answer(ask, *id, ask == Ask::Release ? Refusal{} : refusal)) return;
    }
    if (!refusal.ok()) {
        for (const Ask ask :
             {Ask::Services, Ask::Control, Ask::Upload, Ask::GlobalServices, Ask::RunRecords}) {
            if (answer(ask, *id, refusal)) return;
        }
        // Of the request itself: once an event has come, a refusal is of something else, and the robots may move.
        if (tasks_.count(*id) != 0) {
            if (pending_.count({Ask::Task, *id}) != 0) finishTask(*id, TaskState::Refused, refusal);
        } else if (const auto run = runs_.find(*id); run != runs_.end() && run->second.master.entity == head.entity &&
                                                     run->second.sequence == 0 && pending_.count({Ask::Run, *id}) != 0) {
            finishRun(*id, RunState::Refused, refusal);
        }
    }
}

void SessionCore::onRefusal(const Header& head, const Refusal& refusal) {
    server_.feed(clock_.now());
    const auto sent = by_sequence_.find(head.sequence);
    if (sent != by_sequence_.end()) {
        const auto [ask, id] = sent->second;
        const auto pending = pending_.find({ask, id});
        if (ask == Ask::CheckOut) {
            onPartyRefused(id, head.entity, refusal);
            return;
        }
        if (pending != pending_.end() && pending->second.entity == head.entity) {
            if (ask == Ask::Task) {
                finishTask(id, TaskState::Refused, refusal);
            } else if (ask == Ask::Run) {
                finishRun(id, RunState::Refused, refusal);
            } else if (ask == Ask::Resume) {
                // Not there (yet): asked again when it joins.
                postpone(pending, leases_.at(head.entity).expires);
            } else {
                answer(ask, id, ask == Ask::Release ? Result<void>{} : Result<void>{refusal});
            }
            return;
        }
    }
    const auto mine = leases_.find(head.entity);
    if (mine != leases_.end()) noteRefusal(head.entity, head.held, refusal);
    observer_.onServerText(static_cast<int>(refusal.code), refusal.message);
}

void SessionCore::onStatusMsg(const Header& head, const proto::EntityStatus& status) {
    const auto known = entities_.find(head.entity);
    marks_.raise(head.entity, static_cast<std::int32_t>(status.stop_generation()));
    if (known != entities_.end()) {
        Entity& facts = known->second.facts;
        facts.state = stateFromProto(status.state()).value_or(facts.state);
        facts.latched = status.latched();
        facts.stop_generation =
            std::max(facts.stop_generation, static_cast<std::int32_t>(status.stop_generation()));
        facts.reason = status.reason();
        facts.orphaned = status.orphaned();
        facts.waiting = static_cast<int>(status.waiting());
        countMoving(head.entity);
        tellChanged(known->second);
    }
    for (const auto& event : status.tasks()) onTaskEvent(head.entity, event);
    for (const auto& event : status.ended()) onTaskEvent(head.entity, event);
    pace();

    const auto asked = Id128::fromBytes(status.request_id());
    if (!asked) return;
    if (const auto found = pending_.find({Ask::Tasks, *asked}); found != pending_.end()) {
        const auto pending = take(found);
        std::set<Id128> alive;
        for (const auto& event : status.tasks()) {
            if (const auto id = Id128::fromBytes(event.task_id())) alive.insert(*id);
        }
        for (const auto id : pending.tasks) {
            if (alive.count(id) == 0) {
                finishTask(id, TaskState::Unknown,
                           {RefusalCode::OutcomeUnknown,
                            label(head.entity) + " does not know (any more) what became of it.",
                            {}});
            }
        }
        return;
    }
    const auto found = pending_.find({Ask::Services, *asked});
    if (found == pending_.end()) return;
    Details details;
    for (const auto& service : status.services()) details.services.push_back(fromProto(service));
    for (const auto& margin : status.watchdogs()) {
        details.watchdogs.push_back({margin.hop(), std::chrono::milliseconds(margin.timeout_ms()),
                                     std::chrono::milliseconds(margin.longest_gap_ms())});
    }
    for (const auto& finding : status.findings())
        details.findings.push_back({finding.message(), finding.fix()});
    take(found).details_done(std::move(details));
}

// ---- leases

std::vector<Held> SessionCore::held() const {
    std::vector<Held> all;
    for (const auto& [entity, lease] : leases_) all.push_back({entity, lease.number});
    return all;
}

bool SessionCore::holds(const Held& held) const {
    return lease(held) != nullptr;
}

void SessionCore::sendRelease(const Held& held) {
    proto::ToEntity body;
    body.mutable_release();
    send(held.entity, kMsgRelease, held.lease, body);
}

void SessionCore::release(const Held& held, Done done) {
    if (orphaned(held)) {
        // Nobody can be told; the Entity Manager ends it when its time is up.
        endLease(held.entity, {RefusalCode::NotHolder, "It was released.", {}}, false);
        for (const auto id : openTasks(held)) {
            finishTask(id, TaskState::Unknown,
                       {RefusalCode::OutcomeUnknown,
                        "Its check-out was released while the connection was lost.",
                        {}});
        }
        for (const auto id : openRuns(held)) {
            finishRun(id, RunState::Unknown,
                      {RefusalCode::OutcomeUnknown,
                       "The check-out of its master was released while the connection was lost.",
                       {}});
        }
        return done({});
    }
    const auto refusal = ready(held);
    if (!refusal.ok()) return done(refusal);
    proto::ToEntity body;
    body.mutable_release();
    Pending pending;
    pending.entity = held.entity;
    pending.lease = held.lease;
    pending.done = std::move(done);
    pending.sequence = send(held.entity, kMsgRelease, held.lease, body);
    endLease(held.entity, {RefusalCode::NotHolder, label(held.entity) + " was released.", {}}, false);
    // The entity stops what runs and says so in events of the tasks; without them they become Unknown.
    for (const auto id : openTasks(held)) awaitTask(id, tasks_.at(id));
    for (const auto id : openRuns(held)) awaitRun(id);
    await(Ask::Release, Id128::random(random_), std::move(pending));
}

void SessionCore::endLease(std::string entity, const Refusal& why, bool tell) {
    const auto found = leases_.find(entity);
    if (found == leases_.end()) return;
    const Held held{entity, found->second.number};
    leases_.erase(found);
    observer_.onDatagrams(held, {}, {});
    observer_.onDirect(held, {}, {}, {});
    countMoving(entity);
    for (const auto& [ask, id] : pendingOf(entity)) {
        if (ask == Ask::Release || ask == Ask::Task || ask == Ask::Run || ask == Ask::CheckOut) continue;
        const auto pending = pending_.find({ask, id});
        if (pending != pending_.end() && pending->second.lease == held.lease) answer(ask, id, why);
    }
    if (tell) {
        const Refusal unknown{RefusalCode::OutcomeUnknown,
                              "The lease ended while it was under way: " + why.message, why.holder};
        for (const auto id : openTasks(held)) finishTask(id, TaskState::Unknown, unknown);
        for (const auto id : openRuns(held)) finishRun(id, RunState::Unknown, unknown);
        observer_.onLost(held, why);
    }
    pace();
}

Result<std::vector<Service>> SessionCore::services(const Held& held) const {
    const auto* mine = lease(held);
    if (mine == nullptr) return notHolder(held);
    std::vector<Service> all;
    for (const auto& service : mine->services.services()) all.push_back(fromProto(service));
    return all;
}

Result<Service> SessionCore::service(const Held& held, std::string_view name_or_global_id) const {
    const auto* mine = lease(held);
    if (mine == nullptr) return notHolder(held);
    const auto index = findServiceIndex(mine->services, name_or_global_id);
    if (!index) return index.refusal();
    return fromProto(mine->services.services(index.value()));
}

// ---- requests under a lease

void SessionCore::set(const Held& held, std::string_view service, const Argument& argument, Done done) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return done(refusal);
    const auto& services = lease(held)->services;
    const auto index = findServiceIndex(services, service);
    if (!index) return done(index.refusal());
    auto params = toParams(services.services(index.value()), {argument});
    if (!params) return done(params.refusal());
    const auto id = Id128::random(random_);
    proto::ToEntity body;
    auto& request = *body.mutable_set_param();
    request.set_service(services.services(index.value()).name());
    *request.mutable_param() = std::move(params->front());
    request.set_request_id(id.bytes());
    Pending pending;
    pending.entity = held.entity;
    pending.lease = held.lease;
    pending.done = std::move(done);
    pending.sequence = send(held.entity, kMsgParam, held.lease, body);
    await(Ask::Set, id, std::move(pending));
}

Result<void> SessionCore::sendText(const Held& held, std::string_view text) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return refusal;
    if (!isUtf8(text))
        return Refusal{RefusalCode::Malformed, "A text must be UTF-8; send other bytes as raw data.", {}};
    proto::ToEntity body;
    body.mutable_text()->set_text(std::string(text));
    send(held.entity, kMsgText, held.lease, body);
    return {};
}

Result<void> SessionCore::sendRaw(const Held& held, std::string_view bytes) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return refusal;
    link_.sendToEntityDataSeq(header(held.entity, kMsgRaw, held.lease), rawMessage(bytes));
    return {};
}

Result<void> SessionCore::reset(const Held& held, std::int64_t sequence) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return refusal;
    if (const auto known = entities_.find(held.entity);
        known != entities_.end() && known->second.facts.latched) {
        return Refusal{RefusalCode::Latched, label(held.entity) + " was stopped. Rearm it first.", {}};
    }
    auto head = header(held.entity, kMsgReset, held.lease);
    head.sequence = sequence > 0 ? sequence : marks_.nextSequence();
    link_.sendReset(head);
    return {};
}

Result<void> SessionCore::clear(const Held& held, std::int64_t sequence) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return refusal;
    auto head = header(held.entity, kMsgClear, held.lease);
    head.sequence = sequence > 0 ? sequence : marks_.nextSequence();
    link_.sendClear(head);
    return {};
}

void SessionCore::rearm(const std::string& entity, Done done) {
    if (!connected_) return done(notConnected());
    const auto known = this->entity(entity);
    if (!known) return done(known.refusal());
    const auto mine = leases_.find(entity);
    const auto id = Id128::random(random_);
    proto::ToEntity body;
    body.mutable_rearm()->set_request_id(id.bytes());
    Pending pending;
    pending.entity = entity;
    pending.lease = mine == leases_.end() ? LeaseNumber{} : mine->second.number;
    pending.done = std::move(done);
    pending.sequence = send(entity, kMsgRearm, pending.lease, body);
    await(Ask::Rearm, id, std::move(pending));
}

void SessionCore::fetchDetails(const std::string& entity, DetailsDone done) {
    if (!connected_) return done(notConnected());
    const auto known = this->entity(entity);
    if (!known) return done(known.refusal());
    const auto id = Id128::random(random_);
    proto::ToEntity body;
    body.mutable_status_request()->set_request_id(id.bytes());
    body.mutable_status_request()->set_with_services(true);
    Pending pending;
    pending.entity = entity;
    pending.details_done = std::move(done);
    pending.sequence = send(entity, kMsgStatus, {}, body);
    await(Ask::Services, id, std::move(pending));
}

void SessionCore::fetchServices(const std::string& entity, ServicesDone done) {
    fetchDetails(entity, [done = std::move(done)](Result<Details> details) {
        if (!details) return done(details.refusal());
        done(std::move(details->services));
    });
}

// ---- streams

Result<void> SessionCore::watch(const std::string& entity, const std::vector<std::string>& streams) {
    if (!connected_) return notConnected();
    const auto known = this->entity(entity);
    if (!known) return known.refusal();
    auto& counts = watches_[entity];
    if (streams.empty()) ++counts[""];
    for (const auto& stream : streams) ++counts[stream];
    sendWatches(entity);
    return {};
}

void SessionCore::unwatch(const std::string& entity, const std::vector<std::string>& streams) {
    const auto found = watches_.find(entity);
    if (found == watches_.end()) return;
    auto& counts = found->second;
    std::vector<std::string> off;
    const auto drop = [&](const std::string& stream) {
        const auto count = counts.find(stream);
        if (count == counts.end() || --count->second > 0) return;
        counts.erase(count);
        off.push_back(stream);
    };
    if (streams.empty()) drop("");
    for (const auto& stream : streams) drop(stream);
    if (counts.empty()) watches_.erase(found);
    if (off.empty() || !connected_ || !names_.contains(entity)) return;
    proto::ToEntity body;
    auto& watch = *body.mutable_watch();
    watch.set_on(false);
    for (const auto& stream : off) {
        if (!stream.empty()) watch.add_streams(stream);
    }
    send(entity, kMsgWatch, {}, body);
    // Switching "all" off takes the single ones with it.
    if (std::find(off.begin(), off.end(), "") != off.end()) sendWatches(entity);
}

void SessionCore::sendWatches(const std::string& entity) {
    const auto found = watches_.find(entity);
    if (found == watches_.end()) return;
    proto::ToEntity body;
    auto& watch = *body.mutable_watch();
    watch.set_on(true);
    if (found->second.count("") == 0) {
        for (const auto& [stream, count] : found->second) watch.add_streams(stream);
    }
    send(entity, kMsgWatch, {}, body);
}

// ---- resources

Id128 SessionCore::offer(const Held& held, std::string_view service, std::string_view resource,
                         const std::string& file_name, std::uint64_t size, const std::string& sha256,
                         Done done) {
    const auto id = Id128::random(random_);
    const auto refusal = ready(held);
    if (!refusal.ok()) {
        done(refusal);
        return id;
    }
    const auto& services = lease(held)->services;
    const auto index = findServiceIndex(services, service);
    if (!index) {
        done(index.refusal());
        return id;
    }
    const auto& chosen = services.services(index.value());
    const auto place = findResourceIndex(chosen, resource);
    if (!place) {
        done(place.refusal());
        return id;
    }
    proto::ToEntity body;
    auto& offer = *body.mutable_resource_offer();
    offer.set_transfer_id(id.bytes());
    offer.set_service(chosen.name());
    offer.set_resource(chosen.resources(place.value()).name());
    offer.set_file_name(file_name);
    offer.set_size(size);
    offer.set_sha256(sha256);
    Pending pending;
    pending.entity = held.entity;
    pending.lease = held.lease;
    pending.done = std::move(done);
    pending.sequence = send(held.entity, kMsgResource, held.lease, body);
    transfers_[id] = held;
    await(Ask::Upload, id, std::move(pending));
    return id;
}

std::uint64_t SessionCore::resourceBytesMax(const Held& held) const {
    const auto* found = lease(held);
    return found != nullptr ? found->resource_bytes_max : 0;
}

Result<void> SessionCore::sendChunk(const Id128& transfer, std::uint64_t offset, std::string_view content) {
    const auto found = transfers_.find(transfer);
    if (found == transfers_.end())
        return Refusal{RefusalCode::Cancelled, "The transfer has ended already.", {}};
    if (content.size() > kChunkMax) {
        return Refusal{RefusalCode::TooLarge, "A chunk holds at most 65536 bytes.", {}};
    }
    proto::ToEntity body;
    auto& chunk = *body.mutable_resource_chunk();
    chunk.set_transfer_id(transfer.bytes());
    chunk.set_offset(offset);
    chunk.set_content(std::string(content));
    // Not among the data that servers may drop: the window keeps it small enough to be kept.
    send(found->second.entity, kMsgResource, found->second.lease, body);
    return {};
}

// ---- tasks

std::optional<TaskReport> SessionCore::task(const Id128& id) const {
    const auto found = tasks_.find(id);
    if (found == tasks_.end()) return std::nullopt;
    return found->second.report;
}

Id128 SessionCore::run(const Held& held, std::string_view service, const std::vector<Argument>& arguments,
                       Duration not_after) {
    const auto id = Id128::uuid(random_);
    auto& record = tasks_[id];
    ++running_tasks_;
    record.held = held;
    record.report.id = id.toString();
    record.report.entity = held.entity;
    record.report.service = std::string(service);
    open_tasks_[held].insert(id);

    const auto refusal = ready(held);
    if (!refusal.ok()) {
        finishTask(id, TaskState::Refused, refusal);
        return id;
    }
    const auto& services = lease(held)->services;
    const auto index = findServiceIndex(services, service);
    if (!index) {
        finishTask(id, TaskState::Refused, index.refusal());
        return id;
    }
    const auto& chosen = services.services(index.value());
    auto params = toParams(chosen, arguments);
    if (!params) {
        finishTask(id, TaskState::Refused, params.refusal());
        return id;
    }
    record.report.service = chosen.name();
    proto::ToEntity body;
    auto& request = *body.mutable_task();
    request.set_task_id(id.bytes());
    request.set_service(chosen.name());
    for (auto& param : params.value()) *request.add_params() = std::move(param);
    request.set_not_after_s(Seconds(not_after).count());
    Pending pending;
    pending.entity = held.entity;
    pending.lease = held.lease;
    pending.sequence = send(held.entity, kMsgTask, held.lease, body);
    await(Ask::Task, id, std::move(pending));
    pace();
    return id;
}

void SessionCore::onTaskEvent(const std::string& entity, const proto::TaskEvent& event) {
    const auto id = Id128::fromBytes(event.task_id());
    const auto state = taskStateFromProto(event.state());
    if (!id || !state) {
        ++malformed_;
        return;
    }
    const auto found = tasks_.find(*id);
    if (found == tasks_.end() || found->second.held.entity != entity) return;
    answer(Ask::Task, *id, {});
    auto& record = found->second;
    auto& report = record.report;
    if (isFinal(report.state)) {
        // Given up here, alive there: a task whose outcome this client has called unknown must not go on.
        if (report.state == TaskState::Unknown && !isFinal(*state) && lease(record.held) != nullptr) {
            proto::ToEntity body;
            body.mutable_task_control()->set_task_id(id->bytes());
            body.mutable_task_control()->set_action(proto::CANCEL);
            send(entity, kMsgTaskControl, record.held.lease, body);
        }
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
    const auto under = record.held.lease;
    if (isFinal(told.state)) {
        noteFinal(*id);
    } else if (lease(record.held) == nullptr) {
        awaitTask(*id, record);
    }
    // The report first: whoever waited for the pause finds the task paused.
    observer_.onTask(told);
    settleControls(*id, told);
    if (*state == TaskState::Refused) noteRefusal(entity, under, told.reason);
    pace();
}

void SessionCore::awaitTask(Id128 id, const TaskRecord& record) {
    if (pending_.count({Ask::Task, id}) != 0) return;
    Pending pending;
    pending.entity = record.held.entity;
    pending.lease = record.held.lease;
    await(Ask::Task, id, std::move(pending));
}

void SessionCore::finishTask(Id128 id, TaskState state, const Refusal& why) {
    const auto found = tasks_.find(id);
    if (found == tasks_.end() || isFinal(found->second.report.state)) return;
    answer(Ask::Task, id, {});
    found->second.report.state = state;
    found->second.report.reason = why;
    // A copy: what follows may end other tasks, and the oldest that is over is forgotten.
    const auto report = found->second.report;
    noteFinal(id);
    observer_.onTask(report);
    settleControls(id, report);
    pace();
}

std::vector<Id128> SessionCore::openTasks(const Held& held) const {
    const auto open = open_tasks_.find(held);
    return open == open_tasks_.end() ? std::vector<Id128>{}
                                     : std::vector(open->second.begin(), open->second.end());
}

void SessionCore::noteFinal(Id128 id) {
    --running_tasks_;
    if (const auto open = open_tasks_.find(tasks_.at(id).held); open != open_tasks_.end()) {
        open->second.erase(id);
        if (open->second.empty()) open_tasks_.erase(open);
    }
    finished_tasks_.push_back(id);
    while (finished_tasks_.size() > std::max<std::size_t>(settings_.tasks_kept, 1)) {
        tasks_.erase(finished_tasks_.front());
        finished_tasks_.pop_front();
    }
}

void SessionCore::settleControls(Id128 id, const TaskReport& report) {
    const auto found = pending_.find({Ask::Control, id});
    if (found == pending_.end()) return;
    const auto action = found->second.action;
    if (isFinal(report.state)) {
        if (action == proto::CANCEL && report.state != TaskState::Unknown) {
            answer(Ask::Control, id, {});
        } else {
            answer(Ask::Control, id,
                   Refusal{report.state == TaskState::Unknown ? RefusalCode::OutcomeUnknown
                                                              : RefusalCode::WrongState,
                           std::string("The task has ended meanwhile: ") + toString(report.state) + ".",
                           {}});
        }
    } else if ((action == proto::PAUSE && report.state == TaskState::Paused) ||
               (action == proto::RESUME && report.state == TaskState::Running)) {
        answer(Ask::Control, id, {});
    }
}

void SessionCore::control(const Id128& task, proto::TaskAction action, Done done) {
    const auto found = tasks_.find(task);
    if (found == tasks_.end()) {
        return done(Refusal{RefusalCode::UnknownTask, "This client knows no such task (any more).", {}});
    }
    const auto& record = found->second;
    if (isFinal(record.report.state)) {
        return done(Refusal{RefusalCode::WrongState,
                            std::string("The task has ended already: ") + toString(record.report.state) + ".",
                            {}});
    }
    const auto refusal = ready(record.held);
    if (!refusal.ok()) return done(refusal);
    answer(Ask::Control, task,
           Refusal{RefusalCode::Cancelled, "A newer request for the same task took its place.", {}});
    proto::ToEntity body;
    body.mutable_task_control()->set_task_id(task.bytes());
    body.mutable_task_control()->set_action(action);
    Pending pending;
    pending.entity = record.held.entity;
    pending.lease = record.held.lease;
    pending.action = action;
    pending.done = std::move(done);
    pending.sequence = send(record.held.entity, kMsgTaskControl, record.held.lease, body);
    await(Ask::Control, task, std::move(pending));
}

// ---- time

bool SessionCore::busy() const {
    if (running_tasks_ > 0 || !open_runs_.empty()) return true;
    return !moving_.empty();
}

void SessionCore::countMoving(const std::string& entity) {
    const auto known = entities_.find(entity);
    // The server goes by what the entity says, of one that this session has asked for: until that has let go of a client
    // that released it, its watchdog is short.
    const bool named = known != entities_.end() && asked_.contains(entity) && known->second.facts.holder.id == self_.id;
    const bool counts = named || (known != entities_.end() && leases_.count(entity) != 0);
    const auto keep = [&](std::set<std::string>& in, bool member) {
        if (member) {
            in.insert(entity);
        } else {
            in.erase(entity);
        }
    };
    keep(moving_, counts && (moves(known->second.facts.state) || moves(known->second.told)));
    keep(busy_, named && known->second.told == EntityState::BUSY);
}

void SessionCore::pace() {
    if (!connected_) return;
    const auto now = clock_.now();
    // The server beats fast only while it sees an entity of ours BUSY; our own tasks begin a little earlier.
    server_.setBusy(!busy_.empty(), now);
    if (busy()) next_heartbeat_ = std::min(next_heartbeat_, now + beatPeriod(true));
}

Duration SessionCore::beatPeriod(bool fast) const {
    return std::max((fast ? watchdogs_.busy : watchdogs_.idle) / kBeatsInWatchdog, kShortestBeat);
}

void SessionCore::onHeartbeatTimer() {
    const auto now = clock_.now();
    if (!connected_ || now < next_heartbeat_) return;
    const bool fast = busy();
    next_heartbeat_ = now + beatPeriod(fast);
    link_.keepAlive(++beat_, fast);
}

TimePoint SessionCore::nextDeadline() const {
    return deadlines_.empty() || AXON_PLANTED(RequestsWaitForEver) ? TimePoint::max() : deadlines_.begin()->first;
}

void SessionCore::onTimer() {
    const auto now = clock_.now();
    while (!deadlines_.empty() && deadlines_.begin()->first <= now) {
        const auto [ask, id] = deadlines_.begin()->second;
        const Refusal late{
            RefusalCode::TimedOut,
            "No answer within " + std::to_string(Seconds(settings_.timeout).count()).substr(0, 4) + " s.",
            {}};
        if (ask == Ask::CheckOut) {
            onCheckOutDue(id);
        } else if (ask == Ask::Resume) {
            onResumeDue(id);
        } else if (ask == Ask::Tasks) {
            const auto pending = take(pending_.find({ask, id}));
            for (const auto task : pending.tasks) {
                finishTask(task, TaskState::Unknown,
                           {RefusalCode::OutcomeUnknown,
                            label(pending.entity) + " has not said in time what became of it.",
                            {}});
            }
        } else if (ask == Ask::Runs) {
            onRunsDue(id);
        } else if (ask == Ask::Run) {
            const auto master = runs_.at(id).master;
            if (ready(master).ok()) cancelRun(id, master);
            finishRun(id, RunState::Unknown,
                      {RefusalCode::OutcomeUnknown,
                       label(master.entity) + ", its master, has not answered the request in time.",
                       {}});
        } else if (ask == Ask::Task) {
            // It may or may not run: say so, and make an end of it if it does.
            const auto held = tasks_.at(id).held;
            if (ready(held).ok()) {
                proto::ToEntity body;
                body.mutable_task_control()->set_task_id(id.bytes());
                body.mutable_task_control()->set_action(proto::CANCEL);
                send(held.entity, kMsgTaskControl, held.lease, body);
            }
            finishTask(id, TaskState::Unknown,
                       {RefusalCode::OutcomeUnknown,
                        label(held.entity) + " has not answered the request in time.",
                        {}});
        } else {
            answer(ask, id, late);
        }
    }
}

}  // namespace axon::client
