// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/ownership/ownership.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "common/planted_bug.hpp"
#include "common/utf8.hpp"
#include "entity_manager/core/turn/state_table.hpp"
#include "entity_manager/ports/journal_record.hpp"
#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

constexpr Duration kReserveDefault = std::chrono::seconds{2};
constexpr Duration kReserveMax = std::chrono::seconds{30};
/// How long a check-out waits for the robot to confirm its last stop.
constexpr Duration kStandstillWait =
    std::chrono::seconds{4};  // below the client's time-out: it should hear why
constexpr double kAnswerWithinMax_s = 600;
constexpr std::size_t kKeySize = 16;
constexpr std::size_t kWhyMax = 500;

Duration fromSeconds(double seconds) {
    return std::chrono::duration_cast<Duration>(std::chrono::duration<double>(seconds));
}

std::string inWords(Duration time) {
    const auto ms = std::chrono::duration_cast<std::chrono::milliseconds>(time).count();
    return ms % 1000 == 0 ? std::to_string(ms / 1000) + " s" : std::to_string(ms) + " ms";
}

Result<HandOverPolicy> policyOf(const proto::HandOverPolicy& asked) {
    const auto within = asked.answer_within_s();
    if (!std::isfinite(within) || within < 0 || within > kAnswerWithinMax_s)
        return Refusal{RefusalCode::OutOfRange,
                       "answer_within_s must be a number of seconds from 0 (the default, 30) to 600.",
                       {}};
    HandOverPolicy policy;
    if (within > 0) policy.answer_within = fromSeconds(within);
    policy.yield = asked.yield();
    return policy;
}

Result<Claim> claimOf(const Sender& sender, const proto::CheckOutRequest& request) {
    if (!request.root().empty() && !Id128::fromBytes(request.root()))
        return Refusal{RefusalCode::Malformed, "root must be 16 bytes, or empty.", {}};
    auto policy = policyOf(request.hand_over());
    if (!policy) return policy.refusal();
    return Claim{sender, request.request_id(), request.root(), policy.value()};
}

/// ": why" of a text for people that somebody has sent.
std::string because(const std::string& reason) {
    return reason.empty() ? "." : ": " + std::string(cutUtf8(reason, kWhyMax));
}

}  // namespace

Ownership::Ownership(Turn& turn, Others& others, JournalWriter& journal, Storage& storage,
                     RandomSource& random, const ServiceProfiler& profiler, const Settings& settings)
    : turn_(turn),
      others_(others),
      journal_(journal),
      profiler_(profiler),
      settings_(settings),
      lease_(storage, random) {}

void Ownership::considerCheckOut(const Incident& incident) {
    const auto& request = incident.body->check_out();
    const auto& sender = incident.head->sender;
    const auto phase = request.phase();
    const auto refuseWith = [&](const Refusal& refusal) {
        reply(sender, request.request_id(), phase, refusal);
    };
    if (!Id128::fromBytes(request.request_id())) {
        refuseWith({RefusalCode::Malformed, "request_id must be 16 bytes.", {}});
        return;
    }
    auto claim = claimOf(sender, request);
    if (!claim) {
        refuseWith(claim.refusal());
        return;
    }
    const bool takes = phase == proto::TAKE || phase == proto::RESERVE || phase == proto::COMMIT;
    if (takes && request.force() && sender.role != Role::Admin) {
        refuseWith({RefusalCode::PermissionDenied,
                    "Only an administrator may take over what somebody holds. Ask the holder, or wait.",
                    holder() != nullptr ? named(*holder()) : std::string()});
        return;
    }
    switch (phase) {
        case proto::TAKE:
            take(incident, std::move(claim).value());
            return;
        case proto::RESERVE:
            reserve(incident, claim.value());
            return;
        case proto::COMMIT:
            commit(incident, claim.value());
            return;
        case proto::ABORT:
            abort(incident);
            return;
        case proto::RESUME_LEASE:
            resume(incident);
            return;
        default:
            refuseWith({RefusalCode::Malformed,
                        "The phase must be TAKE, RESERVE, COMMIT, ABORT or RESUME_LEASE.",
                        {}});
    }
}

/// Whether this check-out has been granted already and waits for the robot; then there is nothing more to do.
bool Ownership::waitsForStandstill(const Claim& claim, proto::CheckOutPhase phase) {
    if (!waiting_grant_ || waiting_grant_->claim.client.id != claim.client.id ||
        waiting_grant_->claim.request_id != claim.request_id)
        return false;
    // Asked again: the one answer is still to come.
    if (waiting_grant_->phase != phase)
        reply(claim.client, claim.request_id, phase,
              {RefusalCode::WrongState, "This check-out waits already until the robot stands still.", {}});
    return true;
}

Refusal Ownership::mayTake(const Claim& claim) const {
    auto refusal = lease_.mayTake(claim.client, claim.request_id);
    // Free, and the first of the list gets it as soon as the robot stands still.
    if (refusal.ok() && !wait_list_.empty() && !lease_.reservedFor(claim.client, claim.request_id))
        refusal = {RefusalCode::Reserved,
                   named(wait_list_.first().client) +
                       " has waited for it and is next. Wait in its list, or choose "
                       "another entity.",
                   named(wait_list_.first().client)};
    return refusal;
}

void Ownership::take(const Incident& incident, Claim claim) {
    const auto& request = incident.body->check_out();
    if (waitsForStandstill(claim, proto::TAKE)) return;
    const bool holds = holder() != nullptr && holder()->id == claim.client.id && !lease_.orphaned();
    if (holds && lease_.held()->request_id == claim.request_id) {
        sendGrant(proto::TAKE);
        return;
    }
    if (hand_over_.isOpenFor(claim.client, claim.request_id)) {
        sendPlace(claim, 1);
        return;
    }
    const bool in_list = wait_list_.placeOf(claim.client, claim.request_id) != 0;
    auto refusal = mayTake(claim);
    if (refusal.ok()) {
        grantWhenStanding(std::move(claim), proto::TAKE);
        return;
    }
    const bool held_back =
        !holds && (refusal.code == RefusalCode::AlreadyHeld || refusal.code == RefusalCode::Reserved);
    if (held_back && request.force()) {
        const auto by = named(claim.client);
        takeOver(claim, proto::TAKE,
                 {RefusalCode::RevokedLease, by + " took it over" + because(request.reason()), by});
        return;
    }
    // A copy of a request whose answer has just been told.
    if (held_back && request.ask() && !request.wait() &&
        hand_over_.wasClosedFor(claim.client, claim.request_id))
        return;
    if (held_back && request.ask() && !in_list && holder() != nullptr && !lease_.orphaned()) {
        refusal = hand_over_.mayAsk(named(*holder()));
        if (refusal.ok()) {
            askHolder(claim, request.wait(), request.reason());
            return;
        }
    }
    if (held_back && (request.wait() || in_list)) {
        refusal = wait_list_.mayJoin(claim.client, claim.request_id);
        if (refusal.ok()) {
            const auto place = wait_list_.join(claim, turn_.now());
            sendPlace(claim, place);
            return;
        }
    }
    reply(claim.client, claim.request_id, proto::TAKE, refusal);
}

void Ownership::reserve(const Incident& incident, const Claim& claim) {
    const auto& request = incident.body->check_out();
    if (waitsForStandstill(claim, proto::RESERVE)) return;
    auto refusal = mayTake(claim);
    const bool holds = holder() != nullptr && holder()->id == claim.client.id && !lease_.orphaned();
    // By force nothing happens to the holder before the commit: all or none.
    if (request.force() && !holds) {
        if (waiting_grant_ && waiting_grant_->phase != proto::RESUME_LEASE)
            dropWaitingGrant({RefusalCode::Reserved,
                              named(claim.client) + " takes it over" + because(request.reason()),
                              named(claim.client)});
        refusal = {};
    }
    if (refusal.ok()) {
        const auto asked = request.reserve_s();
        Duration time = kReserveDefault;
        if (asked > 0)
            time = asked >= std::chrono::duration<double>(kReserveMax).count() ? kReserveMax
                                                                               : fromSeconds(asked);
        lease_.reserve(claim.client, claim.request_id, turn_.now() + time);
    }
    reply(claim.client, claim.request_id, proto::RESERVE, refusal);
}

void Ownership::commit(const Incident& incident, const Claim& claim) {
    if (waitsForStandstill(claim, proto::COMMIT)) return;
    if (holder() != nullptr && holder()->id == claim.client.id && !lease_.orphaned() &&
        lease_.held()->request_id == claim.request_id) {
        sendGrant(proto::COMMIT);
        return;
    }
    if (const auto refusal = lease_.mayCommit(claim.client, claim.request_id); !refusal.ok()) {
        reply(claim.client, claim.request_id, proto::COMMIT, refusal);
        return;
    }
    if (lease_.held()) {
        const auto by = named(claim.client);
        takeOver(claim, proto::COMMIT,
                 {RefusalCode::RevokedLease,
                  by + " took it over" + because(incident.body->check_out().reason()), by});
        return;
    }
    grantWhenStanding(claim, proto::COMMIT);
}

/// Of a lease, a reservation, a place or a question of exactly this request. What is not there is aborted
/// already.
void Ownership::abort(const Incident& incident) {
    const auto& sender = incident.head->sender;
    const auto& id = incident.body->check_out().request_id();
    const Refusal aborted{RefusalCode::Cancelled, "The check-out was aborted.", {}};
    // Committed here, refused elsewhere: all or none.
    if (holder() != nullptr && holder()->id == sender.id && lease_.held()->request_id == id) {
        Incident ended{Event::ClientEnded, incident.head};
        ended.cause = StopCause::Released;
        ended.reason = {RefusalCode::Stopped, "The check-out was aborted.", {}};
        turn_.fire(ended);
    }
    if (lease_.reservedFor(sender, id)) lease_.dropReservation();
    if (waiting_grant_ && waiting_grant_->claim.client.id == sender.id &&
        waiting_grant_->claim.request_id == id)
        dropWaitingGrant(aborted);
    if (wait_list_.leave(sender, id)) reply(sender, id, proto::TAKE, aborted);
    if (hand_over_.isOpenFor(sender, id)) {
        tellQuestion(*hand_over_.take(), true);
        reply(sender, id, proto::TAKE, aborted);
    }
    reply(sender, id, proto::ABORT, {});
}

/// The key alone proves it: the holder has lost its session, and this is another one.
void Ownership::resume(const Incident& incident) {
    const auto& request = incident.body->check_out();
    const auto& sender = incident.head->sender;
    const Claim claim{sender, request.request_id(), {}};
    const auto refuseWith = [&](const Refusal& refusal) {
        reply(sender, claim.request_id, proto::RESUME_LEASE, refusal);
    };
    if (request.resume().key().size() != kKeySize) {
        refuseWith({RefusalCode::Malformed,
                    "resume must have the epoch, the number and the 16 bytes of the key of the lease.",
                    {}});
        return;
    }
    if (waitsForStandstill(claim, proto::RESUME_LEASE)) return;
    const LeaseNumber number{static_cast<std::int32_t>(request.resume().epoch()),
                             static_cast<std::int32_t>(request.resume().number())};
    if (const auto refusal = lease_.mayResume(number, request.resume().key()); !refusal.ok()) {
        refuseWith(refusal);
        return;
    }
    const auto before = *lease_.held();
    if (!lease_.orphaned()) {
        if (before.holder.id == sender.id) {  // it has it already
            lease_.resume(sender, claim.request_id);
            sendGrant(proto::RESUME_LEASE);
            if (hand_over_.open()) tellQuestion(*hand_over_.open(), false);
            return;
        }
        if (settings_.grace == Duration::zero()) {
            refuseWith({RefusalCode::NotSupported,
                        "No lease outlives its session here (Axon.LeaseGrace is 0). Check it out anew.",
                        named(before.holder)});
            return;
        }
        // Its loss is not known here yet: it happens now.
        Incident lost{Event::ClientLost};
        lost.cause = StopCause::ClientLost;
        lost.reason = {RefusalCode::ClientLost, named(before.holder) + " has connected anew.", {}};
        others_.loseHolder(lost);
        sendLeaseEnded(before,
                       {RefusalCode::RevokedLease,
                        named(sender) + " has resumed the lease from another session.", named(sender)});
    }
    grantWhenStanding(claim, proto::RESUME_LEASE);
}

/// Never hand over a robot that has not confirmed its last stop.
bool Ownership::mustWaitForStandstill() const {
    return !turn_.stops().standing && !AXON_PLANTED(GrantBeforeStandstill);
}

void Ownership::grantWhenStanding(Claim claim, proto::CheckOutPhase phase) {
    const bool resumes = phase == proto::RESUME_LEASE;
    if (!resumes) wait_list_.leave(claim.client, claim.request_id);
    if (mustWaitForStandstill()) {  // meanwhile it is reserved
        auto until = turn_.now() + kStandstillWait;
        if (waiting_grant_) {  // of a holder that has come back twice the later session counts
            until = waiting_grant_->until;
            dropWaitingGrant({RefusalCode::RevokedLease,
                              named(claim.client) + " has resumed the lease from another session.",
                              named(claim.client)});
        }
        if (!resumes) lease_.reserve(claim.client, claim.request_id, until);
        waiting_grant_ = WaitingGrant{std::move(claim), phase, until};
        return;
    }
    // Who gets it waits for it no longer.
    for (const auto& other : wait_list_.forget(claim.client.id))
        if (other.request_id != claim.request_id)
            reply(
                other.client, other.request_id, proto::TAKE,
                {RefusalCode::AlreadyHeld, "You hold it already, by another request.", named(claim.client)});
    if (hand_over_.open() && hand_over_.open()->claim.client.id == claim.client.id) {
        const auto question = *hand_over_.take();
        reply(question.claim.client, question.claim.request_id, proto::TAKE,
              {RefusalCode::AlreadyHeld, "You hold it already, by another request.", named(claim.client)});
    }
    Incident granted{resumes ? Event::LeaseResumed : Event::CheckOutGranted};
    granted.phase = phase;
    if (resumes)
        lease_.resume(claim.client, claim.request_id);
    else
        lease_.grant(claim);
    taken_.clear();
    journal_.note({.kind = resumes ? JournalRecord::Kind::Resumed : JournalRecord::Kind::Granted,
                   .who = named(claim.client),
                   .client = claim.client.id});
    others_.granted(granted);
    if (resumes && hand_over_.open()) tellQuestion(*hand_over_.open(), false);
}

/// Who held it is told at once; who takes it gets it when the robot stands still.
void Ownership::takeOver(const Claim& claim, proto::CheckOutPhase phase, const Refusal& why) {
    if (const auto question = hand_over_.take())
        reply(question->claim.client, question->claim.request_id, proto::TAKE,
              {RefusalCode::AlreadyHeld, why.message, why.holder});
    if (waiting_grant_) dropWaitingGrant({RefusalCode::Reserved, why.message, why.holder});
    lease_.dropReservation();
    if (lease_.held()) {
        Incident taken{Event::TakenOver};
        taken.cause = StopCause::Released;
        taken.reason = why;
        journal_.note({.kind = JournalRecord::Kind::TakenOver,
                       .who = named(claim.client),
                       .client = claim.client.id,
                       .code = std::string(refusalName(why.code)),
                       .text = why.message});
        taken_ = why.message;
        turn_.fire(taken);
    }
    grantWhenStanding(claim, phase);
}

void Ownership::askHolder(const Claim& claim, bool waits, const std::string& reason) {
    const auto& question = hand_over_.ask(claim, waits, std::string(cutUtf8(reason, kWhyMax)),
                                          lease_.held()->hand_over, turn_.now());
    tellQuestion(question, false);
    sendPlace(claim, 1);
}

void Ownership::tellQuestion(const HandOver::Question& question, bool withdrawn) {
    if (holder() == nullptr) return;
    proto::ToClient message;
    auto& request = *message.mutable_hand_over();
    request.set_request_id(question.claim.request_id);
    request.set_by(named(question.claim.client));
    request.set_reason(question.reason);
    const std::chrono::duration<double> left = question.until - turn_.now();
    request.set_answer_within_s(std::max(0.0, left.count()));
    request.set_yield(question.yield);
    request.set_withdrawn(withdrawn);
    turn_.tell(*holder(), kMsgHandOver, message);
}

void Ownership::considerHandOver(const Incident& incident) {
    if (incident.body->has_hand_over_policy()) {
        const auto policy = policyOf(incident.body->hand_over_policy());
        if (policy)
            lease_.setHandOver(policy.value());
        else
            turn_.refuse(incident, policy.refusal());
        return;
    }
    const auto& said = incident.body->hand_over_answer();
    if (!hand_over_.open() || hand_over_.open()->claim.request_id != said.request_id()) {
        turn_.refuse(incident,
                     {RefusalCode::Expired, "Nobody asks for it with this request (any more).", {}});
        return;
    }
    decideHandOver(*hand_over_.take(), said.accept(), said.reason());
}

void Ownership::decideHandOver(const HandOver::Question& question, bool accepted, const std::string& said) {
    const auto& claim = question.claim;
    const auto whose = holder() != nullptr ? named(*holder()) : std::string("Its holder");
    // An administrator's reservation, or a holder that has just come back, is before it.
    if (accepted && !waiting_grant_ && !lease_.reservation()) {
        takeOver(claim, proto::TAKE,
                 {RefusalCode::RevokedLease,
                  whose + " hands it over to " + named(claim.client) + because(said), named(claim.client)});
        return;
    }
    const auto kept = whose + " keeps it" + because(accepted ? std::string() : said);
    if (question.waits && wait_list_.mayJoin(claim.client, claim.request_id).ok()) {
        const auto place = wait_list_.join(claim, turn_.now());
        sendPlace(claim, place, kept);
        return;
    }
    reply(claim.client, claim.request_id, proto::TAKE, {RefusalCode::HandOverRefused, kept, whose});
}

void Ownership::endWaits() {
    const auto grants = [this](proto::CheckOutPhase phase) {
        return findRow(turn_.state(), phase == proto::RESUME_LEASE ? Event::LeaseResumed
                                                                   : Event::CheckOutGranted) != nullptr;
    };
    if (waiting_grant_ && turn_.stops().standing && grants(waiting_grant_->phase)) {
        auto waiting = *std::exchange(waiting_grant_, std::nullopt);
        grantWhenStanding(std::move(waiting.claim), waiting.phase);
    }
    if (mayEndGrace() && turn_.now() >= *lease_.held()->grace_until) {
        others_.endSpared(orphan_reason_.message);  // held for as long as somebody could come back
        Incident expired{Event::LeaseExpired};
        expired.cause = StopCause::Released;  // the loss itself has stopped and latched; this ends the lease
        expired.reason = orphan_reason_;
        if (settings_.grace > Duration::zero()) {
            auto& text = expired.reason.message;
            if (text.ends_with('.')) text.pop_back();
            text += "; nobody resumed the lease within " + inWords(settings_.grace) + '.';
            expired.reason.code = RefusalCode::Expired;
        }
        turn_.fire(expired);
    }
}

void Ownership::passOn() {
    endWaits();
    others_.takeKeptProfiles();
    if (turn_.state() == EntityState::IDLE && !waiting_grant_ && !lease_.reservation()) {
        // Who asked for this very lease is before those who wait for any: its end answers the question.
        if (const auto question = hand_over_.take())
            grantWhenStanding(question->claim, proto::TAKE);
        else if (!wait_list_.empty() && turn_.stops().standing)
            grantWhenStanding(wait_list_.pop(), proto::TAKE);
    }
    for (const auto& [claim, place] : wait_list_.takeChanges()) sendPlace(claim, place);
}

/// Tasks that outlive the loss of their client hold up the end of its lease, and so does a holder that is
/// back and waits for the robot to stand still.
bool Ownership::mayEndGrace() const {
    return lease_.orphaned() && !others_.finishesAlone() &&
           !(waiting_grant_ && waiting_grant_->phase == proto::RESUME_LEASE);
}

void Ownership::onTimer() {
    const auto now = turn_.now();
    if (waiting_grant_ && now >= waiting_grant_->until)
        dropWaitingGrant(
            {RefusalCode::TimedOut,
             "The robot application has not confirmed its last stop. Look at the robot, then try again.",
             {}});
    lease_.expire(now);
    for (const auto& claim : wait_list_.expire(now))
        reply(claim.client, claim.request_id, proto::TAKE,
              {RefusalCode::Expired,
               "The place was given up: the request was not sent again within " +
                   inWords(WaitList::kRefreshWithin) + '.',
               {}});
    // A holder that is lost cannot answer: its silence is no consent. The end of the lease answers, or it is
    // asked anew.
    const auto silent = lease_.orphaned() ? std::nullopt : hand_over_.expire(now);
    if (silent) {
        tellQuestion(*silent, true);
        decideHandOver(*silent, silent->yield, "it did not answer in time.");
    }
    passOn();
}

TimePoint Ownership::nextDeadline() const {
    auto next = TimePoint::max();
    if (lease_.reservation()) next = std::min(next, lease_.reservation()->until);
    if (waiting_grant_) next = std::min(next, waiting_grant_->until);
    if (mayEndGrace()) next = std::min(next, *lease_.held()->grace_until);
    if (const auto expiry = wait_list_.nextExpiry()) next = std::min(next, *expiry);
    if (hand_over_.open() && !lease_.orphaned()) next = std::min(next, hand_over_.open()->until);
    return next;
}

void Ownership::orphan(const Incident& incident) {
    if (!lease_.held() || lease_.orphaned()) return;
    orphan_reason_ = incident.reason;
    lost_at_ = turn_.now();
    lease_.orphan(turn_.now() + settings_.grace);
    journal_.note({.kind = JournalRecord::Kind::Lost,
                   .who = named(lease_.held()->holder),
                   .client = lease_.held()->holder.id,
                   .text = incident.reason.message});
}

void Ownership::end(const Incident& incident) {
    if (!lease_.held()) return;
    const auto held = *lease_.held();
    const bool own_wish = incident.event == Event::Release || incident.event == Event::ClientEnded;
    // Nothing is left that it could resume.
    if (waiting_grant_ && waiting_grant_->phase == proto::RESUME_LEASE)
        dropWaitingGrant(own_wish
                             ? Refusal{RefusalCode::NotHolder, "The lease has ended: it was released.", {}}
                             : incident.reason);
    const auto reason = own_wish ? Refusal{RefusalCode::Ok, "Released.", {}} : incident.reason;
    if (!AXON_PLANTED(LoserNotTold) || incident.event != Event::TakenOver) sendLeaseEnded(held, reason);
    journal_.note({.kind = JournalRecord::Kind::LeaseEnded,
                   .who = named(held.holder),
                   .client = held.holder.id,
                   .code = std::string(refusalName(reason.code)),
                   .text = reason.message});
    lease_.end(own_wish                                       ? RefusalCode::NotHolder
               : incident.reason.code == RefusalCode::Expired ? RefusalCode::Expired
                                                              : RefusalCode::RevokedLease,
               own_wish ? "it was released." : incident.reason.message);
}

void Ownership::sendLeaseEnded(const LeaseBook::Held& held, const Refusal& reason) {
    proto::ToClient message;
    auto& ended = *message.mutable_lease_ended();
    ended.mutable_lease()->set_epoch(static_cast<std::uint32_t>(held.number.epoch));
    ended.mutable_lease()->set_number(static_cast<std::uint32_t>(held.number.number));
    *ended.mutable_reason() = toProto(reason);
    turn_.tell(held.holder, kMsgRelease, message);
}

void Ownership::dismissWaiting(const Incident& incident) {
    const auto* client = incident.head != nullptr ? &incident.head->sender.id : nullptr;
    const auto concerns = [client](const std::string& id) { return client == nullptr || id == *client; };
    if (lease_.reservation() && concerns(lease_.reservation()->by.id)) lease_.dropReservation();
    if (waiting_grant_ && concerns(waiting_grant_->claim.client.id)) dropWaitingGrant(incident.reason);
    for (const auto& claim : client != nullptr ? wait_list_.forget(*client) : wait_list_.clear())
        reply(claim.client, claim.request_id, proto::TAKE, incident.reason);
    if (hand_over_.open() && concerns(hand_over_.open()->claim.client.id)) {
        const auto question = *hand_over_.take();
        tellQuestion(question, true);
        reply(question.claim.client, question.claim.request_id, proto::TAKE, incident.reason);
    }
}

void Ownership::dropWaitingGrant(const Refusal& reason) {
    const auto waiting = *std::exchange(waiting_grant_, std::nullopt);
    if (lease_.reservedFor(waiting.claim.client, waiting.claim.request_id)) lease_.dropReservation();
    reply(waiting.claim.client, waiting.claim.request_id, waiting.phase, reason);
}

void Ownership::sendGrant(proto::CheckOutPhase phase) {
    const auto& held = *lease_.held();
    proto::ToClient message;
    auto& reply = *message.mutable_check_out();
    reply.set_request_id(held.request_id);
    reply.set_phase(phase);
    reply.mutable_lease()->set_epoch(static_cast<std::uint32_t>(held.number.epoch));
    reply.mutable_lease()->set_number(static_cast<std::uint32_t>(held.number.number));
    reply.mutable_lease()->set_key(held.key.bytes());
    reply.mutable_lease()->set_root(held.root);
    reply.set_grace_ms(static_cast<std::uint32_t>(
        std::chrono::duration_cast<std::chrono::milliseconds>(settings_.grace).count()));
    reply.set_stop_generation(turn_.stops().generation);
    reply.set_latched(turn_.latched());
    *reply.mutable_services() = profiler_.profile();
    reply.set_datagram_endpoint(datagram_endpoint_);
    reply.set_resource_bytes_max(settings_.resource_bytes_max);
    reply.set_direct_endpoint(direct_endpoint_);
    reply.set_direct_signal_endpoint(direct_signal_endpoint_);
    turn_.tell(held.holder, kMsgCheckOut, message);
}

void Ownership::refuse(const Incident& incident, const Refusal& refusal) {
    const auto& request = incident.body->check_out();
    reply(incident.head->sender, request.request_id(), request.phase(), refusal);
}

void Ownership::reply(const Sender& to, const std::string& request_id, proto::CheckOutPhase phase,
                      const Refusal& refusal) {
    proto::ToClient message;
    auto& reply = *message.mutable_check_out();
    reply.set_request_id(request_id);
    reply.set_phase(phase);
    if (!refusal.ok()) *reply.mutable_refusal() = toProto(refusal);
    reply.set_stop_generation(turn_.stops().generation);
    reply.set_latched(turn_.latched());
    turn_.tell(to, kMsgCheckOut, message);
    journal_.noteRefusal(to, {}, refusal);
}

/// Neither granted nor refused: waiting, or the holder has been asked.
void Ownership::sendPlace(const Claim& claim, std::size_t place, const std::string& kept) {
    proto::ToClient message;
    auto& reply = *message.mutable_check_out();
    reply.set_request_id(claim.request_id);
    reply.set_phase(proto::TAKE);
    reply.set_place(static_cast<std::uint32_t>(place));
    reply.set_kept(kept);
    reply.set_stop_generation(turn_.stops().generation);
    reply.set_latched(turn_.latched());
    turn_.tell(claim.client, kMsgCheckOut, message);
}

}  // namespace axon::entity_manager
