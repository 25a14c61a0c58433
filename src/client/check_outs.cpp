// SPDX-License-Identifier: GPL-2.0-or-later
// SessionCore: how leases are come by, handed over, and resumed.
#include <axon/messages.pb.h>

#include <algorithm>

#include "client/content.hpp"
#include "client/session_core.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::client {
namespace {

/// The Entity Manager ends a question to the holder; this is for one that does not answer any more.
constexpr Duration kAskedLongest = std::chrono::seconds{630};
/// What is waited for is looked at this often, should a status have been missed.
constexpr Duration kParkedLook = std::chrono::seconds{5};
/// An entity that has left is back within this, or its lease is lost: its Entity Manager has ended. A router or server that
/// is started anew has its entities back within 1.6 s, as was measured with
/// faults/cluster_faults.py; given up before, they would be nobody's until the grace ends.
constexpr Duration kLeftPatience = std::chrono::milliseconds{2500};

LeaseNumber numberOf(const proto::Lease& lease) {
    return {static_cast<std::int32_t>(lease.epoch()), static_cast<std::int32_t>(lease.number())};
}

/// Refusals that another entity, or the same a little later, may not give.
bool isRace(RefusalCode code) {
    switch (code) {
        case RefusalCode::AlreadyHeld:
        case RefusalCode::Reserved:
        case RefusalCode::Expired:
        case RefusalCode::WrongState:
            return true;
        default:
            return false;
    }
}

/// Likewise of another entity only.
bool isItsOwn(RefusalCode code) {
    switch (code) {
        case RefusalCode::Unavailable:
        case RefusalCode::UnknownEntity:
        case RefusalCode::RobotLost:
        case RefusalCode::NotConnected:
        case RefusalCode::TimedOut:
            return true;
        default:
            return isRace(code);
    }
}

bool serves(const QueryItem& item, const Entity& entity) {
    return (item.category.empty() || equalIgnoringCase(item.category, entity.category)) &&
           (item.type.empty() || equalIgnoringCase(item.type, entity.type));
}

bool isFree(const Entity& entity) {
    return entity.state == EntityState::IDLE && entity.holder.id.empty() && entity.holder.name.empty();
}

proto::HandOverPolicy toProto(const HandOverPolicy& policy) {
    proto::HandOverPolicy message;
    message.set_answer_within_s(std::clamp(policy.answer_within.count(), 0.0, 600.0));
    message.set_yield(policy.yield && !policy.refuse);
    return message;
}

}  // namespace

// ---- what is wanted

Id128 SessionCore::checkOut(const std::vector<std::string>& names, const CheckOutOptions& options,
                            CheckOutDone done) {
    const auto refuse = [&](Refusal why) {
        done(std::move(why));
        return Id128{};
    };
    if (!connected_) return refuse(notConnected());
    CheckOutOrder order;
    for (const auto& name : names) {
        const auto id = names_.resolve(name);
        if (!id) return refuse(id.refusal());
        if (leases_.count(id.value()) != 0) {
            return refuse({RefusalCode::AlreadyHeld, "This client holds " + label(id.value()) + " already.",
                           self_.name});
        }
        if (std::find(order.wanted.begin(), order.wanted.end(), id.value()) != order.wanted.end()) {
            return refuse(
                {RefusalCode::Duplicate, label(id.value()) + " is named twice. Name each entity once.", {}});
        }
        order.wanted.push_back(id.value());
    }
    if (order.wanted.empty()) {
        return refuse(
            {RefusalCode::UnknownEntity, "No entity is named. Name at least one to check out.", {}});
    }
    if (options.ask && options.force) {
        return refuse({RefusalCode::Malformed, "Either ask the holder or take it by force, not both.", {}});
    }
    if (options.ask && order.wanted.size() > 1) {
        return refuse({RefusalCode::NotSupported,
                       "A holder is asked for one entity at a time. Ask for each by itself.",
                       {}});
    }
    order.options = options;
    return begin(std::move(order), std::move(done));
}

Id128 SessionCore::checkOut(const EntityQuery& query, const CheckOutOptions& options, CheckOutDone done) {
    Refusal why;
    if (!connected_) {
        why = notConnected();
    } else if (options.ask || options.force) {
        why = {RefusalCode::Malformed,
               "A query takes what is free: to ask a holder, or to take by force, name the entity.",
               {}};
    } else if (query.items.empty()) {
        why = {RefusalCode::Malformed, "The query asks for nothing.", {}};
    }
    if (!why.ok()) {
        done(why);
        return {};
    }
    CheckOutOrder order;
    order.query = query;
    order.options = options;
    return begin(std::move(order), std::move(done));
}

void SessionCore::resume(const LeaseTicket& ticket, CheckOutDone done) {
    Refusal why;
    if (!connected_) {
        why = notConnected();
    } else if (const auto known = entity(ticket.entity); !known) {
        why = known.refusal();
    } else if (leases_.count(ticket.entity) != 0) {
        why = {RefusalCode::AlreadyHeld, "This client holds " + label(ticket.entity) + " already.",
               self_.name};
    }
    if (!why.ok()) return done(why);
    CheckOutOrder order;
    order.wanted = {ticket.entity};
    order.resume = ticket;
    begin(std::move(order), std::move(done));
}

Id128 SessionCore::begin(CheckOutOrder order, CheckOutDone done) {
    const auto id = Id128::random(random_);
    const auto now = clock_.now();
    if (order.options.wait) {
        const auto wait = std::clamp(*order.options.wait, Seconds{0}, Seconds{86400});
        order.until = now + std::chrono::duration_cast<Duration>(wait);
    } else if (order.options.ask) {
        order.until = now + kAskedLongest;
    }
    order.done = std::move(done);
    check_outs_.emplace(id, std::move(order));
    attempt(id);
    return id;
}

void SessionCore::giveUp(Id128 check_out) {
    failCheckOut(check_out, {RefusalCode::Cancelled, "The check-out was given up.", {}});
}

void SessionCore::schedule(Id128 id, TimePoint due) {
    auto& order = check_outs_.at(id);
    if (order.due != TimePoint::max()) deadlines_.erase({order.due, {Ask::CheckOut, id}});
    order.due = due;
    if (due != TimePoint::max()) deadlines_.insert({due, {Ask::CheckOut, id}});
}

SessionCore::CheckOutOrder SessionCore::takeOrder(CheckOutOrders::iterator found) {
    const auto id = found->first;
    schedule(id, TimePoint::max());
    forgetAttempt(found->second);
    parked_.erase(id);
    auto order = std::move(found->second);
    check_outs_.erase(found);
    return order;
}

// ---- one attempt

void SessionCore::attempt(Id128 id) {
    auto& order = check_outs_.at(id);
    forgetAttempt(order);
    parked_.erase(id);
    auto chosen = order.wanted;
    if (order.query) {
        if (order.query->needsServices() && look(id)) return;
        chosen.clear();
        const auto assignment = choose(order, false, chosen);
        if (!assignment.complete()) {
            auto why = lacking(order, assignment);
            // Whoever was there and was taken in this very moment may be free again as soon.
            const bool soon = !order.passed_over.empty();
            if (order.options.wait) return park(id, why, soon);
            return failCheckOut(id, std::move(why));
        }
    }
    order.request = Id128::random(random_);
    attempts_[order.request] = id;
    order.several = chosen.size() > 1;
    order.stage = Stage::Asked;
    for (const auto& entity : chosen) {
        order.parties.emplace_back().entity = entity;
        of_entity_[entity].insert({Ask::CheckOut, id});
    }
    schedule(id, clock_.now() + settings_.timeout);
    const int phase = order.resume ? proto::RESUME_LEASE : order.several ? proto::RESERVE : proto::TAKE;
    for (auto& party : order.parties) sendCheckOut(order, party, phase);
}

bool SessionCore::look(Id128 id) {
    auto& order = check_outs_.at(id);
    std::vector<std::string> strangers;
    for (const auto& [entity, known] : entities_) {
        if (!known.announced || !isFree(known.facts) || order.offers.count(entity) != 0) continue;
        const auto wanted = [&facts = known.facts](const QueryItem& item) {
            return !item.service.empty() && serves(item, facts);
        };
        if (std::any_of(order.query->items.begin(), order.query->items.end(), wanted))
            strangers.push_back(entity);
    }
    if (strangers.empty()) return false;
    order.stage = Stage::Looking;
    order.looking = strangers.size();
    schedule(id, TimePoint::max());  // each question has its own time
    for (const auto& entity : strangers) {
        fetchDetails(entity, [this, id, entity](Result<Details> details) {
            const auto found = check_outs_.find(id);
            if (found == check_outs_.end()) return;
            auto& offers = found->second.offers[entity];  // none, where it does not tell
            if (details) {
                for (const auto& service : details->services) {
                    offers.insert(service.name);
                    offers.insert(service.global_id);
                }
            }
            if (--found->second.looking == 0 && connected_) attempt(id);
        });
    }
    return true;
}

Assignment SessionCore::choose(const CheckOutOrder& order, bool optimistic,
                               std::vector<std::string>& chosen) const {
    std::vector<const Entity*> candidates;
    for (const auto& id : names_.ids()) {
        const auto& facts = entities_.at(id).facts;
        if (isFree(facts) && !facts.latched && leases_.count(id) == 0 && order.passed_over.count(id) == 0)
            candidates.push_back(&facts);
    }
    auto assignment =
        assign(*order.query, candidates.size(), [&](const QueryItem& item, std::size_t candidate) {
            const auto& facts = *candidates[candidate];
            if (!serves(item, facts)) return false;
            if (item.service.empty()) return true;
            const auto offers = order.offers.find(facts.id);
            if (offers == order.offers.end()) return optimistic;
            return std::any_of(offers->second.begin(), offers->second.end(), [&](const std::string& name) {
                return equalIgnoringCase(name, item.service);
            });
        });
    for (const auto candidate : assignment.chosen) chosen.push_back(candidates[candidate]->id);
    return assignment;
}

bool SessionCore::wantedAreFree(const CheckOutOrder& order) const {
    if (order.query) {
        std::vector<std::string> chosen;
        return choose(order, true, chosen).complete();
    }
    return std::all_of(order.wanted.begin(), order.wanted.end(), [&](const std::string& id) {
        const auto known = entities_.find(id);
        return known != entities_.end() && isFree(known->second.facts);
    });
}

/// "2 ROBOT/MOBILE: 1 is missing (PeopleBot#1 is held by client2@lab; PeopleBot#2 was stopped: rearm it)".
Refusal SessionCore::lacking(const CheckOutOrder& order, const Assignment& assignment) const {
    Refusal refusal{RefusalCode::Unavailable, {}, {}};
    for (std::size_t i = 0; i < order.query->items.size(); ++i) {
        if (assignment.lacking[i] == 0) continue;
        const auto& item = order.query->items[i];
        std::string others;
        std::size_t unnamed = 0;
        for (const auto& id : names_.ids()) {
            const auto& facts = entities_.at(id).facts;
            if (!serves(item, facts)) continue;
            std::string why;
            if (leases_.count(id) != 0) {
                why = " is held by this client";
            } else if (!facts.holder.name.empty()) {
                why = " is held by " + facts.holder.name;
                if (refusal.holder.empty()) refusal.holder = facts.holder.name;
                refusal.code = RefusalCode::AlreadyHeld;
            } else if (order.passed_over.count(id) != 0) {
                why = " was taken in this moment";
                refusal.code = RefusalCode::AlreadyHeld;
            } else if (facts.state != EntityState::IDLE) {
                why = std::string(" is ") + toString(facts.state);
            } else if (facts.latched) {
                why = " was stopped (check it out by its name and rearm it)";
            } else if (const auto offers = order.offers.find(id);
                       !item.service.empty() && offers != order.offers.end() &&
                       std::none_of(offers->second.begin(), offers->second.end(), [&](const auto& name) {
                           return equalIgnoringCase(name, item.service);
                       })) {
                why = " does not offer " + item.service;
            } else {
                continue;
            }
            if (others.size() > 400) {
                ++unnamed;
            } else {
                others += (others.empty() ? "" : "; ") + label(id) + why;
            }
        }
        if (unnamed > 0) others += "; and " + std::to_string(unnamed) + " more";
        if (!refusal.message.empty()) refusal.message += " ";
        refusal.message += std::to_string(assignment.lacking[i]) + " of " + client::toText(item) + " " +
                           (assignment.lacking[i] == 1 ? "is" : "are") +
                           " missing: " + (others.empty() ? "there is none" : others) + ".";
    }
    return refusal;
}

void SessionCore::sendCheckOut(CheckOutOrder& order, CheckOutParty& party, int phase) {
    proto::ToEntity body;
    auto& request = *body.mutable_check_out();
    request.set_request_id(order.request.bytes());
    request.set_phase(static_cast<proto::CheckOutPhase>(phase));
    // As long as this client may wait for the last of the others.
    if (phase == proto::RESERVE) request.set_reserve_s(Seconds(settings_.timeout).count());
    if (phase != proto::ABORT) {
        request.set_wait(phase == proto::TAKE && order.options.wait && !order.query && !order.options.force);
        request.set_ask(phase == proto::TAKE && order.options.ask);
        request.set_force(order.options.force);
        if (order.options.ask || order.options.force) request.set_reason(order.options.reason);
        if (phase == proto::RESUME_LEASE) {
            request.mutable_resume()->set_epoch(static_cast<std::uint32_t>(order.resume->lease.epoch));
            request.mutable_resume()->set_number(static_cast<std::uint32_t>(order.resume->lease.number));
            request.mutable_resume()->set_key(order.resume->key);
        } else {
            *request.mutable_hand_over() = toProto(order.options.hand_over);
            // One for all that this session holds: who is to collaborate must be held under one root.
            if (root_.empty()) root_ = Id128::random(random_).bytes();
            request.set_root(root_);
        }
    }
    party.answered = false;
    by_sequence_.erase(party.sequence);
    party.sequence = send(party.entity, kMsgCheckOut, {}, body);
    if (phase != proto::ABORT) by_sequence_[party.sequence] = {Ask::CheckOut, attempts_.at(order.request)};
}

void SessionCore::forgetAttempt(CheckOutOrder& order) {
    const auto attempt = attempts_.find(order.request);
    if (attempt == attempts_.end()) return;
    const Key key{Ask::CheckOut, attempt->second};
    for (const auto& party : order.parties) {
        by_sequence_.erase(party.sequence);
        const auto of = of_entity_.find(party.entity);
        if (of == of_entity_.end()) continue;
        of->second.erase(key);
        if (of->second.empty()) of_entity_.erase(of);
    }
    attempts_.erase(attempt);
    order.parties.clear();
}

// ---- answers

void SessionCore::onCheckOutReply(const Header& head, const proto::CheckOutReply& reply) {
    const auto request = Id128::fromBytes(reply.request_id());
    const auto refusal = toRefusal(reply.refusal());
    const auto number = numberOf(reply.lease());
    const bool grants = refusal.ok() && reply.has_lease() &&
                        (reply.phase() == proto::TAKE || reply.phase() == proto::COMMIT ||
                         reply.phase() == proto::RESUME_LEASE);
    marks_.raise(head.entity, static_cast<std::int32_t>(reply.stop_generation()));
    if (request && onResumeReply(head.entity, *request, reply)) return;

    const auto attempt = request ? attempts_.find(*request) : attempts_.end();
    CheckOutParty* party = nullptr;
    if (attempt != attempts_.end()) {
        for (auto& p : check_outs_.at(attempt->second).parties) {
            if (p.entity == head.entity) party = &p;
        }
    }
    if (party == nullptr) {
        // Granted too late: nobody waits for it any more, and nobody else could have it.
        const auto mine = leases_.find(head.entity);
        const bool known = mine != leases_.end() && mine->second.number == number;
        if (grants && !known) sendRelease({head.entity, number});
        return;
    }
    const auto id = attempt->second;
    auto& order = check_outs_.at(id);
    const auto expected = order.resume                       ? proto::RESUME_LEASE
                          : !order.several                   ? proto::TAKE
                          : order.stage == Stage::Committing ? proto::COMMIT
                                                             : proto::RESERVE;
    if (party->answered || (reply.phase() != expected && reply.phase() != proto::CHECK_OUT_UNSPECIFIED))
        return;
    if (!refusal.ok()) {
        party->answered = true;
        party->refused = true;
        onPartyRefused(id, head.entity, refusal);
        return;
    }
    if (expected == proto::TAKE && !grants && (order.options.wait || order.options.ask)) {
        if (!reply.kept().empty()) order.kept = reply.kept();
        onWaiting(id, static_cast<int>(reply.place()));
        return;
    }
    party->answered = true;
    if (expected != proto::RESERVE) {
        if (!grants) {
            failCheckOut(
                id,
                {RefusalCode::Internal, label(head.entity) + " granted a check-out without a lease.", {}});
            return;
        }
        party->granted = true;
        party->lease = number;
        grant(head.entity, reply, order.options.hand_over);
    }
    advanceCheckOut(id);
}

void SessionCore::grant(const std::string& entity, const proto::CheckOutReply& reply,
                        const HandOverPolicy& policy) {
    Lease lease;
    lease.number = numberOf(reply.lease());
    lease.key = reply.lease().key();
    if (const auto before = leases_.find(entity); lease.key.empty() && before != leases_.end())
        lease.key = before->second.key;  // of a lease that is resumed
    lease.root = reply.lease().root();
    // Of another process, whose other leases may follow: what is checked out from now on belongs to them.
    if (leases_.empty() && lease.root.size() == 16) root_ = lease.root;
    lease.name = label(entity);
    lease.services = reply.services();
    lease.grace = std::chrono::milliseconds(reply.grace_ms());
    lease.resource_bytes_max = reply.resource_bytes_max();
    lease.policy = policy;
    observer_.onDatagrams({entity, lease.number}, reply.datagram_endpoint(), lease.key);
    observer_.onDirect({entity, lease.number}, reply.direct_endpoint(), reply.direct_signal_endpoint(), lease.key);
    leases_[entity] = std::move(lease);
    auto& facts = entities_[entity].facts;
    facts.stop_generation = static_cast<std::int32_t>(reply.stop_generation());
    marks_.take(entity, facts.stop_generation);
    facts.latched = reply.latched();
    countMoving(entity);
    pace();
}

void SessionCore::advanceCheckOut(Id128 id) {
    auto& order = check_outs_.at(id);
    const bool all = std::all_of(order.parties.begin(), order.parties.end(),
                                 [](const CheckOutParty& party) { return party.answered; });
    if (!all) return;
    if (order.several && order.stage != Stage::Committing) {
        order.stage = Stage::Committing;
        schedule(id, clock_.now() + settings_.timeout);
        for (auto& party : order.parties) sendCheckOut(order, party, proto::COMMIT);
        return;
    }
    // All or none: what was granted first may be gone by the time that the last is granted.
    for (const auto& party : order.parties) {
        if (lease({party.entity, party.lease}) != nullptr) continue;
        failCheckOut(id, {RefusalCode::RevokedLease,
                          label(party.entity) + " was lost before the others were granted.",
                          {}});
        return;
    }
    std::vector<Held> granted;
    for (const auto& party : order.parties) granted.push_back({party.entity, party.lease});
    takeOrder(check_outs_.find(id)).done(std::move(granted));
}

void SessionCore::onPartyRefused(Id128 id, const std::string& entity, const Refusal& why) {
    auto& order = check_outs_.at(id);
    for (auto& party : order.parties) {
        if (party.entity == entity) party.refused = true;
    }
    if (order.query && isItsOwn(why.code)) {
        endAttempt(order, why);
        order.passed_over.insert(entity);
        return attempt(id);
    }
    auto named = why;
    if (order.several) named.message = label(entity) + ": " + why.message;
    if (order.several && order.options.wait && isRace(why.code)) {
        endAttempt(order, why);
        return park(id, named, true);
    }
    failCheckOut(id, std::move(named));
}

void SessionCore::endAttempt(CheckOutOrder& order, const Refusal& why) {
    auto parties = order.parties;
    for (auto& party : parties) {
        if (party.granted) {
            endLease(party.entity, why, false);
            if (connected_) sendRelease({party.entity, party.lease});
        } else if (!order.resume && !party.refused && connected_) {
            sendCheckOut(order, party, proto::ABORT);
        }
    }
    forgetAttempt(order);
}

void SessionCore::failCheckOut(Id128 id, Refusal why) {
    const auto found = check_outs_.find(id);
    if (found == check_outs_.end()) return;
    endAttempt(found->second, why);
    takeOrder(found).done(why);
}

// ---- waiting

void SessionCore::onWaiting(Id128 id, int place) {
    auto& order = check_outs_.at(id);
    const auto& entity = order.parties.front().entity;
    if (order.stage != Stage::Queued) {
        order.stage = Stage::Queued;
        schedule(id, std::min(order.until, clock_.now() + settings_.wait_refresh));
    }
    order.place = place;
    const auto known = entities_.find(entity);
    const auto holder = known == entities_.end() ? std::string() : known->second.facts.holder.name;
    std::string message;
    if (!order.kept.empty())
        message = order.kept.substr(0, order.kept.find_last_not_of('.') + 1);
    else if (order.options.ask)
        message = (holder.empty() ? "The holder of " + label(entity) : holder) + " has been asked";
    if (order.options.wait) {
        message += (message.empty() ? "Place " : "; place ") + std::to_string(place) +
                   " in the wait list of " + label(entity);
        if (!holder.empty() && (!order.options.ask || !order.kept.empty()))
            message += ", which is held by " + holder;
    }
    tellWaiting(order, {entity, place, message + "."});
}

void SessionCore::tellWaiting(CheckOutOrder& order, Waiting waiting) {
    if (order.told == waiting.message) return;
    order.told = waiting.message;
    if (order.options.on_waiting) order.options.on_waiting(waiting);
}

void SessionCore::park(Id128 id, const Refusal& why, bool soon) {
    auto& order = check_outs_.at(id);
    forgetAttempt(order);
    order.stage = Stage::Parked;
    order.last = why;
    order.passed_over.clear();
    parked_.insert(id);
    auto due = clock_.now() + kParkedLook;
    if (soon) {
        // Two who want the same things must not step on each other's toes for ever.
        std::uint32_t dice = 0;
        random_.fill(&dice, sizeof dice);
        due = clock_.now() + settings_.retry + settings_.retry * (dice % 1000) / 1000;
        if (!wantedAreFree(order)) due = clock_.now() + kParkedLook;
    }
    schedule(id, std::min(order.until, due));
    tellWaiting(order, {{}, 0, "Waiting. " + why.message});
}

void SessionCore::wakeParked() {
    if (parked_.empty()) return;
    const auto soon = clock_.now() + settings_.retry * 2;
    for (const auto id : std::vector(parked_.begin(), parked_.end())) {
        const auto& order = check_outs_.at(id);
        // One that is about to be looked at anyway had lost a race.
        if (order.due <= soon || !wantedAreFree(order)) continue;
        attempt(id);
    }
}

void SessionCore::onCheckOutDue(Id128 id) {
    auto& order = check_outs_.at(id);
    const auto now = clock_.now();
    switch (order.stage) {
        case Stage::Looking:
            break;
        case Stage::Queued: {
            if (now >= order.until) {
                const auto& entity = order.parties.front().entity;
                const auto known = entities_.find(entity);
                const auto holder =
                    known == entities_.end() ? std::string() : known->second.facts.holder.name;
                failCheckOut(id, {RefusalCode::TimedOut,
                                  !order.options.wait
                                      ? "Nobody has answered the request for " + label(entity) + " in time."
                                      : label(entity) +
                                            " has not become free in time; the place in its wait list was " +
                                            std::to_string(order.place) + ".",
                                  holder});
                return;
            }
            schedule(id, std::min(order.until, now + settings_.wait_refresh));
            // A question need not be repeated: its Entity Manager remembers it, or has answered.
            if (order.options.wait) sendCheckOut(order, order.parties.front(), proto::TAKE);
            break;
        }
        case Stage::Parked:
            if (now >= order.until) {
                auto why = order.last;
                why.code = RefusalCode::TimedOut;
                why.message = "The time to wait is up. " + why.message;
                return failCheckOut(id, std::move(why));
            }
            if (wantedAreFree(order)) return attempt(id);
            schedule(id, std::min(order.until, now + kParkedLook));
            break;
        case Stage::Asked:
        case Stage::Committing: {
            std::vector<std::string> silent;
            std::string names;
            for (const auto& party : order.parties) {
                if (party.answered) continue;
                silent.push_back(party.entity);
                names += (names.empty() ? "" : ", ") + label(party.entity);
            }
            const Refusal late{
                RefusalCode::TimedOut,
                "No answer from " + names + " to the check-out in time; nothing was checked out.",
                {}};
            if (order.query && order.stage == Stage::Asked) {
                endAttempt(order, late);
                order.passed_over.insert(silent.begin(), silent.end());
                return attempt(id);
            }
            failCheckOut(id, late);
            break;
        }
    }
}

// ---- hand-over

std::optional<HandOverRequest> SessionCore::question(const Held& held) const {
    const auto* mine = lease(held);
    if (mine == nullptr || !mine->question) return std::nullopt;
    auto question = *mine->question;
    question.answer_within = std::max(Seconds(mine->answer_until - clock_.now()), Seconds(0));
    return question;
}

void SessionCore::onHandOver(const std::string& entity, const proto::HandOverRequest& request) {
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
        observer_.onHandOver(held, question);
        return;
    }
    const bool known = lease.question && lease.asked_by == request.request_id();
    lease.question = question;
    lease.answer_until = clock_.now() + std::chrono::duration_cast<Duration>(question.answer_within);
    lease.asked_by = request.request_id();
    if (lease.policy.refuse) {
        static_cast<void>(answerHandOver(held, false, "Its holder does not hand it over.").ok());
    } else if (!known) {
        observer_.onHandOver(held, question);
    }
}

Result<void> SessionCore::answerHandOver(const Held& held, bool accept, std::string_view reason) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return refusal;
    auto& mine = *lease(held);
    if (!mine.question) {
        return Refusal{RefusalCode::WrongState, "Nobody asks for " + label(held.entity) + " (any more).", {}};
    }
    if (!isUtf8(reason)) return Refusal{RefusalCode::Malformed, "A reason must be UTF-8.", {}};
    proto::ToEntity body;
    auto& message = *body.mutable_hand_over_answer();
    message.set_request_id(mine.asked_by);
    message.set_accept(accept);
    message.set_reason(std::string(reason));
    send(held.entity, kMsgHandOver, held.lease, body);
    mine.question.reset();
    mine.asked_by.clear();
    return {};
}

Result<void> SessionCore::setHandOverPolicy(const Held& held, const HandOverPolicy& policy) {
    const auto refusal = ready(held);
    if (!refusal.ok()) return refusal;
    lease(held)->policy = policy;
    proto::ToEntity body;
    *body.mutable_hand_over_policy() = toProto(policy);
    send(held.entity, kMsgHandOver, held.lease, body);
    return {};
}

// ---- leases that outlive a connection

bool SessionCore::orphaned(const Held& held) const {
    const auto* mine = lease(held);
    return mine != nullptr && mine->orphaned;
}

void SessionCore::orphan(const std::string& entity, bool left, const std::string& reason) {
    auto& mine = leases_.at(entity);
    const auto now = clock_.now();
    if (mine.orphaned && !mine.left) {
        // Its time runs from the first loss.
        if (const auto found = pending_.find({Ask::Resume, mine.resume}); found != pending_.end())
            postpone(found, mine.expires);
        return;
    }
    const bool is_new = !mine.orphaned;
    mine.orphaned = true;
    mine.left = left;
    mine.expires = now + (left ? std::min(mine.grace, kLeftPatience)
                               : mine.grace + std::max(settings_.loss_notice, watchdogs_.idle));
    mine.question.reset();
    mine.asked_by.clear();
    if (is_new) {
        mine.resume = Id128::random(random_);
        Pending pending;
        pending.entity = entity;
        pending.lease = mine.number;
        pending.deadline = mine.expires;
        await(Ask::Resume, mine.resume, std::move(pending));
        observer_.onOrphaned({entity, mine.number}, reason);
    } else {
        postpone(pending_.find({Ask::Resume, mine.resume}), mine.expires);
    }
}

void SessionCore::sendResume(const std::string& entity) {
    const auto found = leases_.find(entity);
    if (found == leases_.end() || !found->second.orphaned) return;
    const auto& mine = found->second;
    const auto pending = pending_.find({Ask::Resume, mine.resume});
    if (pending == pending_.end()) return;
    proto::ToEntity body;
    auto& request = *body.mutable_check_out();
    request.set_request_id(mine.resume.bytes());
    request.set_phase(proto::RESUME_LEASE);
    request.mutable_resume()->set_epoch(static_cast<std::uint32_t>(mine.number.epoch));
    request.mutable_resume()->set_number(static_cast<std::uint32_t>(mine.number.number));
    request.mutable_resume()->set_key(mine.key);
    by_sequence_.erase(pending->second.sequence);
    pending->second.sequence = send(entity, kMsgCheckOut, {}, body);
    by_sequence_[pending->second.sequence] = pending->first;
    postpone(pending, std::min(mine.expires, clock_.now() + settings_.timeout));
}

void SessionCore::onResumeDue(Id128 id) {
    const auto pending = pending_.find({Ask::Resume, id});
    const auto entity = pending->second.entity;
    const auto& mine = leases_.at(entity);
    if (clock_.now() < mine.expires) {
        postpone(pending, mine.expires);
        if (connected_ && names_.contains(entity)) sendResume(entity);
        return;
    }
    const Refusal why =
        mine.left && connected_
            ? Refusal{RefusalCode::Unavailable,
                      mine.name + " has left: its Entity Manager is no longer connected to the server.",
                      {}}
        : connected_
            ? Refusal{RefusalCode::Expired, mine.name + " could not be resumed within its grace.", {}}
            : Refusal{RefusalCode::NotConnected,
                      "The connection to the server was not back in time to resume " + mine.name + ".",
                      {}};
    endLease(entity, why, true);
}

bool SessionCore::onResumeReply(const std::string& entity, Id128 id, const proto::CheckOutReply& reply) {
    const auto pending = pending_.find({Ask::Resume, id});
    if (pending == pending_.end() || pending->second.entity != entity) return false;
    auto refusal = toRefusal(reply.refusal());
    auto& mine = leases_.at(entity);
    if (refusal.ok() && reply.has_lease() && numberOf(reply.lease()) != mine.number) {
        refusal = {RefusalCode::Internal, mine.name + " resumed another lease than the one asked for.", {}};
        sendRelease({entity, numberOf(reply.lease())});
    }
    if (!refusal.ok()) {
        endLease(entity, refusal, true);
        return true;
    }
    const Held held{entity, mine.number};
    const auto policy = mine.policy;
    take(pending);
    grant(entity, reply, policy);
    leases_.at(entity).number = held.lease;
    observer_.onResumed(held);
    askAfterTasks(held);
    askAfterRuns(held);
    return true;
}

void SessionCore::askAfterTasks(const Held& held) {
    auto open = openTasks(held);
    if (open.empty()) return;
    const auto id = Id128::random(random_);
    proto::ToEntity body;
    body.mutable_status_request()->set_request_id(id.bytes());
    Pending pending;
    pending.entity = held.entity;
    pending.lease = held.lease;
    pending.tasks = std::move(open);
    pending.sequence = send(held.entity, kMsgStatus, held.lease, body);
    await(Ask::Tasks, id, std::move(pending));
}

Result<LeaseTicket> SessionCore::ticket(const Held& held) const {
    const auto* mine = lease(held);
    if (mine == nullptr) return notHolder(held);
    if (mine->key.size() != 16) {
        return Refusal{RefusalCode::NotSupported, mine->name + " has given no key for its lease.", {}};
    }
    return LeaseTicket{held.entity, held.lease, mine->key};
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
