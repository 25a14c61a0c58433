// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/front_end_core.hpp"

#include <algorithm>
#include <iterator>
#include <mutex>
#include <optional>
#include <string_view>
#include <unordered_set>
#include <utility>

#include "common/heartbeat.hpp"
#include "common/liveness.hpp"
#include "common/planted_bug.hpp"
#include "common/queue_share.hpp"
#include "common/refuse.hpp"
#include "common/rights.hpp"
#include "common/utf8.hpp"
#include "front_end_server/clients/admission.hpp"
#include "front_end_server/clients/client.hpp"
#include "front_end_server/clients/silence.hpp"

namespace axon::front_end_server {

namespace {

constexpr std::size_t kStopsForOne = 16;  // so many entities of a list cost as much as a message

void refuseUnknown(ClientOutbox& to, const Header& head) {
    to.newRefusalMsg(head, unknownEntity(head.entity));
}

std::string sessionsOf(const std::string& user, const FrontEndCoreSettings& settings) {
    return "the user '" + user + "' has " + std::to_string(settings.user_sessions) +
           (settings.user_sessions == 1 ? " session" : " sessions") + ", which is the most";
}

}  // namespace

FrontEndCore::FrontEndCore(FrontEndCoreSettings settings, const Clock& clock, RandomSource& random,
                           EntityTopic& topic, Note note, Wake wake, GlobalServicesPort* global_services,
                           audit::AuditTrail* trail, const users::PresentUsers* users,
                           const Clock* machine_time)
    : settings_(settings),
      clock_(clock),
      machine_time_(machine_time != nullptr ? *machine_time : clock),
      random_(random),
      topic_(topic),
      note_(std::move(note)),
      wake_(std::move(wake)),
      global_services_(global_services),
      users_(users),
      settlement_(clock, topic),
      log_(clock, note_, trail),
      others_(settings.name, random, note_, [this](Lane lane) { announce(lane); }),
      entity_servers_(others_.add({.name = "entity server",
                                   .timeouts = settings.entity_servers,
                                   .reach = [this](const auto& servers) { topic_.reach(servers); },
                                   .left =
                                       [this](const auto& names) {
                                           for (const auto& name : names) {
                                               note_("entity server " + name + " is gone");
                                               forget(name, {});
                                           }
                                       },
                                   .arrived =
                                       [this](const auto& name) {
                                           {
                                               const std::lock_guard lock(mutex_);
                                               entities_.missed().asked(name, clock_.now());
                                           }
                                           ask(name);
                                       }})),
      entities_(alone(), entity_servers_, clock),
      gone_(settings.clients_remembered) {
    if (users_ == nullptr) return;
    for (auto& lane : access_) lane.store(users_->access());
}

FrontEndCore::~FrontEndCore() = default;

const Sender& FrontEndCore::me(const Client& client) {
    return client.me;
}
const std::string& FrontEndCore::token(const Client& client) {
    return client.token;
}
std::size_t FrontEndCore::told(const Client& client) {
    return client.told;
}

Result<FrontEndCore::ClientRef> FrontEndCore::setCallback(const std::string& display_name, Role role,
                                                          std::shared_ptr<ClientOutbox> data,
                                                          const std::string& user) {
    ClientRef client;
    {
        const std::lock_guard lock(mutex_);
        // Here, where usersChanged() finds it from now on: nobody slips in between.
        if (const auto less = lessThan(user, role))
            return refuse(RefusalCode::PermissionDenied,
                          *less + " while the session was being opened; fix: log in again");
        if (clients_.size() >= settings_.clients_max) {
            return refuse(RefusalCode::Overloaded, "the server has its " +
                                                       std::to_string(settings_.clients_max) +
                                                       " clients; raise FrontEndServer.ClientsMax");
        }
        auto share = shareOf(user);
        // Whoever needs one more may need it to stop a robot. A quarter is kept free for the other users, so
        // that one program that opens sessions without end does not keep them from stopping.
        const bool surplus = share && share->sessions - share->surplus >= settings_.user_sessions;
        if (surplus && clients_.size() + settings_.clients_max / 4 >= settings_.clients_max)
            return refuse(
                RefusalCode::Overloaded,
                sessionsOf(user, settings_) +
                    ", and the server keeps its last places for other users; fix: end some, or have "
                    "FrontEndServer.UserSessions raised");
        std::string only_watches;
        if (surplus && role != Role::Observer)
            only_watches = sessionsOf(user, settings_) +
                           ", so this one may only watch and stop; fix: end some and open this one again, or "
                           "have FrontEndServer.UserSessions raised";
        // A name that is no UTF-8 would make every receipt that carries it unreadable.
        std::string name(cutUtf8(validUtf8(display_name), 256));
        const auto origin = alone() ? std::string() : settings_.name + ":" + others_.self().instance + ":";
        // Of version 8: no entity can register under it without a secret that nobody has (ADR 0024).
        auto id = Id128::uuid(random_).toString();
        id[kUserDigits] = '8';
        if (!user.empty()) id.replace(0, kUserDigits, userPart(user));
        Sender me{origin + id, name.empty() ? "unnamed" : std::move(name), surplus ? Role::Observer : role};
        client = std::make_shared<Client>(
            std::move(me), Id128::random(random_).toString(), std::move(data), settings_, clock_.now(), user,
            share, surplus, kStatusesHeld * (phases_++ % kPhases) / kPhases, std::move(only_watches));
        if (share) {
            ++share->sessions;
            if (surplus) ++share->surplus;
            shares_.emplace(user, std::move(share));
        }
        clients_.add(client);
    }
    wake_(Due::OnTimer);
    note_("client " + client->me.name + " joined (" + client->me.id + ")");
    log_.joined(client->me, user);
    if (!client->only_watches.empty())
        client->data->newUpdateMsg(RefusalCode::Overloaded, client->only_watches);
    client->told = pushAll(*client);
    return client;
}

/// Under the mutex: a new one where the user has no session; null where nobody has a name.
std::shared_ptr<UserShare> FrontEndCore::shareOf(const std::string& user) {
    if (user.empty()) return nullptr;
    const auto its = shares_.find(user);
    return its != shares_.end() ? its->second : std::make_shared<UserShare>(settings_);
}

Result<FrontEndCore::ClientRef> FrontEndCore::attach(const std::string& token,
                                                     std::shared_ptr<ClientOutbox> signal) {
    const std::lock_guard lock(mutex_);
    auto client = clients_.takeToken(token);
    if (!client) {
        return refuse(RefusalCode::NotConnected,
                      "no session waits for this token (it is for one use); open a new session and set its "
                      "callback first");
    }
    client->signal.store(std::make_shared<const std::shared_ptr<ClientOutbox>>(std::move(signal)));
    return client;
}

/// All, or those of these names, that the client may see.
Entities::Records FrontEndCore::seenBy(const Client& client, const std::vector<std::string>* names) const {
    Entities::Records now;
    {
        const std::lock_guard lock(mutex_);
        if (names == nullptr) {
            now = entities_.records();
        } else {
            for (const auto& name : *names)
                if (auto record = entities_.find(name)) now.emplace(name, std::move(record));
        }
    }
    const auto lists = access(Lane::Data);
    std::erase_if(now, [&](const auto& one) { return !sees(client, *lists, one.second->registration); });
    return now;
}

// No lock is held while a client is told, so something may change meanwhile and be told by another thread
// first. Therefore again, until what was told is what is: the last word about each entity is then the true
// one.
std::size_t FrontEndCore::pushAll(const Client& client, Entities::Records told,
                                  const std::vector<std::string>* names) {
    auto& to = *client.data;
    while (true) {
        auto now = seenBy(client, names);
        bool changed = false;
        for (const auto& [entity, record] : now) {
            const auto before = told.find(entity);
            bool known = before != told.end();
            if (known && before->second == record) continue;
            changed = true;
            // It has left and joined since: the client is to forget the status that it was told.
            if (known && before->second->heard && !record->heard) {
                to.newBasicPrflMsg(Presence::Left, before->second->registration, {});
                known = false;
            }
            to.newBasicPrflMsg(known ? Presence::Changed : Presence::Joined, record->registration,
                               *record->profile);
            if (record->heard) to.newStatusMsg(record->status);
        }
        for (const auto& [entity, record] : told) {
            if (now.contains(entity)) continue;
            changed = true;
            to.newBasicPrflMsg(Presence::Left, record->registration, {});
        }
        if (!changed)
            return static_cast<std::size_t>(
                std::count_if(now.begin(), now.end(), [](const auto& one) { return one.second->heard; }));
        told = std::move(now);
    }
}

bool FrontEndCore::flooded(const ClientRef& client, std::size_t messages) {
    if (client->rate.admit(clock_.now(), static_cast<std::uint32_t>(messages))) return false;
    leave(client, Ending::Improper,
          "it flooded the server (more than " + std::to_string(settings_.messages_per_second) +
              " messages in a second)");
    return true;
}

/// Refused then: a stop never is.
bool FrontEndCore::drillsTooMuch(const ClientRef& client, const Header& head, std::size_t entities) {
    if (client->drill_rate.admit(clock_.now(),
                                 static_cast<std::uint32_t>(std::max<std::size_t>(entities, 1))))
        return false;
    client->signalOutbox()->newRefusalMsg(
        head,
        refuse(RefusalCode::Overloaded,
               "more drills than " + std::to_string(settings_.drills_per_second) +
                   " entities in a second; fix: let more time pass between them (axon drill --every S)"));
    flooded(client);
    return true;
}

/// Its connection may still be open, behind a router even for a while. Not asked for a stop.
Result<void> FrontEndCore::isHere(const Client& client) {
    if (!client.gone) return {};
    return refuse(RefusalCode::NotConnected, "its session has ended; fix: open a new one");
}

bool FrontEndCore::refuseGone(const Client& client, const Header& head, ClientOutbox& to) const {
    const auto here = isHere(client);
    if (here.ok()) return false;
    to.newRefusalMsg(head, here.refusal());
    log_.refused(head, here.refusal());
    return true;
}

void FrontEndCore::sendRequest(const ClientRef& client, Header head, std::string_view message) {
    if (flooded(client)) return;
    if (client->gone) {
        head.sender = client->me;
        refuseGone(*client, head, *client->data);
        return;
    }
    if (head.msg_type == kMsgStatus) {
        if (client->lists.admit(clock_.now())) {
            pushAll(*client);
            return;
        }
        head.sender = client->me;
        const auto refusal = refuse(RefusalCode::Overloaded,
                                    "all statuses are told at most " + std::to_string(kListsPerSecond) +
                                        " times in a second; what changes is told without being asked for");
        client->data->newRefusalMsg(head, refusal);
        return log_.excess(client->me, refusal);
    }
    if (head.msg_type == kMsgGlobalServices && global_services_ != nullptr) {
        const auto answer = global_services_->answer(message);
        head.entity.clear();
        head.sender = client->me;
        if (answer.ok())
            client->data->newEntityMsg(Lane::Data, head, answer.value(), QueueShare::Whole);
        else
            client->data->newRefusalMsg(head, answer.refusal());
        return;
    }
    client->data->newRefusalMsg(
        head, refuse(RefusalCode::NotSupported, "the server has no request '" + head.msg_type.substr(0, 64) +
                                                    "'; expected STATUS or GLOBAL_SERVICES"));
}

bool FrontEndCore::sees(const Client& client, const users::Access& access, const Registration& registration) {
    return client.user.empty() || access.empty() ||
           access.allows(client.user, client.me.role, EntityRight::See, registration.entity,
                         registration.name);
}

bool FrontEndCore::sees(const Client& client, const std::string& entity, Lane lane) const {
    if (client.user.empty()) return true;
    const auto lists = access(lane);
    if (lists->empty()) return true;
    const auto name = entities_.nameOf(entity, lane);
    return name && lists->allows(client.user, client.me.role, EntityRight::See, entity, *name);
}

/// The message is refused by what the lists say, or what they keep back is taken out of its head.
Result<void> FrontEndCore::mayByLists(const Client& client, Header& head, Lane lane) const {
    if (client.user.empty()) return {};
    const auto lists = access(lane);
    if (lists->empty()) return {};
    const auto name = entities_.nameOf(head.entity, lane);
    const auto has = [&](EntityRight right) {
        return lists->allows(client.user, client.me.role, right, head.entity, *name);
    };
    // As one that is not there. One that is on its way here is not known by its name yet.
    if (!name || !has(EntityRight::See)) return unknownEntity(head.entity);
    const auto needed = neededFor(head.msg_type);
    if (!has(needed))
        return refuse(RefusalCode::PermissionDenied, "the list of " + *name + " (@" + toString(needed) +
                                                         " in users.cfg) does not name " + client.user +
                                                         "; fix: ask the administrator of the server");
    // The force itself is in the payload; what gives it to a message is the role of its sender.
    if (needed == EntityRight::CheckOut && !has(EntityRight::Force))
        head.sender.role = std::min(head.sender.role, Role::Operator);
    return {};
}

/// A signal that is none of those that are never kept back.
bool FrontEndCore::refuseUnseen(const ClientRef& client, const Header& head) {
    if (sees(*client, head.entity, Lane::Signal)) return false;
    refuseUnknown(*client->signalOutbox(), head);
    log_.refused(head, unknownEntity(head.entity));
    flooded(client);
    return true;
}

/// Whether a signal for every entity is not for all of them.
bool FrontEndCore::keptBack(const Client& client, const Header& head) const {
    return head.entity.empty() && !client.user.empty() && !access(Lane::Signal)->empty();
}

std::vector<std::string> FrontEndCore::allSeen(const Client& client) const {
    const auto lists = access(Lane::Signal);
    std::vector<std::string> seen;
    entities_.each(Lane::Signal, [&](const Entities::RecordRef& record) {
        if (sees(client, *lists, record->registration)) seen.push_back(record->registration.entity);
    });
    return seen;
}

/// Of those that the client sees; how many these are.
std::size_t FrontEndCore::drillAll(const Client& client, const Header& head) {
    const auto seen = allSeen(client);
    for (std::size_t i = 0; i < seen.size(); i += kStopsAtOnce) {
        const auto begin = seen.begin() + static_cast<std::ptrdiff_t>(i);
        const auto end = begin + static_cast<std::ptrdiff_t>(std::min(kStopsAtOnce, seen.size() - i));
        topic_.stopSignals(head, {begin, end}, StopCause::Drill);
    }
    return seen.size();
}

/// A reset or a clear: to the entity that it names, or to all that the client sees.
template <class Send>
void FrontEndCore::sendSignal(const ClientRef& client, Header head, const char* what, Send&& send) {
    head.sender = client->me;
    if (refuseGone(*client, head, *client->signalOutbox())) return;
    std::size_t cost = 1;
    if (keptBack(*client, head)) {
        auto one = head;
        for (auto& entity : allSeen(*client)) {
            one.entity = std::move(entity);
            send(one);
            ++cost;
        }
    } else {
        if (refuseUnseen(client, head)) return;
        send(head);
    }
    log_.audit(what, client->me, {head.entity}, entities_.known());
    flooded(client, 1 + cost / kStopsForOne);
}

Result<void> FrontEndCore::mayGoOn(Client& client, Header& head, std::size_t bytes, bool droppable) {
    if (auto may = isHere(client); !may.ok()) return may;
    if (auto may = admitToShare(client, bytes, droppable, settings_, clock_); !may.ok()) return may;
    if (auto may = mayByLists(client, head, Lane::Data); !may.ok()) return may;
    if (auto may = admitCheckOut(client, head, settings_); !may.ok() && !heldByUser(client, head.entity))
        return may;
    const auto first_check_out = admit(client, head, bytes, entities_, clock_);
    if (!first_check_out.ok()) return first_check_out.refusal();
    if (!first_check_out.value()) return {};
    {
        // From now on the entity may name this client as its busy holder; it may have done so before.
        const std::lock_guard lock(mutex_);
        const auto known = entities_.find(head.entity);
        if (!holdings_.has(client.me.id, head.entity) || !known || known->status.state != EntityState::BUSY ||
            !holdings_.set(client.me.id, head.entity, true))
            return {};
        updateHolding(client.me.id);
    }
    wake_(Due::OnTimer);
    return {};
}

/// By another session of the client's user, or by one that was lost and may be resumed: who takes that over
/// holds no more than before.
bool FrontEndCore::heldByUser(const Client& client, const std::string& entity) const {
    if (client.user.empty()) return false;
    const std::lock_guard lock(mutex_);
    const auto record = entities_.find(entity);
    // All sessions of a user have the same key.
    return record && senderKey(record->status.holder.id) == senderKey(client.me.id);
}

void FrontEndCore::sendToEntity(const ClientRef& client, Header head, std::string_view message) {
    if (flooded(client)) return;
    head.sender = client->me;
    const auto server = alone() ? nullptr : entities_.serverOf(head.entity, Lane::Data);
    if (!alone() && !server) {
        refuseUnknown(*client->data, head);
        return log_.refused(head, unknownEntity(head.entity));
    }
    if (const auto may = mayGoOn(*client, head, message.size(), false); !may.ok()) {
        client->data->newRefusalMsg(head, may.refusal());
        log_.refused(head, may.refusal());
        return log_.excess(client->me, may.refusal());
    }
    if (const auto sent = topic_.clientMsg(server ? *server : std::string(), head, message); !sent.ok()) {
        client->data->newRefusalMsg(head, sent.refusal());
        return log_.refused(head, sent.refusal());
    }
    log_.command(head);
    if (head.msg_type == kMsgRearm) log_.audit("rearm", client->me, {head.entity}, entities_.known());
}

void FrontEndCore::sendToEntityDataSeq(const ClientRef& client, Header head, std::string_view data) {
    head.sender = client->me;
    const auto server = alone() ? nullptr : entities_.serverOf(head.entity, Lane::Data);
    // A client that may not send droppable data is not told. What is no raw data does not belong here, so its
    // refusal is recorded; those of raw data come many times a second.
    const bool raw = head.msg_type == kMsgRaw;
    const auto may = !alone() && !server ? Result<void>(unknownEntity(head.entity))
                                         : mayGoOn(*client, head, data.size(), true);
    if (!may.ok()) return raw ? void() : log_.refused(head, may.refusal());
    topic_.clientMsgDataSeq(server ? *server : std::string(), head, data);
    log_.command(head);
    if (head.msg_type == kMsgRearm) log_.audit("rearm", client->me, {head.entity}, entities_.known());
}

void FrontEndCore::sendStopSignal(const ClientRef& client, Header head, StopCause cause) {
    head.sender = client->me;
    // What only servers may say is not taken from a client.
    if (cause != StopCause::Drill) cause = StopCause::Requested;
    if (head.sequence >= kServerSequences) head.sequence = 0;
    if (cause == StopCause::Drill && refuseGone(*client, head, *client->signalOutbox())) return;
    if (cause == StopCause::Drill && drillsTooMuch(client, head, entities_.targets(head.entity))) return;
    const bool some = cause == StopCause::Drill && keptBack(*client, head);
    if (cause == StopCause::Drill && !some && refuseUnseen(client, head)) return;
    if (!some) topic_.stopSignal(head, cause);
    const auto targets = some ? drillAll(*client, head) : entities_.targets(head.entity);
    client->signalOutbox()->newStopAccepted(head, static_cast<std::int32_t>(targets));
    if (!alone() && targets == 0 && !head.entity.empty()) refuseUnknown(*client->signalOutbox(), head);
    log_.audit(cause == StopCause::Drill ? "drill" : "stop", client->me, {head.entity}, entities_.known());
    flooded(client);  // after the stop: also the last one of a flood is a stop
}

void FrontEndCore::sendStopSignals(const ClientRef& client, Header head,
                                   const std::vector<std::string>& entities, StopCause cause) {
    head.sender = client->me;
    head.entity.clear();
    if (cause != StopCause::Drill) cause = StopCause::Requested;
    if (head.sequence >= kServerSequences) head.sequence = 0;
    // Each entity once, and the first of a list that nobody who means it would send.
    const auto end = entities.begin() + static_cast<std::ptrdiff_t>(std::min(entities.size(), kStopsAtOnce));
    std::unordered_set<std::string_view> seen;
    std::vector<std::string> wanted;
    std::copy_if(entities.begin(), end, std::back_inserter(wanted),
                 [&](const auto& entity) { return seen.insert(entity).second; });
    if (cause == StopCause::Drill && refuseGone(*client, head, *client->signalOutbox())) return;
    if (cause == StopCause::Drill && drillsTooMuch(client, head, wanted.size())) return;
    if (cause == StopCause::Drill) {
        auto refused = head;
        std::erase_if(wanted, [&](const auto& entity) {
            if (sees(*client, entity, Lane::Signal)) return false;
            refused.entity = entity.substr(0, 64);
            refuseUnknown(*client->signalOutbox(), refused);
            return true;
        });
    }
    topic_.stopSignals(head, wanted, cause);
    const auto known = [&](const std::string& entity) { return entities_.has(entity, Lane::Signal); };
    const auto targets = std::count_if(wanted.begin(), wanted.end(), known);
    client->signalOutbox()->newStopAccepted(head, static_cast<std::int32_t>(targets));
    if (entities.size() > kStopsAtOnce)
        client->signalOutbox()->newRefusalMsg(
            head, refuse(RefusalCode::TooLarge, "the stop has been given to the first " +
                                                    std::to_string(kStopsAtOnce) +
                                                    " entities of its list, and this session ends; stop all "
                                                    "by sendStopSignal without an entity"));
    if (!alone() && targets < std::ssize(wanted)) {
        auto refused = head;
        for (const auto& entity : wanted) {
            if (known(entity)) continue;
            refused.entity = entity.substr(0, 64);
            refuseUnknown(*client->signalOutbox(), refused);
        }
    }
    log_.audit(cause == StopCause::Drill ? "drill" : "stop", client->me, wanted, entities_.known());
    // A longer list is for nobody's robots; each costs its sender a session.
    if (entities.size() > kStopsAtOnce)
        return leave(client, Ending::Improper,
                     "it sent a list of more than " + std::to_string(kStopsAtOnce) + " entities to stop");
    flooded(client, 1 + entities.size() / kStopsForOne);
}

void FrontEndCore::sendResetSignal(const ClientRef& client, Header head) {
    sendSignal(client, std::move(head), "reset", [this](const Header& to) { topic_.resetSignal(to); });
}

void FrontEndCore::sendClearSignal(const ClientRef& client, Header head) {
    sendSignal(client, std::move(head), "clear", [this](const Header& to) { topic_.clearSignal(to); });
}

void FrontEndCore::keepAlive(const ClientRef& client) {
    client->liveness.heard(clock_.now());
}

void FrontEndCore::leave(const ClientRef& client, Ending ending, const std::string& why) {
    leave({{client, ending, why, {}}});
}

void FrontEndCore::leave(std::vector<Leaving> leaving) {
    if (leaving.empty()) return;
    std::vector<Leaving> gone;
    {
        const std::lock_guard lock(mutex_);
        for (auto& one : leaving) {
            const auto& client = one.client;
            if (!clients_.remove(client)) continue;
            client->gone = true;
            one.held = holdings_.of(client->me.id);
            client->share->held -= client->entities.held();
            if (client->surplus) --client->share->surplus;
            if (!client->user.empty() && --client->share->sessions == 0) shares_.erase(client->user);
            gone_.remember(client->me, one.ending);
            gone.push_back(std::move(one));
        }
    }
    for (const auto& [client, ending, why, held] : gone) settlement_.stop(client->me, ending, held);
    for (const auto& [client, ending, why, held] : gone) {
        settlement_.tellGone(client->me, ending, held);
        // Whom else it asked: it waits for none of them any more, and watches nothing.
        for (const auto& [entity, check_out] : client->entities.take())
            if (!held.contains(entity)) settlement_.tellGone(client->me, entity, ending);
        client->data->disconnect(ending == Ending::Ended, why);
        if (const auto signal = *client->signal.load()) signal->disconnect(ending == Ending::Ended, why);
        const char* how = ending == Ending::Ended  ? "left"
                          : ending == Ending::Lost ? "is lost"
                                                   : "was dropped";
        log_.left(client->me, how, why);
        note_("client " + client->me.name + " " + how + ": " + why +
              (held.empty() ? ""
                            : "; it held " + std::to_string(held.size()) +
                                  (held.size() == 1 ? " entity" : " entities")));
    }
}

/// What has become of the user, where that is less than this role.
std::optional<std::string> FrontEndCore::lessThan(const std::string& user, Role role) const {
    if (users_ == nullptr || user.empty()) return std::nullopt;
    const auto now = users_->clientRole(user);
    if (!now) return "the user '" + user + "' was removed";
    if (*now < role) return "the role of the user '" + user + "' became " + toString(*now);
    return std::nullopt;
}

/// Why this client may not go on holding the entity. One that never asked for it cannot have it, whatever the
/// entity says, and is not to be lost for that.
std::optional<std::string> FrontEndCore::mayNotHold(const Client& client, const Registration& its) const {
    if (client.user.empty() || !client.entities.askedForCheckOut(its.entity)) return std::nullopt;
    if (access(Lane::Data)->allows(client.user, client.me.role, EntityRight::CheckOut, its.entity, its.name))
        return std::nullopt;
    return "the user '" + client.user + "' may no longer check out " + its.name;
}

/// Why the client is to be lost: an entity that it holds. What else it has asked of entities without having
/// the right any more is given up.
std::optional<std::string> FrontEndCore::lessBy(const ClientRef& client, const Entities::Records& records,
                                                const users::Access& before, const users::Access& now,
                                                std::vector<GivenUp>& given_up) const {
    for (const auto& [entity, check_out] : client->entities.all()) {
        const auto found = records.find(entity);
        if (found == records.end()) continue;
        const auto& its = found->second->registration;
        if (client->entities.holds(entity)) {
            if (auto why = mayNotHold(*client, its)) return why;
            continue;
        }
        const auto right = check_out ? EntityRight::CheckOut : EntityRight::See;
        const auto allows = [&](const users::Access& access) {
            return access.allows(client->user, client->me.role, right, its.entity, its.name);
        };
        if (!allows(now) && allows(before)) given_up.push_back({client, entity, its.name});
    }
    return std::nullopt;
}

/// It leaves the entity's queue of those who wait.
void FrontEndCore::giveUp(const GivenUp& what) {
    const auto& [client, entity, name] = what;
    settlement_.tellGone(client->me, entity, Ending::Ended);
    const auto sequence = client->entities.giveUp(entity);
    if (!sequence) return;
    Header head;
    head.entity = entity;
    head.sender = client->me;
    head.msg_type = kMsgCheckOut;
    head.sequence = *sequence;
    const auto refusal = refuse(RefusalCode::PermissionDenied,
                                "the list of " + name + " (@checkout in users.cfg) names " + client->user +
                                    " no longer; fix: ask the administrator of the server");
    client->data->newRefusalMsg(head, refusal);
    log_.refused(head, refusal);
}

void FrontEndCore::usersChanged() {
    if (users_ == nullptr) return;
    const auto before = access(Lane::Data);
    const auto now = users_->access();
    for (auto& lane : access_) lane.store(now);
    const bool others = *before != *now;
    // Decided without the mutex, which heartbeats need. What comes in between is asked by the new lists: who
    // joins, a new holder, a new name.
    std::vector<ClientRef> clients, stay;
    Entities::Records records;
    {
        const std::lock_guard lock(mutex_);
        clients.reserve(clients_.size());
        for (const auto& [id, client] : clients_.byId())
            if (!client->user.empty()) clients.push_back(client);
        if (others) records = entities_.records();
    }
    std::vector<GivenUp> given_up;
    std::vector<Leaving> leaving;
    for (const auto& client : clients) {
        auto why = lessThan(client->user, client->me.role);
        if (!why && others) why = lessBy(client, records, *before, *now, given_up);
        if (why) {
            leaving.push_back({client, Ending::Lost, std::move(*why), {}});
        } else if (others) {
            stay.push_back(client);
        }
    }
    leave(std::move(leaving));
    for (const auto& what : given_up)
        if (!what.client->gone) giveUp(what);
    for (const auto& client : stay) {
        auto told = records;
        std::erase_if(told,
                      [&](const auto& one) { return !sees(*client, *before, one.second->registration); });
        pushAll(*client, std::move(told));
    }
}

template <class Send>
void FrontEndCore::toThoseWhoSee(const Registration& registration, Send&& send) {
    const auto lists = access(Lane::Data);
    clients_.to(Lane::Data, {}, [&](const Client& client, ClientOutbox& outbox) {
        if (sees(client, *lists, registration)) send(outbox);
    });
}

template <class Send>
void FrontEndCore::toClients(Lane lane, const std::string& recipient, Send&& send) {
    clients_.to(lane, recipient, [&](const Client&, ClientOutbox& outbox) { send(outbox); });
}

void FrontEndCore::updateHolding(const std::string& holder) {
    const auto client = clients_.find(holder);
    if (!client) return;
    const bool busy = holdings_.busy(holder);
    auto& watched = *client;
    const auto now = clock_.now();
    if (busy && !watched.liveness.busy()) watched.next_heartbeat = now;
    if (!AXON_PLANTED(ClientWatchdogAlwaysIdle)) watched.liveness.setBusy(busy, now);
}

void FrontEndCore::entityBasicPrflUpdate(Presence presence, Registration registration,
                                         std::string_view profile) {
    std::optional<Entities::News> news;
    Entities::RecordRef before;
    Barred barred;
    {
        const std::lock_guard lock(mutex_);
        before = entities_.find(registration.entity);
        news = entities_.update(presence, std::move(registration), profile);
        if (!news) return;
        const auto& holder = news->record->status.holder.id;
        if (news->presence == Presence::Left) {
            letGo(holder, news->record->registration.entity);
        } else if (const auto client = clients_.find(holder)) {
            // Under its new name it may be on another list.
            if (auto why = mayNotHold(*client, news->record->registration))
                barred = {client, std::move(*why)};
        }
    }
    if (barred.client) leave(barred.client, Ending::Lost, barred.why);
    const auto& record = *news->record;
    const std::string_view bytes = news->presence == Presence::Left ? std::string_view() : *record.profile;
    const auto lists = access(Lane::Data);
    clients_.to(Lane::Data, {}, [&](const Client& client, ClientOutbox& outbox) {
        const bool now = sees(client, *lists, record.registration);
        const bool earlier =
            news->presence == Presence::Changed ? sees(client, *lists, before->registration) : now;
        if (now && earlier) return outbox.newBasicPrflMsg(news->presence, record.registration, bytes);
        if (earlier) return outbox.newBasicPrflMsg(Presence::Left, before->registration, {});
        if (!now) return;
        outbox.newBasicPrflMsg(Presence::Joined, record.registration, bytes);
        if (record.heard) outbox.newStatusMsg(record.status);
    });
    if (news->disputed) ask({});
}

/// Under the mutex: the entity names this holder no longer.
void FrontEndCore::letGo(const std::string& holder, const std::string& entity) {
    if (holder.empty()) return;
    if (const auto client = clients_.find(holder); client && client->entities.setHeld(entity, false))
        --client->share->held;
    holdings_.erase(holder, entity);
    updateHolding(holder);
}

/// STATUS of this server, empty = all.
void FrontEndCore::ask(const std::string& server) {
    Header head;
    head.msg_type = kMsgStatus;
    head.entity = server;
    topic_.clientRequest(head);
}

void FrontEndCore::forget(const std::string& server, const std::unordered_set<std::string>& but) {
    Entities::Left left;
    {
        const std::lock_guard lock(mutex_);
        left = entities_.forget(server, but);
        for (const auto& record : left.records) letGo(record->status.holder.id, record->registration.entity);
    }
    for (const auto& record : left.records) {
        toThoseWhoSee(record->registration, [&](ClientOutbox& client) {
            client.newBasicPrflMsg(Presence::Left, record->registration, {});
        });
    }
    if (left.disputed) ask({});
    if (const auto gone = left.records.size(); gone > 0) {
        note_("entity server " + server + ": " + std::to_string(gone) +
              (gone == 1 ? " entity is" : " entities are") + " gone");
    }
}

void FrontEndCore::entityServerEntities(const std::string& server, const std::vector<std::string>& entities) {
    if (alone() || !isServerName(server)) return;
    {
        const std::lock_guard lock(mutex_);
        entities_.missed().answered(server);
    }
    forget(server, {entities.begin(), entities.end()});
}

void FrontEndCore::entityServerUpdate(Lane lane, const ServerAnnouncement& server) {
    if (alone()) return;
    if (entity_servers_.heard(lane, server, clock_.now())) wake_(Due::OnTimer);
    if (lane == Lane::Signal || !isServerName(server.name)) return;
    {
        const std::lock_guard lock(mutex_);
        if (!entities_.missed().announced(server.name, server.published, clock_.now())) return;
    }
    ask(server.name);  // something of it was lost on the way, or it was there first
}

void FrontEndCore::entityServerRefused(const std::string& server, const std::string& signals) {
    if (entity_servers_.refused(server, signals)) wake_(Due::OnTimer);
}

/// By the topic also what users there are here, which the entity servers compare.
void FrontEndCore::announce(Lane lane) {
    topic_.frontEndServerUpdate(lane, others_.self(),
                                lane == Lane::Data && users_ != nullptr ? users_->fingerprint() : "");
}

void FrontEndCore::topicFound() {
    announce(Lane::Data);
    {
        const std::lock_guard lock(mutex_);
        entities_.missed().askedAll(clock_.now());
    }
    ask({});
}

void FrontEndCore::entityUpdate(EntityStatus status, std::int64_t number, Via via) {
    const bool busy = status.state == EntityState::BUSY;
    std::optional<GoneClients::Gone> late;
    std::string entity, doubted;
    Registration registration;  // as far as lists ask for it
    bool passed = false;        // to another holder, or to none
    Before known;
    Barred barred;
    {
        const std::lock_guard lock(mutex_);
        const auto record_before = entities_.update(status, number, via);
        if (!record_before) return;
        entity = status.entity;
        registration.entity = entity;
        registration.name = record_before->registration.name;
        const auto& before = record_before->status.holder.id;
        const auto& holder = status.holder.id;
        passed = before != holder;
        known = {before, record_before->status.state == EntityState::BUSY, record_before->heard};
        if (passed) letGo(before, entity);
        if (!holder.empty()) {
            if (const auto client = clients_.find(holder)) {
                // An entity that names a client which never asked for it is told of its end like any other,
                // but does not decide how often that client must beat.
                const bool asked =
                    client->entities.askedForCheckOut(entity) || AXON_PLANTED(UnaskedHolderBelieved);
                if (!asked && before != holder) doubted = client->me.name;
                if (client->entities.setHeld(entity, true)) ++client->share->held;
                if (holdings_.set(holder, entity, busy && asked)) updateHolding(holder);
                // The lists may have changed after its check-out was passed on.
                if (before != holder)
                    if (auto why = mayNotHold(*client, registration)) barred = {client, std::move(*why)};
            } else if (before != holder && !status.orphaned &&
                       (alone() || originOf(holder).server == settings_.name)) {
                // Granted to a client that was gone before the grant was known here, however long ago.
                late = gone_.find(status.holder);
            }
        }
    }
    if (!doubted.empty()) log_.unaskedHolder(entity, doubted);
    if (passed && !alone()) log_.holder(status);  // the entity server beside the only one records it
    if (barred.client) leave(barred.client, Ending::Lost, barred.why);
    if (late && !AXON_PLANTED(LateGrantLeft)) {
        settlement_.stop(late->sender, late->ending, {{entity, busy}});
        settlement_.tellGone(late->sender, late->ending, {{entity, busy}});
    }
    if (busy) wake_(Due::OnTimer);
    // Two copies come on two threads, so a newer one may have been told meanwhile: the last word is the
    // newest.
    while (true) {
        tellStatus(registration, status, known);
        if (number == 0) return;
        const std::lock_guard lock(mutex_);
        const auto newest = entities_.find(entity);
        if (!newest || newest->number <= number) return;
        known = {status.holder.id, status.state == EntityState::BUSY, true};
        status = newest->status;
        number = newest->number;
    }
}

/// The holder and the one before are told at once, and everybody of what a watchdog or a resumption waits
/// for.
void FrontEndCore::tellStatus(const Registration& registration, const EntityStatus& status,
                              const Before& before) {
    const auto lists = access(Lane::Data);
    const auto now = machine_time_.now();
    const bool urgent = !before.heard || (status.state == EntityState::BUSY && !before.busy);
    bool first = false;
    clients_.to(Lane::Data, {}, [&](Client& client, ClientOutbox& outbox) {
        if (!sees(client, *lists, registration)) return;
        if (urgent || client.me.id == status.holder.id || client.me.id == before.holder) {
            client.statuses.drop(status.entity);
        } else if (const auto verdict = client.statuses.offer(status.entity, now);
                   verdict != HeldStatuses::Verdict::Now) {
            first = first || verdict == HeldStatuses::Verdict::First;
            return;
        }
        outbox.newStatusMsg(status);
    });
    if (first) wake_(Due::TellHeld);
}

TimePoint FrontEndCore::tellHeld() {
    auto next = machine_time_.now() + std::chrono::seconds{1};
    clients_.to(Lane::Data, {}, [&](Client& client, ClientOutbox& outbox) {
        if (const auto entities = client.statuses.take(machine_time_.now()); !entities.empty()) {
            auto now = seenBy(client, &entities);
            for (const auto& entity : entities)
                if (const auto its = now.find(entity); its != now.end() && its->second->heard)
                    outbox.newStatusMsg(its->second->status);
            pushAll(client, std::move(now), &entities);
        }
        next = std::min(next, client.statuses.due());
    });
    return next;
}

void FrontEndCore::entityMsg(Lane lane, const Header& head, std::string_view message) {
    clients_.to(lane, head.sender.id, [&](const Client& client, ClientOutbox& outbox) {
        // A receipt is never kept back.
        if (lane == Lane::Data && !sees(client, head.entity, lane)) return;
        // An entity that a client has asked has its whole queue of the data lane: what that one sends it must
        // read. On the signal lane nobody waits for the lock of that.
        const bool whole = lane == Lane::Data && client.entities.asked(head.entity);
        if (outbox.newEntityMsg(lane, head, message, whole ? QueueShare::Whole : QueueShare::OfSender))
            return;
        log_.slowClient(client.me, head.entity);
    });
}

void FrontEndCore::entityMsgDataSeq(const Header& head, std::string_view data) {
    clients_.to(Lane::Data, head.sender.id, [&](const Client& client, ClientOutbox& outbox) {
        if (sees(client, head.entity, Lane::Data)) outbox.newEntityMsgDataSeq(head, data);
    });
}

void FrontEndCore::entityRefusal(Lane lane, const Header& head, const Refusal& refusal) {
    if (head.sender.id.empty()) return;
    bool here = false;  // each of several servers is told
    toClients(lane, head.sender.id, [&](ClientOutbox& client) {
        here = true;
        client.newRefusalMsg(head, refusal);
    });
    if (here) log_.refused(head, refusal);
}

TimePoint FrontEndCore::onTimer() {
    std::vector<Leaving> silent;
    std::vector<std::pair<ClientRef, std::int64_t>> heartbeats;
    std::vector<std::string> warnings;
    TimePoint next;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        next = now + std::chrono::seconds{1};
        for (auto& [client, why] : silentAt(clients_.byId(), now))
            silent.push_back({client, Ending::Lost, std::move(why), {}});
        for (const auto& [id, client] : clients_.byId()) {
            if (client->liveness.expired(now)) continue;
            if (now >= client->warn_again) {
                if (const auto gap = client->liveness.longest(now); gap.part() >= Liveness::kWarnFrom) {
                    client->warn_again = now + Liveness::kWarnAgain;
                    warnings.push_back("client " + client->me.name + " is late: " + describe(gap));
                }
            }
            if (client->next_heartbeat <= now) {
                heartbeats.emplace_back(client, ++client->heartbeats);
                client->next_heartbeat =
                    now + (client->liveness.busy() ? heartbeatToBusyClient(settings_.watchdog_busy)
                                                   : settings_.heartbeat_idle);
            }
            next = std::min({next, client->next_heartbeat, client->liveness.deadline()});
        }
    }
    leave(std::move(silent));
    for (const auto& [client, sequence] : heartbeats) client->signalOutbox()->newHeartbeat(sequence);
    next = std::min(next, others_.onTimer(clock_.now()));
    for (const auto& warning : warnings) note_(warning);
    return next;
}

void FrontEndCore::shutDown() {
    clients_.each([](const ClientRef& client) {
        client->data->newUpdateMsg(RefusalCode::Unavailable, "the server is shutting down");
    });
}

std::vector<std::string> FrontEndCore::margins() const {
    std::vector<std::string> lines;
    const auto now = clock_.now();
    clients_.each([&](const ClientRef& client) {
        lines.push_back("client " + client->me.name + ": " + describe(client->liveness.longest(now)));
    });
    return lines;
}

std::size_t FrontEndCore::clients() const {
    const std::lock_guard lock(mutex_);
    return clients_.size();
}

std::size_t FrontEndCore::entities() const {
    const std::lock_guard lock(mutex_);
    return entities_.records().size();
}

}  // namespace axon::front_end_server
