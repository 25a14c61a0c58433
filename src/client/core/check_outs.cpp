// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/check_outs.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "client/core/content.hpp"
#include "client/core/entities.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::client {
namespace {

/// The Entity Manager ends a question to the holder; this is for one that does not answer any more.
constexpr Duration kAskedLongest = std::chrono::seconds{630};
/// What is waited for is looked at this often, should a status have been missed.
constexpr Duration kParkedLook = std::chrono::seconds{5};
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

}  // namespace

Id128 CheckOuts::checkOut(const std::vector<std::string>& names, const CheckOutOptions& options, Done done) {
    const auto refuse = [&](Refusal why) {
        done(std::move(why));
        return Id128{};
    };
    if (!parts_.context.connected) return refuse(CoreContext::notConnected());
    Order order;
    for (const auto& name : names) {
        const auto id = parts_.entities.resolve(name);
        if (!id) return refuse(id.refusal());
        if (parts_.leases.of(id.value()) != nullptr) {
            return refuse({RefusalCode::AlreadyHeld,
                           "This client holds " + parts_.entities.label(id.value()) + " already.",
                           parts_.context.self.name});
        }
        if (std::find(order.wanted.begin(), order.wanted.end(), id.value()) != order.wanted.end()) {
            return refuse({RefusalCode::Duplicate,
                           parts_.entities.label(id.value()) + " is named twice. Name each entity once.",
                           {}});
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

Id128 CheckOuts::checkOut(const EntityQuery& query, const CheckOutOptions& options, Done done) {
    Refusal why;
    if (!parts_.context.connected) {
        why = CoreContext::notConnected();
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
    Order order;
    order.query = query;
    order.options = options;
    return begin(std::move(order), std::move(done));
}

void CheckOuts::resume(const LeaseTicket& ticket, Done done) {
    Refusal why;
    if (!parts_.context.connected) {
        why = CoreContext::notConnected();
    } else if (const auto known = parts_.entities.entity(ticket.entity); !known) {
        why = known.refusal();
    } else if (parts_.leases.of(ticket.entity) != nullptr) {
        why = {RefusalCode::AlreadyHeld,
               "This client holds " + parts_.entities.label(ticket.entity) + " already.",
               parts_.context.self.name};
    }
    if (!why.ok()) return done(why);
    Order order;
    order.wanted = {ticket.entity};
    order.resume = ticket;
    begin(std::move(order), std::move(done));
}

Id128 CheckOuts::begin(Order order, Done done) {
    const auto id = Id128::random(parts_.context.random);
    const auto now = parts_.context.clock.now();
    if (order.options.wait) {
        const auto wait = std::clamp(*order.options.wait, Seconds{0}, Seconds{86400});
        order.until = now + std::chrono::duration_cast<Duration>(wait);
    } else if (order.options.ask) {
        order.until = now + kAskedLongest;
    }
    order.done = std::move(done);
    orders_.emplace(id, std::move(order));
    attempt(id);
    return id;
}

void CheckOuts::giveUp(Id128 check_out) {
    fail(check_out, {RefusalCode::Cancelled, "The check-out was given up.", {}});
}

void CheckOuts::schedule(Id128 id, TimePoint due) {
    auto& order = orders_.at(id);
    if (order.due != TimePoint::max()) due_.erase({order.due, id});
    order.due = due;
    if (due != TimePoint::max()) due_.insert({due, id});
}

CheckOuts::Order CheckOuts::take(Orders::iterator found) {
    const auto id = found->first;
    schedule(id, TimePoint::max());
    forgetAttempt(found->second);
    parked_.erase(id);
    auto order = std::move(found->second);
    orders_.erase(found);
    return order;
}

void CheckOuts::attempt(Id128 id) {
    auto& order = orders_.at(id);
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
            return fail(id, std::move(why));
        }
    }
    order.request = Id128::random(parts_.context.random);
    attempts_[order.request] = id;
    order.several = chosen.size() > 1;
    order.stage = Stage::Asked;
    for (const auto& entity : chosen) order.parties.emplace_back().entity = entity;
    schedule(id, parts_.context.clock.now() + parts_.context.settings.timeout);
    const int phase = order.resume ? proto::RESUME_LEASE : order.several ? proto::RESERVE : proto::TAKE;
    for (auto& party : order.parties) sendRequest(order, party, phase);
}

bool CheckOuts::look(Id128 id) {
    auto& order = orders_.at(id);
    std::vector<std::string> strangers;
    for (const auto* facts : parts_.entities.announced()) {
        if (!isFree(*facts) || order.offers.count(facts->id) != 0) continue;
        const auto wanted = [&](const QueryItem& item) {
            return !item.service.empty() && serves(item, *facts);
        };
        if (std::any_of(order.query->items.begin(), order.query->items.end(), wanted))
            strangers.push_back(facts->id);
    }
    if (strangers.empty()) return false;
    order.stage = Stage::Looking;
    order.looking = strangers.size();
    schedule(id, TimePoint::max());  // each question has its own time
    for (const auto& entity : strangers) {
        parts_.entities.fetchDetails(entity, [this, id, entity](Result<Details> details) {
            const auto found = orders_.find(id);
            if (found == orders_.end()) return;
            auto& offers = found->second.offers[entity];  // none, where it does not tell
            if (details) {
                for (const auto& service : details->services) {
                    offers.insert(service.name);
                    offers.insert(service.global_id);
                }
            }
            if (--found->second.looking == 0 && parts_.context.connected) attempt(id);
        });
    }
    return true;
}

Assignment CheckOuts::choose(const Order& order, bool optimistic, std::vector<std::string>& chosen) const {
    std::vector<const Entity*> candidates;
    for (const auto* facts : parts_.entities.all()) {
        if (isFree(*facts) && !facts->latched && parts_.leases.of(facts->id) == nullptr &&
            order.passed_over.count(facts->id) == 0)
            candidates.push_back(facts);
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

bool CheckOuts::wantedAreFree(const Order& order) const {
    if (order.query) {
        std::vector<std::string> chosen;
        return choose(order, true, chosen).complete();
    }
    return std::all_of(order.wanted.begin(), order.wanted.end(), [&](const std::string& id) {
        const auto* facts = parts_.entities.facts(id);
        return facts != nullptr && isFree(*facts);
    });
}

/// "2 ROBOT/MOBILE: 1 is missing (PeopleBot#1 is held by client2@lab; PeopleBot#2 was stopped: rearm it)".
Refusal CheckOuts::lacking(const Order& order, const Assignment& assignment) const {
    Refusal refusal{RefusalCode::Unavailable, {}, {}};
    for (std::size_t i = 0; i < order.query->items.size(); ++i) {
        if (assignment.lacking[i] == 0) continue;
        const auto& item = order.query->items[i];
        std::string others;
        std::size_t unnamed = 0;
        for (const auto* known : parts_.entities.all()) {
            const auto& facts = *known;
            const auto& id = facts.id;
            if (!serves(item, facts)) continue;
            std::string why;
            if (parts_.leases.of(id) != nullptr) {
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
                others += (others.empty() ? "" : "; ") + parts_.entities.label(id) + why;
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

void CheckOuts::sendRequest(Order& order, Party& party, int phase) {
    proto::ToEntity body;
    auto& request = *body.mutable_check_out();
    request.set_request_id(order.request.bytes());
    request.set_phase(static_cast<proto::CheckOutPhase>(phase));
    // As long as this client may wait for the last of the others.
    if (phase == proto::RESERVE) request.set_reserve_s(Seconds(parts_.context.settings.timeout).count());
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
            request.set_root(parts_.leases.root());
        }
    }
    party.answered = false;
    by_sequence_.erase(party.sequence);
    parts_.entities.onAskedFor(party.entity);
    party.sequence = parts_.context.send(party.entity, kMsgCheckOut, {}, body);
    if (phase != proto::ABORT) by_sequence_[party.sequence] = attempts_.at(order.request);
}

void CheckOuts::forgetAttempt(Order& order) {
    const auto attempt = attempts_.find(order.request);
    if (attempt == attempts_.end()) return;
    for (const auto& party : order.parties) by_sequence_.erase(party.sequence);
    attempts_.erase(attempt);
    order.parties.clear();
}

void CheckOuts::onReply(const Header& head, const proto::CheckOutReply& reply) {
    const auto request = Id128::fromBytes(reply.request_id());
    const auto refusal = toRefusal(reply.refusal());
    const auto number = fromProto(reply.lease());
    const bool grants = refusal.ok() && reply.has_lease() &&
                        (reply.phase() == proto::TAKE || reply.phase() == proto::COMMIT ||
                         reply.phase() == proto::RESUME_LEASE);

    const auto attempt = request ? attempts_.find(*request) : attempts_.end();
    Party* party = nullptr;
    if (attempt != attempts_.end()) {
        for (auto& p : orders_.at(attempt->second).parties) {
            if (p.entity == head.entity) party = &p;
        }
    }
    if (party == nullptr) {
        // Granted too late: nobody waits for it any more, and nobody else could have it.
        if (grants && !parts_.leases.holds({head.entity, number}))
            parts_.leases.sendRelease({head.entity, number});
        return;
    }
    const auto id = attempt->second;
    auto& order = orders_.at(id);
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
            fail(id, {RefusalCode::Internal,
                      parts_.entities.label(head.entity) + " granted a check-out without a lease.",
                      {}});
            return;
        }
        party->granted = true;
        party->lease = number;
        parts_.leases.grant(head.entity, reply, order.options.hand_over);
    }
    advance(id);
}

void CheckOuts::advance(Id128 id) {
    auto& order = orders_.at(id);
    const bool all = std::all_of(order.parties.begin(), order.parties.end(),
                                 [](const Party& party) { return party.answered; });
    if (!all) return;
    if (order.several && order.stage != Stage::Committing) {
        order.stage = Stage::Committing;
        schedule(id, parts_.context.clock.now() + parts_.context.settings.timeout);
        for (auto& party : order.parties) sendRequest(order, party, proto::COMMIT);
        return;
    }
    // All or none: what was granted first may be gone by the time that the last is granted.
    for (const auto& party : order.parties) {
        if (parts_.leases.holds({party.entity, party.lease})) continue;
        fail(id, {RefusalCode::RevokedLease,
                  parts_.entities.label(party.entity) + " was lost before the others were granted.",
                  {}});
        return;
    }
    std::vector<Held> granted;
    for (const auto& party : order.parties) granted.push_back({party.entity, party.lease});
    take(orders_.find(id)).done(std::move(granted));
}

void CheckOuts::onPartyRefused(Id128 id, const std::string& entity, const Refusal& why) {
    auto& order = orders_.at(id);
    for (auto& party : order.parties) {
        if (party.entity == entity) party.refused = true;
    }
    if (order.query && isItsOwn(why.code)) {
        endAttempt(order, why);
        order.passed_over.insert(entity);
        return attempt(id);
    }
    auto named = why;
    if (order.several) named.message = parts_.entities.label(entity) + ": " + why.message;
    if (order.several && order.options.wait && isRace(why.code)) {
        endAttempt(order, why);
        return park(id, named, true);
    }
    fail(id, std::move(named));
}

void CheckOuts::endAttempt(Order& order, const Refusal& why) {
    auto parties = order.parties;
    for (auto& party : parties) {
        if (party.granted) {
            // It may have been lost or released meanwhile, and checked out again.
            if (!parts_.leases.holds({party.entity, party.lease})) continue;
            parts_.leases.end(party.entity, why, false);
            if (parts_.context.connected) parts_.leases.sendRelease({party.entity, party.lease});
        } else if (!order.resume && !party.refused && parts_.context.connected) {
            sendRequest(order, party, proto::ABORT);
        }
    }
    forgetAttempt(order);
}

void CheckOuts::fail(Id128 id, Refusal why) {
    const auto found = orders_.find(id);
    if (found == orders_.end()) return;
    endAttempt(found->second, why);
    take(found).done(why);
}

void CheckOuts::onLeft(const std::string& entity, const Refusal& why) {
    std::vector<Id128> asked;
    for (const auto& [request, id] : attempts_) {
        const auto& parties = orders_.at(id).parties;
        if (std::any_of(parties.begin(), parties.end(),
                        [&](const Party& party) { return party.entity == entity; }))
            asked.push_back(id);
    }
    std::sort(asked.begin(), asked.end());
    for (const auto id : asked) {
        if (orders_.contains(id)) onPartyRefused(id, entity, why);  // a query looks for another
    }
    // Those that wait for it wait in vain.
    for (const auto id : std::vector(parked_.begin(), parked_.end())) {
        const auto& wanted = orders_.at(id).wanted;
        if (std::find(wanted.begin(), wanted.end(), entity) != wanted.end()) fail(id, why);
    }
}

bool CheckOuts::onRefused(std::int64_t sequence, const std::string& entity, const Refusal& why) {
    const auto sent = by_sequence_.find(sequence);
    if (sent == by_sequence_.end()) return false;
    onPartyRefused(Id128(sent->second), entity, why);
    return true;
}

void CheckOuts::onDisconnected(const Refusal& lost) {
    std::vector<Id128> all;
    for (const auto& [id, order] : orders_) all.push_back(id);
    for (const auto id : all) fail(id, lost);
}

void CheckOuts::onTimer() {
    const auto now = parts_.context.clock.now();
    while (!due_.empty() && due_.begin()->first <= now) onDue(due_.begin()->second);
}

std::string CheckOuts::holderOf(const std::string& entity) const {
    const auto* facts = parts_.entities.facts(entity);
    return facts == nullptr ? std::string() : facts->holder.name;
}

void CheckOuts::onWaiting(Id128 id, int place) {
    auto& order = orders_.at(id);
    const auto& entity = order.parties.front().entity;
    if (order.stage != Stage::Queued) {
        order.stage = Stage::Queued;
        schedule(id,
                 std::min(order.until, parts_.context.clock.now() + parts_.context.settings.wait_refresh));
    }
    order.place = place;
    const auto holder = holderOf(entity);
    std::string message;
    if (!order.kept.empty())
        message = order.kept.substr(0, order.kept.find_last_not_of('.') + 1);
    else if (order.options.ask)
        message =
            (holder.empty() ? "The holder of " + parts_.entities.label(entity) : holder) + " has been asked";
    if (order.options.wait) {
        message += (message.empty() ? "Place " : "; place ") + std::to_string(place) +
                   " in the wait list of " + parts_.entities.label(entity);
        if (!holder.empty() && (!order.options.ask || !order.kept.empty()))
            message += ", which is held by " + holder;
    }
    tellWaiting(order, {entity, place, message + "."});
}

void CheckOuts::tellWaiting(Order& order, Waiting waiting) {
    if (order.told == waiting.message) return;
    order.told = waiting.message;
    if (order.options.on_waiting) order.options.on_waiting(waiting);
}

void CheckOuts::park(Id128 id, const Refusal& why, bool soon) {
    auto& order = orders_.at(id);
    forgetAttempt(order);
    order.stage = Stage::Parked;
    order.last = why;
    order.passed_over.clear();
    parked_.insert(id);
    auto due = parts_.context.clock.now() + kParkedLook;
    if (soon) {
        // Two who want the same things must not step on each other's toes for ever.
        std::uint32_t dice = 0;
        parts_.context.random.fill(&dice, sizeof dice);
        due = parts_.context.clock.now() + parts_.context.settings.retry +
              parts_.context.settings.retry * (dice % 1000) / 1000;
        if (!wantedAreFree(order)) due = parts_.context.clock.now() + kParkedLook;
    }
    schedule(id, std::min(order.until, due));
    tellWaiting(order, {{}, 0, "Waiting. " + why.message});
}

void CheckOuts::wakeParked() {
    if (parked_.empty()) return;
    const auto soon = parts_.context.clock.now() + parts_.context.settings.retry * 2;
    for (const auto id : std::vector(parked_.begin(), parked_.end())) {
        const auto& order = orders_.at(id);
        // One that is about to be looked at anyway had lost a race.
        if (order.due <= soon || !wantedAreFree(order)) continue;
        attempt(id);
    }
}

void CheckOuts::onDue(Id128 id) {
    auto& order = orders_.at(id);
    const auto now = parts_.context.clock.now();
    switch (order.stage) {
        case Stage::Looking:
            break;
        case Stage::Queued: {
            if (now >= order.until) {
                const auto& entity = order.parties.front().entity;
                fail(id, {RefusalCode::TimedOut,
                          !order.options.wait
                              ? "Nobody has answered the request for " + parts_.entities.label(entity) +
                                    " in time."
                              : parts_.entities.label(entity) +
                                    " has not become free in time; the place in its wait list was " +
                                    std::to_string(order.place) + ".",
                          holderOf(entity)});
                return;
            }
            schedule(id, std::min(order.until, now + parts_.context.settings.wait_refresh));
            // A question need not be repeated: its Entity Manager remembers it, or has answered.
            if (order.options.wait) sendRequest(order, order.parties.front(), proto::TAKE);
            break;
        }
        case Stage::Parked:
            if (now >= order.until) {
                auto why = order.last;
                why.code = RefusalCode::TimedOut;
                why.message = "The time to wait is up. " + why.message;
                return fail(id, std::move(why));
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
                names += (names.empty() ? "" : ", ") + parts_.entities.label(party.entity);
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
            fail(id, late);
            break;
        }
    }
}

}  // namespace axon::client
