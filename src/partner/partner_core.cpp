// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/partner_core.hpp"

#include <algorithm>
#include <utility>
#include <vector>

#include "common/laboratory_name.hpp"
#include "common/rights.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"
#include "partner/translation.hpp"

namespace axon::partner {
namespace {

/// Of a session in which nothing may move: a fifth of a client's idle watchdog, and less.
constexpr Duration kIdleBeat = std::chrono::seconds{1};
/// Silences of a server at home, in its own heartbeats.
constexpr int kBeatsMissed = 5;

Duration milliseconds(std::int32_t count) {
    return std::chrono::milliseconds{std::clamp(count, 10, 600'000)};
}

void setRefusal(proto::ToClient& answer, const Refusal& refusal) {
    auto& its = answer.has_check_out() ? *answer.mutable_check_out()->mutable_refusal()
                                       : *answer.mutable_reply()->mutable_refusal();
    its = toProto(refusal);
}

}  // namespace

void PartnerCore::start() {
    openStops();
    watch_again_ = clock_.now();
}

void PartnerCore::openStops() {
    stops_again_ = TimePoint::max();
    stops_ = ++last_session_;
    there_.open(stops_, settings_.home, TherePort::Use::Stops);
}

void PartnerCore::endStops() {
    signals_.noStopBy(stops_);
    if (stops_ != 0) there_.drop(std::exchange(stops_, 0));
    stops_heard_.reset();
    if (!stopped_) stops_again_ = clock_.now() + stops_backoff_.next();
}

void PartnerCore::openWatch() {
    watch_again_ = TimePoint::max();
    watch_ = ++last_session_;
    there_.open(watch_, settings_.home, TherePort::Use::Watch);
}

void PartnerCore::stop() {
    stopped_ = true;
    watch_again_ = TimePoint::max();
    while (!visitors_.empty()) end(std::string(visitors_.begin()->first), Ending::Orderly, {});
    while (!entities_.empty()) hide(std::string(entities_.begin()->first));
    for (const auto session : {watch_, stops_}) signals_.noStopBy(session);
    stops_again_ = TimePoint::max();
    if (watch_ != 0) there_.leave(std::exchange(watch_, 0));
    if (stops_ != 0) there_.leave(std::exchange(stops_, 0));
    watcher_ = {};
}

PartnerCore::Shown* PartnerCore::ofThere(const std::string& entity) {
    const auto found = entities_.find(entity);
    return found == entities_.end() ? nullptr : &found->second;
}

PartnerCore::Shown* PartnerCore::ofHome(const std::string& entity) {
    const auto found = there_of_.find(entity);
    return found == there_of_.end() ? nullptr : ofThere(found->second);
}

PartnerCore::Visitor* PartnerCore::visitorOf(SessionNumber session) {
    const auto client = clients_of_.find(session);
    if (client == clients_of_.end()) return nullptr;
    return &visitors_.at(client->second);
}

// The sessions there.

void PartnerCore::onOpened(SessionNumber session, const Sender& me, const client::Watchdogs& watchdogs) {
    const auto now = clock_.now();
    if (session == stops_) {
        stops_heard_ = std::make_unique<Liveness>(watchdogs.busy, watchdogs.idle, now);
        stops_beats_at_ = now;
        stops_backoff_.reset();
        stops_noted_ = false;
        return there_.stopsBy(session, false);
    }
    if (session == watch_) {
        watcher_ = me;
        if (stops_ == 0) stops_again_ = now;
        there_.stopsBy(session, true);
        watched_ = std::make_unique<Liveness>(watchdogs.busy, watchdogs.idle, now);
        watch_beats_at_ = now;
        backoff_.reset();
        last_failure_.clear();
        note_("watching laboratory " + settings_.laboratory + " as " + inQuotes(me.name) + ", " +
              toString(me.role));
        return;
    }
    auto* visitor = visitorOf(session);
    if (visitor == nullptr) return;
    visitor->me = me;
    visitor->server = std::make_unique<Liveness>(watchdogs.busy, watchdogs.idle, now);
    visitor->beats_at = now;
    holders_[me.id] = visitor->client;
    there_.visits(session, visitor->client);
    auto waiting = std::exchange(visitor->waiting, {});
    visitor->waiting_bytes = 0;
    for (auto& message : waiting) pass(*visitor, std::move(message));
}

void PartnerCore::onRefused(SessionNumber session, const Refusal& refusal) {
    if (session == stops_) {
        stops_ = 0;  // there is none that could be ended
        if (!watcher_.id.empty() && !std::exchange(stops_noted_, true))
            note_("laboratory " + settings_.laboratory +
                  " gives no session for stops of clients without one (" + refusal.message +
                  "); of each of them, at most " + std::to_string(SignalRelay::kSharedOfOne) +
                  " stops in a second are passed on until it does");
        return endStops();
    }
    if (session == watch_) {
        if (last_failure_ != refusal.message) {
            last_failure_ = refusal.message;
            note_("no session in laboratory " + settings_.laboratory + " (" + refusal.message +
                  "); trying again until there is one");
        }
        watch_ = 0;
        hideAll();  // told before it failed
        if (!stopped_) watch_again_ = clock_.now() + backoff_.next();
        return;
    }
    const auto* visitor = visitorOf(session);
    if (visitor == nullptr) return;
    auto its = refusal;
    its.message = "Laboratory " + settings_.laboratory + " does not let this client in: " + refusal.message;
    end(std::string(visitor->client.id), Ending::Lost, its);
}

void PartnerCore::onClosed(SessionNumber session, const std::string& reason) {
    if (session == stops_) return endStops();
    if (session == watch_) return lose(reason);
    const auto* visitor = visitorOf(session);
    if (visitor == nullptr) return;
    end(std::string(visitor->client.id), Ending::Lost, lostSession(reason));
}

Refusal PartnerCore::lostSession(const std::string& why) const {
    return {RefusalCode::OutcomeUnknown,
            "The session of this client in laboratory " + settings_.laboratory +
                " was lost while it was under way: " + why,
            {}};
}

void PartnerCore::lose(const std::string& why) {
    if (stopped_) return;
    const bool was_up = !watcher_.id.empty();
    const auto session = std::exchange(watch_, 0);
    watcher_ = {};
    signals_.noStopBy(session);
    if (session != 0) there_.drop(session);
    const Refusal lost{RefusalCode::OutcomeUnknown,
                       "Laboratory " + settings_.laboratory + " was lost while it was under way: " + why,
                       {}};
    while (!visitors_.empty()) end(std::string(visitors_.begin()->first), Ending::Lost, lost);
    hideAll();
    if (was_up) note_("laboratory " + settings_.laboratory + " is lost: " + why);
    watch_again_ = clock_.now() + backoff_.next();
}

void PartnerCore::hideAll() {
    while (!entities_.empty()) hide(std::string(entities_.begin()->first));
    hidden_.clear();
    limit_noted_ = false;
    more_ = false;
    list_at_ = TimePoint::max();
}

void PartnerCore::onHeartbeat(SessionNumber session) {
    const auto now = clock_.now();
    if (session == watch_) {
        if (watched_) watched_->heard(now);
    } else if (session == stops_) {
        if (stops_heard_) stops_heard_->heard(now);
    } else if (auto* visitor = visitorOf(session); visitor != nullptr && visitor->server) {
        visitor->server->heard(now);
    }
}

void PartnerCore::onProfile(SessionNumber session, Presence presence, const Registration& registration,
                            std::string_view profile) {
    onHeartbeat(session);
    if (session != watch_ || stopped_) return;
    const auto& there = registration.entity;
    if (presence == Presence::Left) {
        hidden_.erase(there);
        return hide(there);
    }
    const auto name = nameAtHome(settings_.laboratory, registration.name);
    if (!name) {
        if (hidden_.size() < kEntities && hidden_.insert(there).second)
            note_("the entity " + inQuotes(registration.name) + " is not shown: expected a name without '" +
                  std::string(1, kLaboratorySeparator) +
                  "', which a laboratory has in the names of its own partners' entities, and short enough");
        return hide(there);
    }
    if (!entities_.contains(there) && entities_.size() >= kEntities) {
        more_ = true;
        if (!std::exchange(limit_noted_, true))
            note_("laboratory " + settings_.laboratory + " has more than " + std::to_string(kEntities) +
                  " entities: " + inQuotes(registration.name) +
                  " and more are not shown until one of those that are has left");
        return;
    }
    proto::BasicProfile its;
    if (!profile.empty() && !its.ParseFromArray(profile.data(), static_cast<int>(profile.size()))) return;
    auto [found, joined] = entities_.try_emplace(there);
    auto& shown = found->second;
    if (joined) {
        shown.names = {there, home_.uuidAtHome(there), *name};
        there_of_[shown.names.home] = there;
    }
    shown.names.name = *name;
    shown.registration = registration;
    shown.registration.entity = shown.names.home;
    shown.registration.name = *name;
    shown.registration.server.clear();
    shown.profile = std::move(its);
    if (!profile.empty()) {
        shown.profile.set_entity_id(shown.names.home);
        shown.profile.set_name(*name);
    }
    if (joined) return home_.join(shown.names);
    if (shown.up) show(shown);
}

void PartnerCore::hide(const std::string& there) {
    const auto found = entities_.find(there);
    if (found == entities_.end()) return;
    const auto home = found->second.names.home;
    there_of_.erase(home);
    entities_.erase(found);
    for (auto& [client, visitor] : visitors_) {
        visitor.check_outs.erase(there);
        visitor.watches.erase(there);
        visitor.granted.erase(there);
        if (visitor.busy.contains(there)) paceOf(&visitor, there, false);
    }
    if (more_ && list_at_ == TimePoint::max()) list_at_ = clock_.now() + kListAgain;
    home_.leave(home);
}

void PartnerCore::listAgain() {
    Header head;
    head.msg_type = kMsgStatus;
    head.sent_at_us = toMicroseconds(clock_.now());
    more_ = !there_.send(watch_, client::Operation::Request, head, {});
    list_at_ = more_ ? clock_.now() + kListAgain : TimePoint::max();
}

void PartnerCore::onStatus(SessionNumber session, const EntityStatus& status) {
    onHeartbeat(session);
    if (session != watch_) return;
    auto* shown = ofThere(status.entity);
    if (shown == nullptr) return;
    const auto before = shown->status ? shown->status->holder.id : std::string{};
    shown->status = status;
    if (shown->up) tellStatus(*shown);
    if (before != status.holder.id) paceOf(visitorThere(before), status.entity, false);
    paceOf(visitorThere(status.holder.id), status.entity, status.state == EntityState::BUSY);
}

PartnerCore::Visitor* PartnerCore::visitorThere(const std::string& id) {
    const auto client = holders_.find(id);
    if (client == holders_.end()) return nullptr;
    const auto found = visitors_.find(client->second.id);
    return found == visitors_.end() || found->second.me.id != id ? nullptr : &found->second;
}

Sender PartnerCore::holderAtHome(const Sender& there) const {
    if (there.id.empty()) return {};
    if (const auto found = holders_.find(there.id); found != holders_.end()) return found->second;
    return {home_.strangerAtHome(there.id), there.name, there.role};
}

void PartnerCore::show(Shown& entity) {
    home_.show(entity.registration, entity.profile);
}

void PartnerCore::tellStatus(const Shown& entity) {
    if (!entity.status) return;
    auto its = *entity.status;
    its.entity = entity.names.home;
    its.holder = holderAtHome(its.holder);
    its.stop_latency_us = 0;  // a server measures those of its own entities
    its.server.clear();
    home_.tellStatus(its);
}

void PartnerCore::paceOf(Visitor* visitor, const std::string& there, bool busy) {
    if (visitor == nullptr || !visitor->server) return;
    if (busy)
        visitor->busy.insert(there);
    else
        visitor->busy.erase(there);
    const auto now = clock_.now();
    const bool any = !visitor->busy.empty();
    if (any && !visitor->server->busy()) visitor->server->heard(now);
    visitor->server->setBusy(any, now);
}

bool PartnerCore::engaged(const Visitor& visitor) {
    return !visitor.check_outs.empty() || !visitor.watches.empty() || !visitor.granted.empty() ||
           !visitor.busy.empty();
}

bool PartnerCore::engagedWith(const Visitor& visitor, const std::string& there) {
    return visitor.check_outs.contains(there) || visitor.watches.contains(there) ||
           visitor.granted.contains(there) || visitor.busy.contains(there);
}

void PartnerCore::noteAsked(Visitor& visitor, const std::string& there, const proto::ToEntity& asked) {
    if (asked.has_check_out() && asked.check_out().phase() != proto::ABORT)
        visitor.check_outs[there] = asked.check_out().request_id();
    if (asked.has_release()) visitor.granted.erase(there);  // the rest when it has ended
    if (!asked.has_watch()) return;
    const auto& watch = asked.watch();
    if (watch.on()) {
        auto& streams = visitor.watches[there];
        if (watch.streams().empty()) streams = {std::string{}};
        for (const auto& stream : watch.streams()) streams.insert(stream);
        if (streams.size() > kStreams) streams = {std::string{}};
    } else if (const auto its = visitor.watches.find(there); its != visitor.watches.end()) {
        for (const auto& stream : watch.streams()) its->second.erase(stream);
        if (watch.streams().empty() || its->second.empty()) visitor.watches.erase(its);
    }
}

void PartnerCore::noteNotGranted(Visitor& visitor, const std::string& there, const std::string& request_id) {
    if (visitor.granted.contains(there)) return;
    if (const auto its = visitor.check_outs.find(there);
        its != visitor.check_outs.end() && its->second == request_id)
        visitor.check_outs.erase(its);
}

bool PartnerCore::withdraw(Visitor& visitor, const std::string& there) {
    const auto say = [&](const char* type, LeaseNumber held, const proto::ToEntity& message) {
        Waiting its;
        its.head.entity = there;
        its.head.msg_type = type;
        its.head.held = held;
        its.head.sent_at_us = toMicroseconds(clock_.now());
        its.bytes = message.SerializeAsString();
        if (!visitor.me.id.empty())
            return there_.send(visitor.session, client::Operation::ToEntity, its.head, std::move(its.bytes));
        visitor.waiting_bytes += its.bytes.size();
        visitor.waiting.push_back(std::move(its));
        return true;
    };
    bool said = true;
    proto::ToEntity message;
    if (const auto granted = visitor.granted.find(there); granted != visitor.granted.end()) {
        message.mutable_release();
        said = say(kMsgRelease, granted->second, message);
        visitor.granted.erase(granted);
    } else if (const auto asked = visitor.check_outs.find(there); asked != visitor.check_outs.end()) {
        message.mutable_check_out()->set_request_id(asked->second);
        message.mutable_check_out()->set_phase(proto::ABORT);
        said = say(kMsgCheckOut, {}, message);
    }
    visitor.check_outs.erase(there);
    if (visitor.watches.erase(there) == 0) return said;
    message.mutable_watch()->set_on(false);
    return say(kMsgWatch, {}, message) && said;
}

void PartnerCore::onEntityMsg(SessionNumber session, Lane lane, bool droppable, const Header& head,
                              std::string_view bytes) {
    onHeartbeat(session);
    const auto* shown = ofThere(head.entity);
    if (shown == nullptr) return;
    auto its = head;
    its.entity = shown->names.home;
    proto::ToClient message;
    if (!droppable && !message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
    if (session == stops_ || session == watch_) {
        // Of stops that went by it; what else comes there is for nobody.
        if (droppable || !message.has_receipt()) return;
        const auto client = signals_.translate(*message.mutable_receipt());
        if (!client) return;
        its.sender = *client;
        return home_.toClient(lane, its, message.SerializeAsString());
    }
    auto* visitor = visitorOf(session);
    if (visitor == nullptr || visitor->me.id.empty()) return;
    its.sender = visitor->client;
    if (droppable) return home_.toClientDataSeq(its, std::string(bytes));
    const bool changed = translate(*shown, *visitor, lane, message);
    home_.toClient(lane, its, changed ? message.SerializeAsString() : std::string(bytes));
}

bool PartnerCore::translate(const Shown& entity, Visitor& visitor, Lane lane, proto::ToClient& message) {
    const auto& there = entity.names.there;
    if (message.has_receipt()) return signals_.translate(*message.mutable_receipt()).has_value();
    if (message.has_reply() && lane == Lane::Signal) {
        const auto origin = signals_.originOf(message.reply().request_id());
        if (!origin) return false;
        message.mutable_reply()->set_request_id(SignalId{origin->client.id, origin->sequence}.text());
        return true;
    }
    if (message.has_service()) {
        message.mutable_service()->set_entity_id(entity.names.home);
        return true;
    }
    if (message.has_status() && message.status().services_size() > 0) {
        for (auto& service : *message.mutable_status()->mutable_services())
            service.set_entity_id(entity.names.home);
        return true;
    }
    if (message.has_lease_ended()) {
        visitor.granted.erase(there);
        visitor.check_outs.erase(there);
    }
    if (!message.has_check_out()) return false;
    auto& reply = *message.mutable_check_out();
    const bool refused = reply.has_refusal() && reply.refusal().code() != proto::OK;
    if (reply.has_lease()) {
        visitor.granted[there] = {static_cast<std::int32_t>(reply.lease().epoch()),
                                  static_cast<std::int32_t>(reply.lease().number())};
        visitor.check_outs[there] = reply.request_id();
    } else if (refused || reply.phase() == proto::ABORT) {
        noteNotGranted(visitor, there, reply.request_id());
    }
    // They lead past this gateway, to where the client is nobody.
    reply.clear_datagram_endpoint();
    reply.clear_direct_endpoint();
    reply.clear_direct_signal_endpoint();
    for (auto& service : *reply.mutable_services()->mutable_services())
        service.set_entity_id(entity.names.home);
    return true;
}

void PartnerCore::onRefusal(SessionNumber session, const Header& head, const Refusal& refusal) {
    onHeartbeat(session);
    const auto* shown = ofThere(head.entity);
    if (shown == nullptr) return;
    auto* visitor = visitorOf(session);
    if (visitor == nullptr) return;
    if (head.msg_type == client::kMsgReset || head.msg_type == client::kMsgClear) {
        proto::ToClient answer;
        answer.mutable_reply()->set_request_id(SignalId{visitor->client.id, head.sequence}.text());
        setRefusal(answer, refusal);
        return tell(*shown, visitor->client, kMsgReply, Lane::Signal, answer);
    }
    const auto asked = std::find_if(visitor->asked.rbegin(), visitor->asked.rend(), [&](const Asked& one) {
        return one.sequence == head.sequence && one.there == head.entity;
    });
    if (asked == visitor->asked.rend()) return;
    refuse(*shown, visitor->client, asked->answer, refusal);
}

void PartnerCore::tell(const Shown& entity, const Sender& client, const char* type, Lane lane,
                       const proto::ToClient& message) {
    Header head;
    head.sender = client;
    head.entity = entity.names.home;
    head.msg_type = type;
    if (entity.status) {
        head.held = entity.status->held;
        head.stop_generation = entity.status->stop_generation;
    }
    head.sent_at_us = toMicroseconds(clock_.now());
    home_.toClient(lane, head, message.SerializeAsString());
}

void PartnerCore::refuse(const Shown& entity, const Sender& client, proto::ToClient answer,
                         const Refusal& refusal) {
    setRefusal(answer, refusal);
    if (const auto visitor = visitors_.find(client.id); visitor != visitors_.end() && answer.has_check_out())
        noteNotGranted(visitor->second, entity.names.there, answer.check_out().request_id());
    tell(entity, client, answer.has_check_out() ? kMsgCheckOut : kMsgReply, Lane::Data, answer);
}

// The entity sessions at home.

void PartnerCore::onHomeUp(const std::string& entity) {
    auto* shown = ofHome(entity);
    if (shown == nullptr) return;
    shown->up = true;
    shown->server = std::make_unique<Liveness>(
        kBeatsMissed * milliseconds(shown->registration.heartbeat_busy_ms),
        kBeatsMissed * milliseconds(shown->registration.heartbeat_idle_ms), clock_.now());
    show(*shown);
    tellStatus(*shown);
}

void PartnerCore::onHomeDown(const std::string& entity, const std::string& reason) {
    auto* shown = ofHome(entity);
    if (shown == nullptr || !shown->up) return;
    shown->up = false;
    // Nobody tells these clients from now on whether they still live.
    std::vector<std::string> lost;
    for (const auto& [client, visitor] : visitors_)
        if (engagedWith(visitor, shown->names.there)) lost.push_back(client);
    for (const auto& client : lost) end(client, Ending::Lost, {});
    if (!lost.empty())
        note_("the server at home is lost (" + reason + "): " + std::to_string(lost.size()) +
              " of its clients left laboratory " + settings_.laboratory);
}

void PartnerCore::onHomeHeartbeat(const std::string& entity) {
    if (auto* shown = ofHome(entity); shown != nullptr && shown->server) shown->server->heard(clock_.now());
}

void PartnerCore::onClientMsg(const std::string& entity, bool droppable, const Header& head,
                              std::string bytes) {
    auto* shown = ofHome(entity);
    if (shown == nullptr || stopped_) return;
    const auto found = visitors_.find(head.sender.id);
    auto* visitor = found == visitors_.end() ? nullptr : &found->second;
    Waiting message{head, std::move(bytes), droppable};
    message.head.entity = shown->names.there;
    message.head.sender = {};
    if (droppable) {
        // An Entity Manager carries out whatever is in it, so only what no role is asked about passes unread;
        // that the body is what the type says, the Entity Manager sees to.
        if (head.msg_type == kMsgRaw && visitor != nullptr && !visitor->me.id.empty())
            pass(*visitor, std::move(message));
        return;
    }
    proto::ToEntity asked;
    if (!asked.ParseFromString(message.bytes))
        return refuse(
            *shown, head.sender, refused({}, {}),
            {RefusalCode::Malformed, "The message could not be read as an axon.proto.ToEntity.", {}});
    const auto& there = shown->names.there;
    const auto its =
        visitor != nullptr ? visitor->granted.find(there) : std::map<std::string, LeaseNumber>::iterator{};
    const bool holds = visitor != nullptr && its != visitor->granted.end() && its->second == head.held;
    const auto account = visitor != nullptr && !visitor->me.id.empty() ? visitor->me.role : watcher_.role;
    auto answer = refused(asked, {});
    if (const auto why = mayNotPass(asked, head.sender.role, account, holds); !why.ok())
        return refuse(*shown, head.sender, std::move(answer), why);
    if (visitor == nullptr) {
        if (rightOf(asked.body_case())->who == Who::Holder)
            return refuse(*shown, head.sender, std::move(answer),
                          {RefusalCode::NotHolder,
                           "This client does not hold " + shown->names.name + ": check it out first.",
                           {}});
        visitor = admit(head.sender);
        if (visitor == nullptr)
            return refuse(*shown, head.sender, std::move(answer),
                          {RefusalCode::Overloaded,
                           std::to_string(settings_.visitors_max) + " clients use entities of laboratory " +
                               settings_.laboratory +
                               " already, which is as many as it admits; try again when one has left",
                           {}});
    }
    visitor->used = clock_.now();
    noteAsked(*visitor, there, asked);
    visitor->asked.push_back({head.sequence, there, std::move(answer)});
    if (visitor->asked.size() > kAsked) visitor->asked.pop_front();
    if (!visitor->me.id.empty()) return pass(*visitor, std::move(message));
    if (visitor->waiting.size() >= kWaitingMessages ||
        visitor->waiting_bytes + message.bytes.size() > kWaitingBytes) {
        return refuse(*shown, head.sender, visitor->asked.back().answer,
                      {RefusalCode::Overloaded,
                       "The session of this client in laboratory " + settings_.laboratory +
                           " is being opened, and too much waits for it already. Send more slowly.",
                       {}});
    }
    visitor->waiting_bytes += message.bytes.size();
    visitor->waiting.push_back(std::move(message));
}

PartnerCore::Visitor* PartnerCore::admit(const Sender& client) {
    if (visitors_.size() >= settings_.visitors_max) return nullptr;
    auto& visitor = visitors_[client.id];
    visitor.client = client;
    visitor.session = ++last_session_;
    visitor.used = clock_.now();
    clients_of_[visitor.session] = client.id;
    there_.open(visitor.session, displayName(settings_.home, client.name), TherePort::Use::Visit);
    return &visitor;
}

void PartnerCore::pass(Visitor& visitor, Waiting message) {
    const auto operation =
        message.droppable ? client::Operation::ToEntityDataSeq : client::Operation::ToEntity;
    if (message.head.msg_type == kMsgTask) {  // its short watchdog may begin before it hears of that
        there_.keepAlive(visitor.session, ++visitor.beats);
        visitor.beats_at = clock_.now() + kTurn;
    }
    const auto sequence = message.head.sequence;
    const auto there = message.head.entity;
    if (there_.send(visitor.session, operation, message.head, std::move(message.bytes)) || message.droppable)
        return;
    const auto* shown = ofThere(there);
    const auto asked = std::find_if(visitor.asked.rbegin(), visitor.asked.rend(), [&](const Asked& one) {
        return one.sequence == sequence && one.there == there;
    });
    if (shown == nullptr || asked == visitor.asked.rend()) return;
    refuse(*shown, visitor.client, asked->answer,
           {RefusalCode::Overloaded,
            "Too much waits for the server of laboratory " + settings_.laboratory + ". Send more slowly.",
            {}});
}

void PartnerCore::onClientUpdate(const std::string& entity, const std::string& client, ClientChange change) {
    const auto* shown = ofHome(entity);
    const auto found = visitors_.find(client);
    if (shown == nullptr || found == visitors_.end()) return;
    if (change == ClientChange::Lost) return end(client, Ending::Lost, {});
    // A client that leaves is told of for each entity that it has asked, and one whose rights have become
    // less for that entity only: what it uses besides goes on.
    const bool withdrawn = withdraw(found->second, shown->names.there);
    if (withdrawn && engaged(found->second)) return;
    end(client, Ending::Orderly,
        {RefusalCode::OutcomeUnknown,
         "The server of this laboratory ended the use of " + shown->names.name + " while this was under way.",
         {}});
}

void PartnerCore::onClientFlood(const std::string& entity, const Sender& client, proto::ToClient answer) {
    if (const auto* shown = ofHome(entity))
        refuse(*shown, client, std::move(answer),
               {RefusalCode::Overloaded,
                "Too much of this client waits for the gateway to laboratory " + settings_.laboratory +
                    ". Send more slowly.",
                {}});
}

void PartnerCore::onCommandOfStranger(const std::string& entity, const Header& head) {
    const auto* shown = ofHome(entity);
    if (shown == nullptr) return;
    proto::ToClient answer;
    answer.mutable_reply()->set_request_id(SignalId{head.sender.id, head.sequence}.text());
    setRefusal(answer, {RefusalCode::NotHolder,
                        "This client does not hold " + shown->names.name + ": check it out first.",
                        {}});
    tell(*shown, head.sender, kMsgReply, Lane::Signal, answer);
}

void PartnerCore::end(const std::string& client, Ending ending, const Refusal& why) {
    const auto found = visitors_.find(client);
    if (found == visitors_.end()) return;
    auto visitor = std::move(found->second);
    visitors_.erase(found);
    clients_of_.erase(visitor.session);
    signals_.end(client);
    if (!visitor.me.id.empty()) gone_holders_.push_back(visitor.me.id);
    if (gone_holders_.size() > kHolders) {
        holders_.erase(gone_holders_.front());
        gone_holders_.pop_front();
    }
    ending == Ending::Orderly ? there_.leave(visitor.session) : there_.drop(visitor.session);
    if (why.ok()) return;
    // Whatever was answered already is settled at the client, who does not look at another answer.
    for (auto& asked : visitor.asked)
        if (const auto* shown = ofThere(asked.there))
            refuse(*shown, visitor.client, std::move(asked.answer), why);
}

void PartnerCore::onTimer() {
    const auto now = clock_.now();
    if (stopped_) return;
    if (now >= stops_again_) openStops();
    // Whoever sees a robot may stop it: first the session for that, or a refusal of it.
    if (now >= watch_again_ && (stops_heard_ || stops_ == 0)) openWatch();
    if (stops_heard_ && stops_heard_->expired(now)) endStops();
    if (stops_heard_ && now >= stops_beats_at_) {
        there_.keepAlive(stops_, ++stops_beats_);
        stops_beats_at_ = now + kIdleBeat;
    }
    if (!watcher_.id.empty()) {
        if (watched_->expired(now)) return lose("its server has been silent for too long");
        if (now >= watch_beats_at_) {
            there_.keepAlive(watch_, ++watch_beats_);
            watch_beats_at_ = now + kIdleBeat;
        }
        if (now >= list_at_) listAgain();
    }
    std::vector<std::string> idle, mute;
    for (auto& [client, visitor] : visitors_) {
        if (visitor.me.id.empty()) continue;
        if (visitor.server->expired(now)) {
            mute.push_back(client);
            continue;
        }
        const bool wants = engaged(visitor);
        if (!wants && now - visitor.used >= kIdle) idle.push_back(client);
        if (now < visitor.beats_at) continue;
        there_.keepAlive(visitor.session, ++visitor.beats);
        visitor.beats_at = now + (wants ? kTurn : kIdleBeat);
    }
    for (const auto& client : idle) end(client, Ending::Orderly, {});
    for (const auto& client : mute)
        end(client, Ending::Lost, lostSession("its server was silent for too long"));
    std::vector<std::string> silent;
    for (auto& [there, shown] : entities_) {
        if (!shown.up) continue;
        shown.server->setBusy(shown.status && shown.status->state == EntityState::BUSY, now);
        if (shown.server->expired(now)) silent.push_back(shown.names.home);
    }
    for (const auto& entity : silent) {
        onHomeDown(entity, "it has been silent for too long");
        home_.renew(entity);
    }
}

}  // namespace axon::partner
