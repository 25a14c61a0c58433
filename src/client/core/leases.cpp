// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/leases.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "client/core/content.hpp"
#include "client/core/entities.hpp"
#include "client/core/runs.hpp"
#include "client/core/server_watch.hpp"
#include "client/core/tasks.hpp"
#include "common/utf8.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::client {
namespace {

constexpr std::chrono::seconds kLossTold{1};  // the news of a loss come before the robot has waited so long
constexpr std::chrono::milliseconds kResumeAgain{500};

bool leaseIsGone(RefusalCode code) {
    return code == RefusalCode::NotHolder || code == RefusalCode::OlderLease ||
           code == RefusalCode::RevokedLease || code == RefusalCode::WrongEpoch;
}

}  // namespace

std::vector<Held> Leases::held() const {
    std::vector<Held> all;
    for (const auto& [entity, lease] : leases_) all.push_back({entity, lease.number});
    return all;
}

const Lease* Leases::find(const Held& held) const {
    const auto found = leases_.find(held.entity);
    return found != leases_.end() && found->second.number == held.lease ? &found->second : nullptr;
}

const Lease* Leases::of(const std::string& entity) const {
    const auto found = leases_.find(entity);
    return found == leases_.end() ? nullptr : &found->second;
}

bool Leases::orphaned(const Held& held) const {
    const auto* mine = find(held);
    return mine != nullptr && mine->orphaned;
}

Refusal Leases::notHolder(const Held& held) const {
    return {RefusalCode::NotHolder,
            "This client does not hold " + parts_.entities.label(held.entity) +
                ", or no longer does. Check it out first.",
            {}};
}

Refusal Leases::ready(const Held& held) const {
    const auto* mine = find(held);
    if (!parts_.context.connected) return CoreContext::notConnected();
    if (mine == nullptr) return notHolder(held);
    if (mine->orphaned) {
        return {RefusalCode::NotConnected,
                "The connection was lost, and the check-out of " + mine->name +
                    " is not resumed yet. Try again in a moment.",
                {}};
    }
    return {};
}

std::optional<HandOverRequest> Leases::question(const Held& held) const {
    const auto* mine = find(held);
    if (mine == nullptr || !mine->question) return std::nullopt;
    auto question = *mine->question;
    question.answer_within = std::max(Seconds(mine->answer_until - parts_.context.clock.now()), Seconds(0));
    return question;
}

Result<LeaseTicket> Leases::ticket(const Held& held) const {
    const auto* mine = find(held);
    if (mine == nullptr) return notHolder(held);
    if (mine->key.size() != 16) {
        return Refusal{RefusalCode::NotSupported, mine->name + " has given no key for its lease.", {}};
    }
    return LeaseTicket{held.entity, held.lease, mine->key};
}

Result<std::vector<Service>> Leases::services(const Held& held) const {
    const auto* mine = find(held);
    if (mine == nullptr) return notHolder(held);
    std::vector<Service> all;
    for (const auto& service : mine->services.services()) all.push_back(fromProto(service));
    return all;
}

Result<Service> Leases::service(const Held& held, std::string_view name_or_global_id) const {
    const auto* mine = find(held);
    if (mine == nullptr) return notHolder(held);
    const auto index = findServiceIndex(mine->services, name_or_global_id);
    if (!index) return index.refusal();
    return fromProto(mine->services.services(index.value()));
}

std::uint64_t Leases::resourceBytesMax(const Held& held) const {
    const auto* found = find(held);
    return found != nullptr ? found->resource_bytes_max : 0;
}

const std::string& Leases::root() {
    // One for all that this session holds: who is to collaborate must be held under one root.
    if (root_.empty()) root_ = Id128::random(parts_.context.random).bytes();
    return root_;
}

void Leases::grant(const std::string& entity, const proto::CheckOutReply& reply,
                   const HandOverPolicy& policy) {
    Lease lease;
    lease.number = fromProto(reply.lease());
    lease.key = reply.lease().key();
    if (const auto before = leases_.find(entity); lease.key.empty() && before != leases_.end())
        lease.key = before->second.key;  // of a lease that is resumed
    lease.root = reply.lease().root();
    // Of another process, whose other leases may follow: what is checked out from now on belongs to them.
    if (leases_.empty() && lease.root.size() == 16) root_ = lease.root;
    lease.name = parts_.entities.label(entity);
    lease.services = reply.services();
    lease.grace = std::chrono::milliseconds(reply.grace_ms());
    lease.resource_bytes_max = reply.resource_bytes_max();
    lease.policy = policy;
    parts_.context.observer.onDatagrams({entity, lease.number}, reply.datagram_endpoint(), lease.key);
    parts_.context.observer.onDirect({entity, lease.number}, reply.direct_endpoint(),
                                     reply.direct_signal_endpoint(), lease.key);
    leases_[entity] = std::move(lease);
    const auto generation = static_cast<std::int32_t>(reply.stop_generation());
    parts_.context.marks.take(entity, generation);
    parts_.entities.onGranted(entity, generation, reply.latched());
    parts_.server.pace();
}

void Leases::end(std::string entity, const Refusal& why, bool tell) {
    const auto found = leases_.find(entity);
    if (found == leases_.end()) return;
    const Held held{entity, found->second.number};
    leases_.erase(found);
    parts_.context.observer.onDatagrams(held, {}, {});
    parts_.context.observer.onDirect(held, {}, {}, {});
    parts_.entities.countMoving(entity);
    for (const auto key : parts_.requests.of(entity)) {
        auto* pending = parts_.requests.find(key);
        if (pending == nullptr || pending->lease != held.lease) continue;
        const bool ends =
            Requests::visit(*pending, []<class One>(const One&) { return !request::kOutlivesLease<One>; });
        if (ends) parts_.requests.settle(key, why);
    }
    if (tell) {
        const Refusal unknown{RefusalCode::OutcomeUnknown,
                              "The lease ended while it was under way: " + why.message, why.holder};
        parts_.tasks.finishAll(held, unknown);
        parts_.runs.finishAll(held, unknown);
        parts_.context.observer.onLost(held, why);
    }
    parts_.server.pace();
}

void Leases::onLeaseEnded(const std::string& entity, const proto::LeaseEnded& ended) {
    const auto number = fromProto(ended.lease());
    endReleases(entity, [&](LeaseNumber over) { return over == number; });
    if (find({entity, number}) == nullptr) return;
    auto why = toRefusal(ended.reason());
    if (why.ok())
        why = {
            RefusalCode::RevokedLease, "The lease of " + parts_.entities.label(entity) + " has ended.", {}};
    end(entity, why, true);
}

void Leases::onStatus(const EntityStatus& status) {
    const auto label = [&] { return parts_.entities.label(status.entity); };
    const bool mine = status.holder.id == parts_.context.self.id;
    if (const auto* lease = of(status.entity); lease != nullptr) {
        if (status.held > lease->number && !mine) {
            end(status.entity,
                {RefusalCode::RevokedLease, label() + " was given to " + status.holder.name + ".",
                 status.holder.name},
                true);
        } else if (!lease->orphaned && status.holder.id.empty() &&
                   availability(status.state) == Availability::Away) {
            end(status.entity,
                {RefusalCode::Unavailable,
                 label() + " is " + toString(status.state) +
                     (status.reason.empty() ? std::string(".") : ": " + status.reason),
                 {}},
                true);
        } else {
            const bool waits = !lease->orphaned && mine && status.orphaned && status.held == lease->number;
            expectLoss(leases_.at(status.entity), waits);
        }
    }
    if (!mine) endReleases(status.entity, [&](LeaseNumber number) { return status.held >= number; });
}

/// Its Entity Manager waits for us, and we know of no loss. Usually the news of it follow, or that it is over
/// (another has taken it, it is ours again); of news that are lost, only the last state is made up for (ADR
/// 0016).
void Leases::expectLoss(Lease& lease, bool waits) {
    if (!waits) {
        lease.loss_due = TimePoint::max();
    } else if (lease.loss_due == TimePoint::max()) {
        lease.loss_due = parts_.context.clock.now() + kLossTold;
        loss_due_ = std::min(loss_due_, lease.loss_due);
    }
}

void Leases::onTimer() {
    const auto now = parts_.context.clock.now();
    if (now < loss_due_) return;
    loss_due_ = TimePoint::max();
    std::vector<std::string> lost;
    for (const auto& [entity, lease] : leases_) {
        if (lease.loss_due <= now) {
            lost.push_back(entity);
        } else {
            loss_due_ = std::min(loss_due_, lease.loss_due);
        }
    }
    for (const auto& entity : lost) {
        auto& lease = leases_.at(entity);
        lease.loss_due = TimePoint::max();
        if (lease.orphaned) continue;
        onLeft(entity, {RefusalCode::ClientLost,
                        "The servers or the Entity Manager of " + lease.name +
                            " had lost this client for a moment, and the robot was stopped.",
                        {}});
        if (parts_.entities.isThere(entity)) sendResume(entity);
    }
}

void Leases::onRefusal(const std::string& entity, LeaseNumber under, const Refusal& refusal) {
    if (!leaseIsGone(refusal.code) || under == LeaseNumber{}) return;
    if (find({entity, under}) == nullptr) return;
    end(entity, refusal, true);
}

void Leases::onService(const std::string& entity, const proto::Service& service) {
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
    parts_.context.observer.onService({entity, mine->second.number}, fromProto(service));
}

void Leases::sendRelease(const Held& held) {
    proto::ToEntity body;
    body.mutable_release();
    parts_.context.send(held.entity, kMsgRelease, held.lease, body);
}

void Leases::release(const Held& held, Done done) {
    if (orphaned(held)) {
        // Nobody can be told; the Entity Manager ends it when its time is up.
        end(held.entity, {RefusalCode::NotHolder, "It was released.", {}}, false);
        parts_.tasks.finishAll(
            held,
            {RefusalCode::OutcomeUnknown, "Its check-out was released while the connection was lost.", {}});
        parts_.runs.finishAll(held,
                              {RefusalCode::OutcomeUnknown,
                               "The check-out of its master was released while the connection was lost.",
                               {}});
        return done({});
    }
    const auto refusal = ready(held);
    if (!refusal.ok()) return done(refusal);
    proto::ToEntity body;
    body.mutable_release();
    const auto sequence = parts_.context.send(held.entity, kMsgRelease, held.lease, body);
    end(held.entity, {RefusalCode::NotHolder, parts_.entities.label(held.entity) + " was released.", {}},
        false);
    // The entity stops what runs and says so in events of the tasks; without them they become Unknown.
    parts_.tasks.awaitEnds(held);
    parts_.runs.awaitEnds(held);
    parts_.requests.await(Id128::random(parts_.context.random), {.entity = held.entity,
                                                                 .lease = held.lease,
                                                                 .sequence = sequence,
                                                                 .what = request::Release{std::move(done)}});
}

void Leases::endReleases(const std::string& entity, const std::function<bool(LeaseNumber)>& which) {
    for (const auto key : parts_.requests.of(entity)) {
        const auto* pending = parts_.requests.find(key);
        if (pending != nullptr && std::holds_alternative<request::Release>(pending->what) &&
            which(pending->lease))
            parts_.requests.settle(key, {});
    }
}

void Leases::onHandOver(const std::string& entity, const proto::HandOverRequest& request) {
    const auto mine = leases_.find(entity);
    if (mine == leases_.end() || request.request_id().empty()) return;
    auto& lease = mine->second;
    const Held held{entity, lease.number};
    HandOverRequest question{request.by(), request.reason(),
                             Seconds(std::clamp(request.answer_within_s(), 0.0, 600.0)), request.yield(),
                             request.withdrawn()};
    if (question.withdrawn) {
        if (lease.asked_by != request.request_id() || !lease.question) return;
        lease.question.reset();
        lease.asked_by.clear();
        parts_.context.observer.onHandOver(held, question);
        return;
    }
    const bool known = lease.question && lease.asked_by == request.request_id();
    lease.question = question;
    lease.answer_until =
        parts_.context.clock.now() + std::chrono::duration_cast<Duration>(question.answer_within);
    lease.asked_by = request.request_id();
    if (lease.policy.refuse) {
        static_cast<void>(answerHandOver(held, false, "Its holder does not hand it over.").ok());
    } else if (!known) {
        parts_.context.observer.onHandOver(held, question);
    }
}

Result<void> Leases::answerHandOver(const Held& held, bool accept, std::string_view reason) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return refusal;
    auto& mine = leases_.at(held.entity);
    if (!mine.question) {
        return Refusal{RefusalCode::WrongState,
                       "No client asks for " + parts_.entities.label(held.entity) + " at the moment.",
                       {}};
    }
    if (!isUtf8(reason)) return Refusal{RefusalCode::Malformed, "A reason must be UTF-8.", {}};
    proto::ToEntity body;
    auto& message = *body.mutable_hand_over_answer();
    message.set_request_id(mine.asked_by);
    message.set_accept(accept);
    message.set_reason(std::string(reason));
    parts_.context.send(held.entity, kMsgHandOver, held.lease, body);
    mine.question.reset();
    mine.asked_by.clear();
    return {};
}

Result<void> Leases::setHandOverPolicy(const Held& held, const HandOverPolicy& policy) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return refusal;
    leases_.at(held.entity).policy = policy;
    proto::ToEntity body;
    *body.mutable_hand_over_policy() = toProto(policy);
    parts_.context.send(held.entity, kMsgHandOver, held.lease, body);
    return {};
}

/// The connection, or the entity's.
bool Leases::mayOutlive(const Lease& lease) const {
    return parts_.context.settings.resume && lease.grace > Duration{};
}

void Leases::onDisconnected(const Refusal& lost, bool was_connected, bool for_good) {
    for (const auto& one : held()) {
        if (for_good || !mayOutlive(leases_.at(one.entity))) {
            end(one.entity, lost, true);
        } else if (was_connected) {
            orphan(one.entity, false, lost.message);
        }
    }
}

void Leases::onLeft(const std::string& entity, const Refusal& why) {
    // Its Entity Manager may only have lost the server for a moment, or the server may be about to end.
    if (const auto* mine = of(entity); mine != nullptr && mayOutlive(*mine)) {
        orphan(entity, true, why.message);
    } else {
        end(entity, why, true);
    }
}

void Leases::orphan(const std::string& entity, bool left, const std::string& reason) {
    auto& mine = leases_.at(entity);
    const auto now = parts_.context.clock.now();
    if (mine.orphaned && !mine.left) {
        // Its time runs from the first loss.
        if (const auto key = Requests::keyOf<request::ResumeLease>(mine.resume);
            parts_.requests.contains(key))
            parts_.requests.postpone(key, mine.expires);
        return;
    }
    const bool is_new = !mine.orphaned;
    mine.orphaned = true;
    mine.left = left;
    // An entity that has left its server may come back by another one: its own time has begun before.
    mine.expires = now + mine.grace;
    if (!left) mine.expires += std::max(parts_.context.settings.loss_notice, parts_.server.watchdogs().idle);
    mine.question.reset();
    mine.asked_by.clear();
    if (is_new) {
        mine.resume = Id128::random(parts_.context.random);
        parts_.requests.await(mine.resume, {.entity = entity,
                                            .lease = mine.number,
                                            .deadline = mine.expires,
                                            .what = request::ResumeLease{}});
        parts_.context.observer.onOrphaned({entity, mine.number}, reason);
    } else {
        parts_.requests.postpone(Requests::keyOf<request::ResumeLease>(mine.resume), mine.expires);
    }
}

void Leases::sendResumes() {
    for (const auto& [entity, mine] : leases_) {
        if (parts_.entities.isThere(entity)) sendResume(entity);
    }
}

void Leases::sendResume(const std::string& entity) {
    const auto found = leases_.find(entity);
    if (found == leases_.end() || !found->second.orphaned) return;
    const auto& mine = found->second;
    const auto key = Requests::keyOf<request::ResumeLease>(mine.resume);
    if (!parts_.requests.contains(key)) return;
    proto::ToEntity body;
    auto& request = *body.mutable_check_out();
    request.set_request_id(mine.resume.bytes());
    request.set_phase(proto::RESUME_LEASE);
    request.mutable_resume()->set_epoch(static_cast<std::uint32_t>(mine.number.epoch));
    request.mutable_resume()->set_number(static_cast<std::uint32_t>(mine.number.number));
    request.mutable_resume()->set_key(mine.key);
    parts_.entities.onAskedFor(entity);
    parts_.requests.resend(key, parts_.context.send(entity, kMsgCheckOut, {}, body));
    parts_.requests.postpone(
        key, std::min(mine.expires, parts_.context.clock.now() + parts_.context.settings.timeout));
}

void Leases::onResumeDue(Id128 request) {
    const auto key = Requests::keyOf<request::ResumeLease>(request);
    const auto entity = parts_.requests.find(key)->entity;
    const auto& mine = leases_.at(entity);
    if (parts_.context.clock.now() < mine.expires) {
        parts_.requests.postpone(key, mine.expires);
        if (parts_.context.connected && parts_.entities.isThere(entity)) sendResume(entity);
        return;
    }
    const Refusal why =
        mine.left && parts_.context.connected && !parts_.entities.isThere(entity)
            ? Refusal{RefusalCode::Unavailable,
                      mine.name + " has left: its Entity Manager is no longer connected to the server.",
                      {}}
        : parts_.context.connected
            ? Refusal{RefusalCode::Expired, mine.name + " could not be resumed within its grace.", {}}
            : Refusal{RefusalCode::NotConnected,
                      "The connection to the server was not back in time to resume " + mine.name + ".",
                      {}};
    end(entity, why, true);
}

void Leases::onResumeRefused(Id128 request, const std::string& entity) {
    // It is asked when it joins; where it is there already, also without.
    parts_.requests.postpone(Requests::keyOf<request::ResumeLease>(request),
                             std::min(leases_.at(entity).expires, parts_.context.clock.now() + kResumeAgain));
}

bool Leases::onResumeReply(const std::string& entity, Id128 request, const proto::CheckOutReply& reply) {
    const auto key = Requests::keyOf<request::ResumeLease>(request);
    const auto* pending = parts_.requests.find(key);
    if (pending == nullptr || pending->entity != entity) return false;
    auto refusal = toRefusal(reply.refusal());
    auto& mine = leases_.at(entity);
    if (refusal.ok() && reply.has_lease() && fromProto(reply.lease()) != mine.number) {
        refusal = {RefusalCode::Internal, mine.name + " resumed another lease than the one asked for.", {}};
        sendRelease({entity, fromProto(reply.lease())});
    }
    if (!refusal.ok()) {
        end(entity, refusal, true);
        return true;
    }
    const Held held{entity, mine.number};
    const auto policy = mine.policy;
    parts_.requests.take(key);
    grant(entity, reply, policy);
    leases_.at(entity).number = held.lease;
    parts_.context.observer.onResumed(held);
    parts_.tasks.askAfter(held);
    parts_.runs.askAfter(held);
    return true;
}

std::string LeaseTicket::toText() const {
    const auto id = Id128::fromBytes(key);
    return "axon-lease:" + entity + ":" + std::to_string(lease.epoch) + ":" + std::to_string(lease.number) +
           ":" + (id ? id->toString() : std::string());
}

Result<LeaseTicket> LeaseTicket::parse(std::string_view text) {
    const Refusal malformed{
        RefusalCode::Malformed, "Expected a ticket as CheckOut::ticket() gives it (axon-lease:…).", {}};
    std::vector<std::string> parts;
    for (std::size_t begin = 0; begin <= text.size();) {
        const auto end = std::min(text.find(':', begin), text.size());
        parts.emplace_back(text.substr(begin, end - begin));
        begin = end + 1;
    }
    if (parts.size() != 5 || parts[0] != "axon-lease") return malformed;
    const auto entity = Id128::parse(parts[1]);
    const auto key = Id128::parse(parts[4]);
    const auto number = [](const std::string& digits) -> std::int32_t {
        if (digits.empty() || digits.size() > 9 ||
            digits.find_first_not_of("0123456789") != std::string::npos)
            return -1;
        return std::stoi(digits);
    };
    const LeaseNumber lease{number(parts[2]), number(parts[3])};
    if (!entity || !key || lease.epoch < 0 || lease.number < 0) return malformed;
    return LeaseTicket{parts[1], lease, key->bytes()};
}

}  // namespace axon::client
