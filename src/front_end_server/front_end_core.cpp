// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/front_end_core.hpp"

#include <algorithm>
#include <iterator>
#include <mutex>
#include <string_view>
#include <unordered_set>
#include <utility>

#include "common/liveness.hpp"
#include "common/planted_bug.hpp"
#include "common/queue_share.hpp"
#include "common/rights.hpp"
#include "common/utf8.hpp"
#include "front_end_server/client.hpp"

namespace axon::front_end_server {

namespace {

constexpr std::uint32_t kLinesPerSecond = 8;  // of the log, of a kind

Refusal refuse(RefusalCode code, std::string message) {
    return {code, std::move(message), {}};
}

constexpr std::size_t kStopsForOne = 16;  // so many entities of a list cost as much as a message
constexpr auto kData = static_cast<std::size_t>(Lane::Data);
constexpr auto kSignal = static_cast<std::size_t>(Lane::Signal);

StopCause causeOf(Ending ending) {
    switch (ending) {
        case Ending::Ended:
            return StopCause::Released;
        case Ending::Lost:
            return StopCause::ClientLost;
        case Ending::Improper:
            return StopCause::Improper;
    }
    return StopCause::ClientLost;
}

}  // namespace

FrontEndCore::FrontEndCore(FrontEndCoreSettings settings, const Clock& clock, RandomSource& random,
                           EntityTopic& topic, Note note, std::function<void()> wake,
                           GlobalServicesPort* global_services)
    : settings_(settings),
      clock_(clock),
      random_(random),
      topic_(topic),
      note_(std::move(note)),
      wake_(std::move(wake)),
      global_services_(global_services),
      doubts_(kLinesPerSecond),
      excesses_(kLinesPerSecond),
      others_(settings.name, random, note_,
              [this](Lane lane) { topic_.frontEndServerUpdate(lane, others_.self()); }),
      entity_servers_(others_.add({.name = "entity server",
                                   .timeouts = settings.entity_servers,
                                   .reach = [this](const auto& servers) { topic_.reach(servers); },
                                   .left = [this](const auto& names) { serversLost(names); },
                                   .arrived = [this](const auto& name) { serverArrived(name); }})) {}

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
        if (clients_.size() >= settings_.clients_max) {
            return refuse(RefusalCode::Overloaded, "the server has its " +
                                                       std::to_string(settings_.clients_max) +
                                                       " clients; raise FrontEndServer.ClientsMax");
        }
        // A name that is no UTF-8 would make every receipt that carries it unreadable.
        std::string name(cutUtf8(validUtf8(display_name), 256));
        const auto origin = alone() ? std::string() : settings_.name + ":" + others_.self().instance + ":";
        // Of version 8: no entity can register under it without a secret that nobody has (ADR 0024).
        auto id = Id128::uuid(random_).toString();
        id[kUserDigits] = '8';
        if (!user.empty()) id.replace(0, kUserDigits, userPart(user));
        Sender me{origin + id, name.empty() ? "unnamed" : std::move(name), role};
        client = std::make_shared<Client>(std::move(me), Id128::random(random_).toString(), std::move(data),
                                          settings_, clock_.now());
        clients_.emplace(client->me.id, client);
        tokens_.emplace(client->token, client);
        table_.put(client->me.id, client);
    }
    wake_();
    note_("client " + client->me.name + " joined (" + client->me.id + ")");
    client->told = pushAll(*client->data);
    return client;
}

Result<FrontEndCore::ClientRef> FrontEndCore::attach(const std::string& token,
                                                     std::shared_ptr<ClientOutbox> signal) {
    const std::lock_guard lock(mutex_);
    const auto found = tokens_.find(token);
    auto client = found == tokens_.end() ? nullptr : found->second.lock();
    if (!client || client->gone) {
        return refuse(RefusalCode::NotConnected,
                      "no session waits for this token (it is for one use); open a new session and set its "
                      "callback first");
    }
    tokens_.erase(found);
    client->signal.store(std::make_shared<const std::shared_ptr<ClientOutbox>>(std::move(signal)));
    return client;
}

// No lock is held while a client is told, so something may change meanwhile and be told by another thread
// first. Therefore again, until what was told is what is: the last word about each entity is then the true
// one.
std::size_t FrontEndCore::pushAll(ClientOutbox& to) {
    Records told;
    while (true) {
        Records now;
        {
            const std::lock_guard lock(mutex_);
            now = records_;
        }
        bool changed = false;
        for (const auto& [entity, record] : now) {
            const auto before = told.find(entity);
            if (before != told.end() && before->second == record) continue;
            changed = true;
            to.newBasicPrflMsg(before == told.end() ? Presence::Joined : Presence::Changed,
                               record->registration, *record->profile);
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

// Who did what, for those who ask afterwards. A forced take-over is inside a payload: the Entity Manager says
// it.
void FrontEndCore::audit(const char* what, const Sender& who,
                         const std::vector<std::string>& entities) const {
    constexpr std::size_t kNamed = 16;
    std::string to;
    for (std::size_t i = 0; i < std::min(entities.size(), kNamed); ++i)
        to += (i == 0 ? "" : ", ") + entities[i].substr(0, 64);
    if (entities.size() > kNamed) to += " and " + std::to_string(entities.size() - kNamed) + " more";
    if (entities.size() == 1 && to.empty()) to = "all " + std::to_string(known_.size()) + " entities";
    note_(std::string("audit: ") + what + " by " + who.name + " (" + toString(who.role) + ", " + who.id +
          ") to " + to);
}

/// Logs a client that exceeds its limits, so that an operator can find out why the server is slow.
void FrontEndCore::noteExcess(const Client& client, const Refusal& refusal) {
    if (refusal.code != RefusalCode::Overloaded && refusal.code != RefusalCode::TooLarge) return;
    if (excesses_.admit(clock_.now()))
        note_("client " + client.me.name + " (" + client.me.id + ") is refused: " + refusal.message);
}

void FrontEndCore::sendRequest(const ClientRef& client, Header head, std::string_view message) {
    if (flooded(client)) return;
    if (head.msg_type == kMsgStatus) {
        if (client->lists.admit(clock_.now())) {
            pushAll(*client->data);
            return;
        }
        head.sender = client->me;
        const auto refusal = refuse(RefusalCode::Overloaded,
                                    "all statuses are told at most " + std::to_string(kListsPerSecond) +
                                        " times in a second; what changes is told without being asked for");
        client->data->newRefusalMsg(head, refusal);
        return noteExcess(*client, refusal);
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

/// What the server decides about a message to an entity. Also notes of which entities the client asks
/// what they remember: their Entity Managers take a check-out and a watch under these two msgTypes alone.
Result<void> FrontEndCore::mayGoOn(Client& client, const Header& head, std::size_t bytes) {
    if (!clientsMaySend(head.msg_type))
        return refuse(RefusalCode::PermissionDenied,
                      head.msg_type + (entitiesMaySend(head.msg_type)
                                           ? " is what entities say to each other; ask their master by RUN"
                                           : " is for the server itself: use sendRequest"));
    if (!client.holds(head.entity)) {
        // Who has asked for it may have the grant before this server has the status that tells of it.
        if (bytes > kStrangersBytes && !client.hasAsked(head.entity))
            return refuse(RefusalCode::TooLarge,
                          "a message of more than " + std::to_string(kStrangersBytes / 1024) +
                              " KiB is taken only of who holds the entity; check it out first");
        if (!client.bytes.admit(clock_.now(), static_cast<std::uint32_t>(bytes)))
            return refuse(RefusalCode::Overloaded, "more than " +
                                                       std::to_string(kStrangersBytesPerSecond / 1024) +
                                                       " KiB in a second to entities that it does not hold "
                                                       "are taken of nobody; send less, or check them out");
    }
    const bool check_out = head.msg_type == kMsgCheckOut;
    if (!check_out && head.msg_type != kMsgWatch) return {};
    const bool for_itself = check_out && client.me.role != Role::Observer;
    const bool first = for_itself && !client.hasAsked(head.entity);
    if (!client.asks(head.entity, for_itself, known_.find(head.entity, kData) != nullptr))
        return refuse(RefusalCode::NotConnected, "its session has ended");
    if (first) believe(client, head.entity);
    return {};
}

/// From now on the entity may name this client as its busy holder; it may have done so before.
void FrontEndCore::believe(const Client& client, const std::string& entity) {
    {
        const std::lock_guard lock(mutex_);
        const auto known = records_.find(entity);
        if (!holdings_.has(client.me.id, entity) || known == records_.end() ||
            known->second->status.state != EntityState::BUSY || !holdings_.set(client.me.id, entity, true))
            return;
        updateHolding(client.me.id);
    }
    wake_();
}

void FrontEndCore::sendToEntity(const ClientRef& client, Header head, std::string_view message) {
    if (flooded(client)) return;
    head.sender = client->me;
    const auto known = alone() ? nullptr : known_.find(head.entity, kData);
    if (!alone() && !known) return refuseUnknown(*client->data, head);
    if (const auto may = mayGoOn(*client, head, message.size()); !may.ok()) {
        client->data->newRefusalMsg(head, may.refusal());
        return noteExcess(*client, may.refusal());
    }
    if (const auto sent = topic_.clientMsg(known ? known->registration.server : std::string(), head, message);
        !sent.ok()) {
        client->data->newRefusalMsg(head, sent.refusal());
        return;
    }
    if (head.msg_type == kMsgRearm) audit("rearm", client->me, {head.entity});
}

void FrontEndCore::sendToEntityDataSeq(const ClientRef& client, Header head, std::string_view data) {
    head.sender = client->me;
    const auto known = alone() ? nullptr : known_.find(head.entity, kData);
    // Droppable data of who may not send it is dropped without a word.
    if ((!alone() && !known) || !mayGoOn(*client, head, data.size()).ok()) return;
    topic_.clientMsgDataSeq(known ? known->registration.server : std::string(), head, data);
    if (head.msg_type == kMsgRearm) audit("rearm", client->me, {head.entity});
}

std::size_t FrontEndCore::stopTargets(const std::string& entity) const {
    if (entity.empty()) return known_.size();
    return known_.find(entity, kSignal) ? 1 : 0;
}

void FrontEndCore::sendStopSignal(const ClientRef& client, Header head, StopCause cause) {
    head.sender = client->me;
    // What only servers may say is not taken from a client.
    if (cause != StopCause::Drill) cause = StopCause::Requested;
    if (head.sequence >= kServerSequences) head.sequence = 0;
    if (cause == StopCause::Drill && drillsTooMuch(client, head, stopTargets(head.entity))) return;
    topic_.stopSignal(head, cause);
    const auto targets = stopTargets(head.entity);
    client->signalOutbox()->newStopAccepted(head, static_cast<std::int32_t>(targets));
    if (!alone() && targets == 0 && !head.entity.empty()) refuseUnknown(*client->signalOutbox(), head);
    audit(cause == StopCause::Drill ? "drill" : "stop", client->me, {head.entity});
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
    if (cause == StopCause::Drill && drillsTooMuch(client, head, wanted.size())) return;
    topic_.stopSignals(head, wanted, cause);
    const auto known = [&](const std::string& entity) { return known_.find(entity, kSignal) != nullptr; };
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
    audit(cause == StopCause::Drill ? "drill" : "stop", client->me, wanted);
    // A longer list is for nobody's robots; each costs its sender a session.
    if (entities.size() > kStopsAtOnce)
        return leave(client, Ending::Improper,
                     "it sent a list of more than " + std::to_string(kStopsAtOnce) + " entities to stop");
    flooded(client, 1 + entities.size() / kStopsForOne);
}

void FrontEndCore::sendResetSignal(const ClientRef& client, Header head) {
    head.sender = client->me;
    topic_.resetSignal(head);
    audit("reset", client->me, {head.entity});
    flooded(client);
}

void FrontEndCore::sendClearSignal(const ClientRef& client, Header head) {
    head.sender = client->me;
    topic_.clearSignal(head);
    audit("clear", client->me, {head.entity});
    flooded(client);
}

void FrontEndCore::keepAlive(const ClientRef& client) {
    client->liveness.heard(clock_.now());
}

// All stops before anything else is said: no entity's stop waits for another one's paperwork.
void FrontEndCore::settle(const Sender& client, Ending ending, const Holdings::Held& held) {
    if (AXON_PLANTED(LostClientForgotten) && ending == Ending::Lost) return;
    Header head;
    head.sender = client;
    head.sequence = kServerSequences + ++own_stops_;
    head.sent_at_us = toMicroseconds(clock_.now());
    std::vector<std::string> stopped;
    for (const auto& [entity, busy] : held) {
        if (ending != Ending::Ended || busy) stopped.push_back(entity);
    }
    if (stopped.size() == 1) {
        head.entity = stopped.front();
        topic_.stopSignal(head, causeOf(ending));
    } else if (!stopped.empty()) {
        topic_.stopSignals(head, stopped, causeOf(ending));
    }
    for (const auto& [entity, busy] : held) tellGone(client, entity, ending);
}

void FrontEndCore::tellGone(const Sender& client, const std::string& entity, Ending ending) {
    Header head;
    head.sender = client;
    head.entity = entity;
    head.sent_at_us = toMicroseconds(clock_.now());
    topic_.clientUpdate(head, ending == Ending::Ended ? ClientChange::Ended : ClientChange::Lost);
}

void FrontEndCore::leave(const ClientRef& client, Ending ending, const std::string& why) {
    Holdings::Held held;
    {
        const std::lock_guard lock(mutex_);
        if (client->gone) return;
        client->gone = true;
        clients_.erase(client->me.id);
        tokens_.erase(client->token);
        held = holdings_.of(client->me.id);
        gone_.emplace(client->me.id, Gone{client->me, ending});
        gone_order_.push_back(client->me.id);
        if (gone_order_.size() > settings_.clients_remembered) {
            gone_.erase(gone_order_.front());
            gone_order_.pop_front();
        }
        table_.erase(client->me.id);
    }
    settle(client->me, ending, held);
    // Whom else it asked: it waits for none of them any more, and watches nothing.
    for (const auto& [entity, check_out] : client->takeAsked())
        if (!held.contains(entity)) tellGone(client->me, entity, ending);
    client->data->disconnect(ending == Ending::Ended, why);
    if (const auto signal = *client->signal.load()) signal->disconnect(ending == Ending::Ended, why);
    const char* how = ending == Ending::Ended  ? " left"
                      : ending == Ending::Lost ? " is lost"
                                               : " was dropped";
    note_("client " + client->me.name + how + ": " + why +
          (held.empty()
               ? ""
               : "; it held " + std::to_string(held.size()) + (held.size() == 1 ? " entity" : " entities")));
}

template <class Send>
void FrontEndCore::eachOf(Lane lane, const std::string& recipient, Send&& send) {
    const auto its_lane = static_cast<std::size_t>(lane);
    const auto to = [&](const ClientRef& client) {
        if (lane == Lane::Signal) {
            send(*client, *client->signalOutbox());
        } else {
            send(*client, *client->data);
        }
    };
    if (recipient.empty()) {
        table_.each(to, its_lane);
    } else if (const auto client = table_.find(recipient, its_lane)) {
        to(client);
    }
}

template <class Send>
void FrontEndCore::toClients(Lane lane, const std::string& recipient, Send&& send) {
    eachOf(lane, recipient, [&](const Client&, ClientOutbox& outbox) { send(outbox); });
}

void FrontEndCore::updateHolding(const std::string& holder) {
    const auto client = clients_.find(holder);
    if (client == clients_.end()) return;
    const bool busy = holdings_.busy(holder);
    auto& watched = *client->second;
    const auto now = clock_.now();
    if (busy && !watched.liveness.busy()) watched.next_heartbeat = now;
    if (!AXON_PLANTED(ClientWatchdogAlwaysIdle)) watched.liveness.setBusy(busy, now);
}

void FrontEndCore::entityBasicPrflUpdate(Presence presence, Registration registration,
                                         std::string_view profile) {
    bool told = true;
    bool disputed = false;
    RecordRef record;
    {
        const std::lock_guard lock(mutex_);
        hearOf(registration.server);
        const auto found = records_.find(registration.entity);
        const bool of_another =
            found != records_.end() && found->second->registration.server != registration.server;
        if (presence == Presence::Left) {
            if (found == records_.end() || of_another) return;
            disputed = disputed_.contains(registration.entity);
            record = takeOut(registration.entity);
        } else if (of_another && presence == Presence::Changed) {
            disputed_.insert(registration.entity);
            return;
        } else if (!alone() && entity_servers_.lost(registration.server)) {
            return;  // late; should the server come back it is asked
        } else if (found != records_.end() && found->second->registration == registration &&
                   *found->second->profile == profile) {
            told = false;  // published again for somebody else
        } else {
            const bool known = found != records_.end();
            if (!alone()) entity_servers_.await(registration.server, clock_.now());
            auto next = known ? std::make_shared<Record>(*found->second) : std::make_shared<Record>();
            next->profile = std::make_shared<const std::string>(profile);
            next->status.entity = registration.entity;
            next->status.server = registration.server;
            if (of_another) next->number = 0;  // that server counts for itself
            next->registration = std::move(registration);
            record = next;
            countBusy(known ? found->second.get() : nullptr, record.get());
            records_[record->registration.entity] = record;
            presence = known ? Presence::Changed : Presence::Joined;
            if (!known || of_another) known_.put(record->registration.entity, record);
        }
    }
    if (!told) return;
    const std::string_view bytes = presence == Presence::Left ? std::string_view() : *record->profile;
    toClients(Lane::Data, {},
              [&](ClientOutbox& client) { client.newBasicPrflMsg(presence, record->registration, bytes); });
    if (disputed) ask({});
}

/// Under the mutex: an entity that has left.
FrontEndCore::RecordRef FrontEndCore::takeOut(const std::string& entity) {
    const auto found = records_.find(entity);
    auto record = found->second;
    const auto holder = record->status.holder.id;
    records_.erase(found);
    known_.erase(record->registration.entity);
    disputed_.erase(record->registration.entity);
    countBusy(record.get(), nullptr);
    letGo(holder, record->registration.entity);
    return record;
}

/// Under the mutex: the entity names this holder no longer.
void FrontEndCore::letGo(const std::string& holder, const std::string& entity) {
    if (holder.empty()) return;
    if (const auto client = clients_.find(holder); client != clients_.end())
        client->second->setHolds(entity, false);
    holdings_.erase(holder, entity);
    updateHolding(holder);
}

void FrontEndCore::refuseUnknown(ClientOutbox& to, const Header& head) const {
    to.newRefusalMsg(
        head, refuse(RefusalCode::UnknownEntity, "no entity " + head.entity.substr(0, 64) +
                                                     " is connected; 'axon ls' shows those that are there"));
}

/// STATUS of this server, empty = all.
void FrontEndCore::ask(const std::string& server) {
    Header head;
    head.msg_type = kMsgStatus;
    head.entity = server;
    topic_.clientRequest(head);
}

/// Under the mutex: a registration or a status of this server has come.
void FrontEndCore::hearOf(const std::string& server) {
    if (!alone() && !server.empty()) missed_.heard(server);
}

/// Under the mutex.
void FrontEndCore::countBusy(const Record* before, const Record* now) {
    if (alone()) return;
    const auto keeps = [](const Record* record) {
        return record != nullptr && record->status.state == EntityState::BUSY ? record->registration.server
                                                                              : std::string();
    };
    entity_servers_.moveTask(keeps(before), keeps(now), clock_.now());
}

void FrontEndCore::tellLeft(const std::vector<RecordRef>& records) {
    for (const auto& record : records) {
        toClients(Lane::Data, {}, [&](ClientOutbox& client) {
            client.newBasicPrflMsg(Presence::Left, record->registration, {});
        });
    }
}

void FrontEndCore::forget(const std::string& server, const std::unordered_set<std::string>& but) {
    std::vector<RecordRef> left;
    bool disputed = false;
    {
        const std::lock_guard lock(mutex_);
        std::vector<std::string> gone;
        for (const auto& [entity, record] : records_) {
            if (record->registration.server == server && !but.contains(entity)) gone.push_back(entity);
        }
        for (const auto& entity : gone) {
            disputed = disputed || disputed_.contains(entity);
            left.push_back(takeOut(entity));
        }
    }
    tellLeft(left);
    if (disputed) ask({});
    if (!left.empty()) {
        note_("entity server " + server + ": " + std::to_string(left.size()) +
              (left.size() == 1 ? " entity is" : " entities are") + " gone");
    }
}

void FrontEndCore::entityServerEntities(const std::string& server, const std::vector<std::string>& entities) {
    if (alone() || !isServerName(server)) return;
    {
        const std::lock_guard lock(mutex_);
        missed_.answered(server);
    }
    forget(server, {entities.begin(), entities.end()});
}

void FrontEndCore::entityServerUpdate(Lane lane, const ServerAnnouncement& server) {
    if (alone()) return;
    if (entity_servers_.heard(lane, server, clock_.now())) wake_();
    if (lane == Lane::Signal || !isServerName(server.name)) return;
    {
        const std::lock_guard lock(mutex_);
        if (!missed_.announced(server.name, server.published, clock_.now())) return;
    }
    ask(server.name);  // something of it was lost on the way, or it was there first
}

void FrontEndCore::topicFound() {
    topic_.frontEndServerUpdate(Lane::Data, others_.self());
    {
        const std::lock_guard lock(mutex_);
        missed_.askedAll(clock_.now());
    }
    ask({});
}

void FrontEndCore::serversLost(const std::vector<std::string>& names) {
    for (const auto& name : names) {
        note_("entity server " + name + " is gone");
        forget(name, {});
    }
}

void FrontEndCore::serverArrived(const std::string& name) {
    {
        const std::lock_guard lock(mutex_);
        missed_.asked(name, clock_.now());
    }
    ask(name);
}

void FrontEndCore::entityUpdate(EntityStatus status, std::int64_t number, Via via) {
    const bool busy = status.state == EntityState::BUSY;
    std::optional<Gone> late;
    std::string entity, doubt;
    {
        const std::lock_guard lock(mutex_);
        if (via == Via::Topic) hearOf(status.server);
        const auto found = records_.find(status.entity);
        if (found == records_.end()) return;
        if (found->second->registration.server != status.server) {
            if (found->second->status != status) disputed_.insert(status.entity);
            return;
        }
        if (number != 0 && number <= found->second->number) return;
        if (found->second->heard && found->second->status == status) {
            if (number == 0) return;
            auto same = std::make_shared<Record>(*found->second);
            same->number = number;
            found->second = std::move(same);
            return;
        }
        entity = status.entity;
        const auto before = found->second->status.holder.id;
        const auto holder = status.holder.id;
        auto next = std::make_shared<Record>(*found->second);
        next->status = status;
        next->heard = true;
        next->number = number;
        countBusy(found->second.get(), next.get());
        found->second = std::move(next);
        if (before != holder) letGo(before, entity);
        if (!holder.empty()) {
            const auto client = clients_.find(holder);
            if (client != clients_.end()) {
                // An entity that names a client which never asked for it is told of its end like any other,
                // but does not decide how often that client must beat.
                const bool asked = client->second->hasAsked(entity) || AXON_PLANTED(UnaskedHolderBelieved);
                if (!asked && before != holder)
                    doubt =
                        "it names " + client->second->me.name + " as its holder, who has not asked for it";
                client->second->setHolds(entity, true);
                if (holdings_.set(holder, entity, busy && asked)) updateHolding(holder);
            } else if (before != holder && !status.orphaned && isOurs(holder)) {
                // Granted to a client that was gone before the grant was known here, however long ago.
                const auto gone = gone_.find(holder);
                late = gone != gone_.end() ? gone->second : Gone{status.holder, Ending::Lost};
            }
        }
    }
    if (!doubt.empty() && doubts_.admit(clock_.now()))
        note_("entity " + entity + " is not believed: " + doubt);
    if (late && !AXON_PLANTED(LateGrantLeft)) settle(late->sender, late->ending, {{entity, busy}});
    if (busy) wake_();
    // Two copies come on two threads, so a newer one may have been told meanwhile: the last word is the
    // newest.
    while (true) {
        toClients(Lane::Data, {}, [&](ClientOutbox& client) { client.newStatusMsg(status); });
        if (number == 0) return;
        const std::lock_guard lock(mutex_);
        const auto found = records_.find(entity);
        if (found == records_.end() || found->second->number <= number) return;
        status = found->second->status;
        number = found->second->number;
    }
}

void FrontEndCore::entityMsg(Lane lane, const Header& head, std::string_view message) {
    eachOf(lane, head.sender.id, [&](const Client& client, ClientOutbox& outbox) {
        // An entity that a client has asked has its whole queue of the data lane: what that one sends it must
        // read. On the signal lane nobody waits for the lock of that.
        const bool whole = lane == Lane::Data && client.knows(head.entity);
        if (outbox.newEntityMsg(lane, head, message, whole ? QueueShare::Whole : QueueShare::OfSender))
            return;
        if (doubts_.admit(clock_.now()))
            note_("client " + client.me.name + " reads slowly, and entity " + head.entity +
                  " sends it more than its share of the queue: left out");
    });
}

void FrontEndCore::entityMsgDataSeq(const Header& head, std::string_view data) {
    toClients(Lane::Data, head.sender.id,
              [&](ClientOutbox& client) { client.newEntityMsgDataSeq(head, data); });
}

void FrontEndCore::entityRefusal(Lane lane, const Header& head, const Refusal& refusal) {
    if (head.sender.id.empty()) return;
    toClients(lane, head.sender.id, [&](ClientOutbox& client) { client.newRefusalMsg(head, refusal); });
}

TimePoint FrontEndCore::onTimer() {
    std::vector<std::pair<ClientRef, Duration>> silent;
    std::vector<std::pair<ClientRef, std::int64_t>> heartbeats;
    std::vector<std::string> warnings;
    TimePoint next;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        next = now + std::chrono::seconds{1};
        for (const auto& [id, client] : clients_) {
            if (client->liveness.expired(now)) {
                silent.emplace_back(client, client->liveness.timeout());
                continue;
            }
            if (now >= client->warn_again) {
                if (const auto gap = client->liveness.longest(now); gap.part() >= Liveness::kWarnFrom) {
                    client->warn_again = now + Liveness::kWarnAgain;
                    warnings.push_back("client " + client->me.name + " is late: " + describe(gap));
                }
            }
            if (client->next_heartbeat <= now) {
                heartbeats.emplace_back(client, ++client->heartbeats);
                client->next_heartbeat =
                    now + (client->liveness.busy() ? settings_.heartbeat_busy : settings_.heartbeat_idle);
            }
            next = std::min({next, client->next_heartbeat, client->liveness.deadline()});
        }
    }
    for (const auto& [client, timeout] : silent) {
        leave(client, Ending::Lost,
              "nothing was heard of it for " +
                  std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(timeout).count()) +
                  " ms");
    }
    for (const auto& [client, sequence] : heartbeats) client->signalOutbox()->newHeartbeat(sequence);
    next = std::min(next, others_.onTimer(clock_.now()));
    for (const auto& warning : warnings) note_(warning);
    return next;
}

void FrontEndCore::shutDown() {
    table_.each([](const ClientRef& client) {
        client->data->newUpdateMsg(RefusalCode::Unavailable, "the server is shutting down");
    });
}

std::vector<std::string> FrontEndCore::margins() const {
    std::vector<std::string> lines;
    const auto now = clock_.now();
    table_.each([&](const ClientRef& client) {
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
    return records_.size();
}

}  // namespace axon::front_end_server
