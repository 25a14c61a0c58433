// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/entity_server_core.hpp"

#include <algorithm>
#include <utility>

#include "common/liveness.hpp"
#include "common/queue_share.hpp"
#include "common/refuse.hpp"
#include "common/snapshot.hpp"
#include "entity_server/sessions/registration_check.hpp"

namespace axon::entity_server {
namespace {

constexpr std::size_t index(Lane lane) {
    return static_cast<std::size_t>(lane);
}

constexpr auto kData = index(Lane::Data);
constexpr auto kSignal = index(Lane::Signal);
constexpr const char* kDataLaneOnly =
    "registration and status belong on the data lane; send them on that session";
// Another entity server says each 50 ms that it lives; one that is killed does not keep its entities from
// coming here.
constexpr std::chrono::milliseconds kPeerLives{250};

/// Raw data is dropped, oldest first, for an entity that is slower than its peer. False: it is beyond its
/// sender's share.
bool deliver(EntityOutbox& outbox, const Header& head, std::string_view message) {
    if (head.msg_type != kMsgRaw) return outbox.newClientMsg(head, message, QueueShare::OfSender);
    outbox.newClientMsgDataSeq(head, message);
    return true;
}

/// An entity that its client has left behind.
using LeftBehind = std::pair<EntityServerCore::SessionRef, EntityStatus>;

/// What the front-end server would have said, had it lost its client. The clock makes the number new. All
/// stop first.
void loseClients(const std::vector<LeftBehind>& left_behind, TimePoint now) {
    const auto head = [now](const EntityStatus& status) {
        Header head;
        head.sender = status.holder;
        head.entity = status.entity;
        head.sent_at_us = toMicroseconds(now);
        head.sequence = kEntityServerSequences + head.sent_at_us % (kServerSequences / 2);
        return head;
    };
    for (const auto& [session, status] : left_behind)
        session->signal->stopSignal(head(status), StopCause::ClientLost);
    for (const auto& [session, status] : left_behind)
        session->signal->newClientUpdate(head(status), ClientChange::Lost);
}

}  // namespace

EntityServerCore::EntityServerCore(EntityServerCoreSettings settings, const Clock& clock,
                                   RandomSource& random, FrontEndTopic& topic, Note note,
                                   std::function<void()> wake, std::function<void()> pending,
                                   audit::AuditTrail* trail, const users::PresentUsers* users)
    : settings_(settings),
      clock_(clock),
      random_(random),
      topic_(topic),
      note_(std::move(note)),
      wake_(std::move(wake)),
      pending_(std::move(pending)),
      audit_(trail),
      users_(users),
      others_(settings.name, random, note_, [this](Lane lane) { announce(lane); }),
      front_ends_(others_.add({.name = "front-end server",
                               .timeouts = settings.front_ends,
                               .reach = [this](const auto& servers) { topic_.reach(servers); },
                               .lost = [this](const auto& names) { frontEndsLost(names); }})),
      entity_servers_(others_.add({.name = "entity server",
                                   .timeouts = settings.entity_servers,
                                   .reach = [this](const auto& servers) { topic_.reachPeers(servers); },
                                   .lost = [this](const auto& names) { entityServersLost(names); },
                                   .waits_for_announcement = true})),
      elsewhere_(settings.entities_max),
      undelivered_(alone(), clock, topic, note_),
      publisher_(others_.self(), clock, topic, note_, wake_),
      drills_({settings.drill_period, settings.drill_answer}, clock, random) {}

EntityServerCore::~EntityServerCore() = default;

const std::string& EntityServerCore::token(const Session& session) {
    return session.token;
}

EntityServerCore::SessionRef EntityServerCore::open(std::shared_ptr<EntityOutbox> data,
                                                    const std::string& user) {
    const std::lock_guard lock(mutex_);
    auto session = std::make_shared<Session>(++sessions_opened_, Id128::random(random_).toString(),
                                             std::move(data), settings_.messages_per_second, user);
    tokens_.emplace(session->token, session);
    return session;
}

Result<EntityServerCore::SessionRef> EntityServerCore::attach(const std::string& token,
                                                              std::shared_ptr<EntityOutbox> signal) {
    const std::lock_guard lock(mutex_);
    const auto found = tokens_.find(token);
    auto session = found == tokens_.end() ? nullptr : found->second.lock();
    if (!session || session->gone) {
        return refuse(RefusalCode::NotConnected,
                      "no session waits for this token (it is for one use); open a new session and set its "
                      "callback first");
    }
    tokens_.erase(found);
    session->signal = std::move(signal);
    return session;
}

Result<void> EntityServerCore::sendBasicPrfl(const SessionRef& session, Registration registration,
                                             std::string_view profile) {
    const auto id = Id128::parse(registration.entity);
    if (!id) {
        return refuse(RefusalCode::Malformed,
                      "'" + registration.entity.substr(0, 64) +
                          "' is no UUID; remove the Entity Manager's uuid file, it makes a new one");
    }
    if (flooded(session)) return refuse(RefusalCode::Overloaded, "it flooded the server");
    registration.entity = id->toString();
    registration.server = settings_.name;
    if (auto checked = checkRegistration(registration, profile.size(), settings_.profile_bytes_max);
        !checked.ok())
        return checked;
    bool joined = false;
    RecordRef record_now;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        if (session->gone) return refuse(RefusalCode::NotConnected, "the session has ended; connect again");
        // Here, where usersChanged() finds it from now on: nobody slips in between.
        if (!isUser(*session))
            return refuse(
                RefusalCode::PermissionDenied,
                "the user '" + session->user +
                    "' was removed or got another role while the session was being opened; fix: ask "
                    "the administrator of the server for a user of the role entity");
        if (!session->signal) {
            return refuse(
                RefusalCode::WrongState,
                "the signal lane is missing: an entity that could not be stopped is not registered; call "
                "attachSignalLane first");
        }
        if (!session->entity.empty() && session->entity != registration.entity) {
            return refuse(RefusalCode::WrongState, "this session is entity " + session->entity +
                                                       "; open another session for another entity");
        }
        if (session->entity.empty()) {
            if (const auto other = registered_.find(registration.entity); other != registered_.end()) {
                return refuse(RefusalCode::Duplicate,
                              "entity " + registration.entity + " ('" + *other->second->name.load() +
                                  "') is connected already; if the state folder of an Entity Manager was "
                                  "copied, give the copy an "
                                  "empty one (--state), and it becomes another entity");
            }
            const auto at = elsewhere_.serverOf(registration.entity, Lane::Data);
            if (at && entity_servers_.hears(*at, kPeerLives, now)) {
                return refuse(
                    RefusalCode::Duplicate,
                    "entity " + registration.entity + " is connected already, to entity server " + *at +
                        "; if the state folder of an Entity Manager was copied, give the copy an empty "
                        "one (--state), and it becomes another entity");
            }
            if (registered_.size() >= settings_.entities_max) {
                return refuse(RefusalCode::Overloaded, "the server has its " +
                                                           std::to_string(settings_.entities_max) +
                                                           " entities; raise EntityServer.EntitiesMax");
            }
            session->entity = registration.entity;
            session->drill = std::make_shared<Drills::Subject>(session->entity);
        }
        session->name.store(std::make_shared<const std::string>(registration.name));
        auto record =
            session->record ? std::make_shared<Record>(*session->record) : std::make_shared<Record>();
        const bool busy = record->status.state == EntityState::BUSY;
        const std::chrono::milliseconds busy_period{registration.heartbeat_busy_ms};
        const std::chrono::milliseconds idle_period{registration.heartbeat_idle_ms};
        record->status.entity = registration.entity;
        record->status.server = settings_.name;
        record->registration = std::move(registration);
        record->profile = std::make_shared<const std::string>(profile);
        record->session = session->number;
        session->record = std::move(record);
        session->liveness.setTimeouts(settings_.heartbeats_missed * busy_period,
                                      settings_.heartbeats_missed * idle_period, now);
        session->liveness.setBusy(busy, now);
        if (!session->registered) {
            session->registered = joined = true;
            others_.announceSoon();
            registered_.emplace(session->entity, session);
            drills_.join(session->drill);
            table_.put(session->entity, session);
            session->restartHeartbeats(now);
        }
        due_.schedule(session, std::min(session->nextHeartbeat(), now + session->period()));
        publisher_.set(session->record);  // last: from now on others may be told that it is here
        record_now = session->record;
    }
    if (joined) audit_.joined(record_now->registration);
    wake_();
    publishPending();
    return {};
}

void EntityServerCore::sendStatus(const SessionRef& session, EntityStatus status) {
    if (!session->registered || flooded(session)) return;
    status.entity = session->entity;
    status.server = settings_.name;
    for (auto* text : {&status.holder.id, &status.holder.name, &status.reason}) makeValid(*text);
    bool became_busy = false;
    bool late = false;  // given to a client whose server is gone, which its Entity Manager did not know
    std::int64_t heartbeat = 0;
    std::string line;
    EntityStatus given;
    RecordRef record_before, record_now;
    {
        const std::lock_guard lock(mutex_);
        if (session->gone) return;
        const auto now = clock_.now();
        const bool busy = status.state == EntityState::BUSY;
        record_before = session->record;
        const auto& before = record_before->status;
        line = session->holder_log.line(*session->name.load(), before, status, now);
        if (before.holder.id != status.holder.id)
            session->holder.store(std::make_shared<const std::string>(status.holder.id));
        const bool granted = !status.orphaned && (before.orphaned || before.holder.id != status.holder.id);
        late = granted && !front_ends_.serves(status.holder.id);
        if (late) given = status;
        countBusy(before, status, now);
        became_busy = busy && !session->liveness.busy();
        const bool became_idle = !busy && session->liveness.busy();
        session->liveness.setBusy(busy, now);
        status.stop_latency_us = session->drill->stopLatencyUs();
        Drills::setReady(*session->drill, !status.latched && status.state != EntityState::UNAV &&
                                              status.state != EntityState::INIT);
        auto record = std::make_shared<Record>(*session->record);
        record->status = std::move(status);
        record->heard = true;
        session->record = std::move(record);
        publisher_.set(session->record);
        record_now = session->record;
        // The EM's own watchdog is short from now on.
        if (became_busy) heartbeat = session->extraHeartbeat();
        if (became_busy || became_idle) {
            session->restartHeartbeats(now);
            due_.schedule(session, session->nextHeartbeat());
        }
    }
    if (became_busy) {
        session->signal->newHeartbeat(heartbeat);
        wake_();
    }
    if (late) loseClients({{session, given}}, clock_.now());
    if (late && !given.holder.id.empty()) audit_.stoppedForLostClient(given);
    publishPending();
    if (!line.empty()) note_(line);
    audit_.holder(record_now->registration.name, record_before->status, record_now->status);
}

void EntityServerCore::refuseOnSignalLane(const SessionRef& session, const char* msg_type) {
    Header head;
    if (session->registered) head.entity = session->entity;
    head.msg_type = msg_type;
    session->data->newRefusalMsg(head, refuse(RefusalCode::WrongState, kDataLaneOnly));
}

bool EntityServerCore::flooded(const SessionRef& session) {
    if (session->limits.admit(clock_.now())) return false;
    session->data->disconnect(false, "it flooded the server (more than " +
                                         std::to_string(settings_.messages_per_second) +
                                         " messages in a second)");
    return true;
}

void EntityServerCore::sendToClient(const SessionRef& session, Lane lane, Header head,
                                    std::string_view message) {
    if (!session->registered || flooded(session)) return;
    if (drills_.isDrill(head)) {
        if (drills_.answer(*session->drill, head)) wake_();
        return;
    }
    head.entity = session->entity;
    if (const auto may = session->limits.toClient(lane, message, clock_); !may.ok())
        return session->outbox(lane).newRefusalMsg(head, may.refusal());
    topic_.entityMsg(lane, head, message);
}

void EntityServerCore::sendToClientDataSeq(const SessionRef& session, Header head, std::string_view data) {
    if (!session->registered) return;
    head.entity = session->entity;
    topic_.entityMsgDataSeq(head, data);
}

void EntityServerCore::sendToPeer(const SessionRef& session, Lane lane, Header head,
                                  std::string_view message) {
    if (!session->registered || flooded(session)) return;
    if (const auto may = session->limits.toPeer(lane, head, message, clock_); !may.ok())
        return session->outbox(lane).newRefusalMsg(head, may.refusal());
    head.sender = {session->entity, *session->name.load(), Role::Operator};
    if (const auto peer = table_.find(head.entity, index(lane))) {
        if (!deliver(peer->outbox(lane), head, message)) {
            session->outbox(lane).newRefusalMsg(head, slowEntity(head));
            undelivered_.noteSlow(head);
        }
        return;
    }
    const auto at = elsewhere_.serverOf(head.entity, lane);
    if (!at) return session->outbox(lane).newRefusalMsg(head, unknownEntity(head.entity));
    if (const auto sent = topic_.peerMsg(lane, *at, head, message); !sent.ok())
        session->outbox(lane).newRefusalMsg(head, sent.refusal());
}

void EntityServerCore::peerMsg(Lane lane, const Header& head, std::string_view message) {
    const auto peer = table_.find(head.entity, index(lane));
    if (peer && deliver(peer->outbox(lane), head, message)) return;
    if (peer) undelivered_.noteSlow(head);
    // Or it left before that was known at the sender's server.
    if (const auto from = elsewhere_.serverOf(head.sender.id, lane))
        topic_.peerRefusal(lane, *from, head, peer ? slowEntity(head) : unknownEntity(head.entity));
}

void EntityServerCore::clientUnreached(const Header& head, const Refusal& refusal) {
    if (const auto sender = table_.find(head.entity, index(Lane::Data)))
        sender->data->newRefusalMsg(head, refusal);
}

void EntityServerCore::peerRefusal(Lane lane, const Header& head, const Refusal& refusal) {
    if (const auto sender = table_.find(head.sender.id, index(lane)))
        sender->outbox(lane).newRefusalMsg(head, refusal);
}

void EntityServerCore::keepAlive(const SessionRef& session) {
    session->liveness.heard(clock_.now());
}

bool EntityServerCore::isUser(const Session& session) const {
    return users_ == nullptr || session.user.empty() || users_->mayBeEntityManager(session.user);
}

void EntityServerCore::usersChanged() {
    // Decided without the mutex, which heartbeats need: whoever registers in between is asked there.
    std::vector<SessionRef> here;
    {
        const std::lock_guard lock(mutex_);
        here.reserve(registered_.size());
        for (const auto& [entity, session] : registered_) here.push_back(session);
    }
    for (const auto& session : here)
        if (!isUser(*session))
            leave(session, false, "the user '" + session->user + "' was removed or got another role");
}

void EntityServerCore::leave(const SessionRef& session, bool orderly, const std::string& why) {
    std::size_t lines_left_out = 0;
    {
        const std::lock_guard lock(mutex_);
        if (session->gone) return;
        session->gone = true;
        lines_left_out = session->holder_log.leftOut();
        tokens_.erase(session->token);
        if (session->registered) {
            countBusy(session->record->status, {}, clock_.now());
            others_.announceSoon();
            registered_.erase(session->entity);
            drills_.leave(session->drill);
            table_.erase(session->entity);
            publisher_.left(session->entity);
        }
    }
    session->data->disconnect(orderly, why);
    if (session->signal) session->signal->disconnect(orderly, why);
    if (session->registered) {
        pending_();
        audit_.left(session->entity, *session->name.load(), why);
        note_(*session->name.load() + " left: " + why +
              (lines_left_out > 0
                   ? " (" + std::to_string(lines_left_out) + " changes of its holder are not in the log)"
                   : ""));
    }
}

void EntityServerCore::clientMsg(const Header& head, std::string_view message, Via via) {
    const auto entity = table_.find(head.entity, kData);
    if (!entity) return undelivered_.unknown(Lane::Data, head, via);
    // Its holder's orders are never refused for what others send: it has the whole queue.
    const auto share = head.sender.id == *entity->holder.load() ? QueueShare::Whole : QueueShare::OfSender;
    if (!entity->data->newClientMsg(head, message, share)) return undelivered_.slow(Lane::Data, head);
    if (!alone()) audit_.command(head);  // as for stops
}

void EntityServerCore::clientMsgDataSeq(const Header& head, std::string_view data, Via via) {
    const auto entity = table_.find(head.entity, kData);
    if (!entity) return undelivered_.unknownData(head, via);
    entity->data->newClientMsgDataSeq(head, data);
    if (!alone()) audit_.command(head);
}

void EntityServerCore::clientRequest(const Header& head) {
    if (head.msg_type != kMsgStatus) return;
    if (!head.entity.empty() && head.entity != settings_.name) return;
    publisher_.again();
    publishPending();
}

void EntityServerCore::topicFound() {
    publisher_.announce();
    publisher_.again();
    publishPending();
}

// No lock that a message could hold: this is the signal lane, too.
void EntityServerCore::frontEndServerUpdate(Lane lane, const ServerAnnouncement& server,
                                            const std::string& users) {
    if (alone()) return;
    const auto now = clock_.now();
    if (front_ends_.heard(lane, server, now)) wake_();
    if (users_ == nullptr || users.empty() || !isServerName(server.name)) return;
    if (const auto line =
            agreement_.heard("front-end server " + server.name, users, users_->fingerprint(), now);
        !line.empty())
        note_(line);
}

void EntityServerCore::serverRefused(const std::string& server, const std::string& signals) {
    if (front_ends_.refused(server, signals) || entity_servers_.refused(server, signals)) wake_();
}

void EntityServerCore::entityServerUpdate(Lane lane, const ServerAnnouncement& server,
                                          const std::vector<std::string>& entities) {
    if (alone() || server.name == settings_.name || !isServerName(server.name)) return;
    if (entity_servers_.heard(lane, server, clock_.now())) wake_();
    // What is late of one that is gone is not believed; should it come back, it says so again.
    if (lane == Lane::Data && !entity_servers_.lost(server.name)) elsewhere_.learn(server.name, entities);
}

/// Under the registry's mutex.
void EntityServerCore::countBusy(const EntityStatus& before, const EntityStatus& now, TimePoint at) {
    if (alone()) return;
    const auto keeps = [](const EntityStatus& status) {
        return std::string(status.state == EntityState::BUSY ? originOf(status.holder.id).server
                                                             : std::string_view());
    };
    const auto was = keeps(before);
    const auto is = keeps(now);
    front_ends_.moveTask(was, is, at);
    if (was != is && !is.empty()) wake_();
}

void EntityServerCore::announce(Lane lane) {
    if (lane == Lane::Signal) {
        topic_.entityServerUpdate(lane, others_.self());
        topic_.peersUpdate(lane, others_.self(), {});
        return;
    }
    publisher_.announce();
    pending_();
}

void EntityServerCore::frontEndsLost(const std::vector<std::string>& names) {
    std::vector<LeftBehind> left_behind;
    {
        const std::lock_guard lock(mutex_);
        for (const auto& [entity, session] : registered_) {
            const auto& status = session->record->status;
            if (!status.orphaned && !front_ends_.serves(status.holder.id))
                left_behind.emplace_back(session, status);
        }
    }
    // First of all who may be moving.
    std::stable_partition(left_behind.begin(), left_behind.end(),
                          [](const auto& one) { return one.second.state == EntityState::BUSY; });
    loseClients(left_behind, clock_.now());
    for (const auto& [session, status] : left_behind) audit_.stoppedForLostClient(status);
    for (const auto& name : names) {
        note_("front-end server " + name + " is gone; its clients held " +
              std::to_string(left_behind.size()) + (left_behind.size() == 1 ? " entity" : " entities") +
              " here");
    }
}

void EntityServerCore::entityServersLost(const std::vector<std::string>& names) {
    for (const auto& name : names) {
        elsewhere_.learn(name, {});
        note_("entity server " + name + " is gone");
    }
}

/// `send` returns whether the outbox took it. All that take it first: no entity's stop waits for others'
/// refusals.
template <class Send>
bool EntityServerCore::toEntities(const Header& head, Send&& send) {
    if (!head.entity.empty()) {
        const auto entity = table_.find(head.entity, kSignal);
        if (!entity) {
            undelivered_.unknown(Lane::Signal, head);
            return false;
        }
        if (!send(*entity->signal)) undelivered_.slow(Lane::Signal, head);
        return true;
    }
    std::vector<std::string> slow;
    table_.each(
        [&](const SessionRef& session) {
            if (!send(*session->signal)) slow.push_back(session->entity);
        },
        kSignal);
    undelivered_.slow(head, slow);
    return true;
}

void EntityServerCore::clientUpdate(const Header& head, ClientChange change) {
    if (const auto entity = table_.find(head.entity, kSignal)) entity->signal->newClientUpdate(head, change);
}

void EntityServerCore::stopSignal(const Header& head, StopCause cause) {
    const bool passed =
        toEntities(head, [&](EntityOutbox& entity) { return entity.stopSignal(head, cause); });
    // What the only front-end server passes on, it has recorded beside this one.
    if (passed && !alone()) audit_.signal(cause == StopCause::Drill ? "drill" : "stop", head, 0);
}

// All that are there first: no entity's stop waits for the refusals of those that are not.
void EntityServerCore::stopSignals(const Header& head, const std::vector<std::string>& entities,
                                   StopCause cause) {
    std::vector<const std::string*> unknown;
    std::vector<std::string> slow;
    for (const auto& entity : entities) {
        const auto found = table_.find(entity, kSignal);
        if (!found)
            unknown.push_back(&entity);
        else if (!found->signal->stopSignal(head, cause))
            slow.push_back(entity);
    }
    undelivered_.slow(head, slow);
    auto refused = head;
    for (const auto* entity : unknown) {
        refused.entity = entity->substr(0, 64);
        undelivered_.unknown(Lane::Signal, refused);
    }
    if (unknown.size() < entities.size() && !alone())
        audit_.signal(cause == StopCause::Drill ? "drill" : "stop", head, entities.size() - unknown.size());
}

void EntityServerCore::resetSignal(const Header& head) {
    const bool passed = toEntities(head, [&](EntityOutbox& entity) { return entity.resetSignal(head); });
    if (passed && !alone()) audit_.signal("reset", head, 0);
}

void EntityServerCore::clearSignal(const Header& head) {
    const bool passed = toEntities(head, [&](EntityOutbox& entity) { return entity.clearSignal(head); });
    if (passed && !alone()) audit_.signal("clear", head, 0);
}

TimePoint EntityServerCore::onTimer() {
    std::vector<std::pair<SessionRef, std::int64_t>> heartbeats;
    std::vector<std::pair<SessionRef, Duration>> silent;
    std::vector<std::string> warnings;
    TimePoint next;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        while (const auto session = due_.take(now)) {
            if (session->liveness.expired(now)) {
                silent.emplace_back(session, session->liveness.timeout());
                continue;
            }
            if (const auto gap = session->warning(now))
                warnings.push_back(*session->name.load() + " is late: " + describe(*gap));
            if (const auto number = session->dueHeartbeat(now)) heartbeats.emplace_back(session, *number);
            due_.schedule(session,
                          std::min(std::max(session->nextHeartbeat(), now + std::chrono::milliseconds{1}),
                                   session->liveness.deadline()));
        }
        next = due_.next().value_or(now + std::chrono::seconds{1});
    }
    if (publisher_.endPauses()) pending_();
    next = std::min(next, publisher_.nextPause());
    for (const auto& [session, sequence] : heartbeats) session->signal->newHeartbeat(sequence);
    for (const auto& [session, timeout] : silent) {
        leave(session, false,
              "nothing was heard of it for " +
                  std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(timeout).count()) +
                  " ms");
    }
    next = std::min(next, others_.onTimer(clock_.now()));
    for (const auto& warning : warnings) note_(warning);
    return drills_.on() ? std::min(next, onDrillTimer()) : next;
}

TimePoint EntityServerCore::onDrillTimer() {
    bool changed = false;
    std::vector<std::string> lines;
    std::vector<std::pair<SessionRef, Drills::Order>> orders;
    TimePoint next;
    {
        const std::lock_guard lock(mutex_);
        for (const auto& done : drills_.settle()) {
            const auto& session = registered_.find(done.of->entity())->second;
            if (!done.answered) {
                lines.push_back(*session->name.load() + " has not answered a drill within " +
                                std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(
                                                   settings_.drill_answer)
                                                   .count()) +
                                " ms: how long a stop takes there is unknown");
            }
            if (!done.changed) continue;
            auto record = std::make_shared<Record>(*session->record);
            record->status.stop_latency_us = done.of->stopLatencyUs();
            session->record = std::move(record);
            publisher_.set(session->record);
            changed = true;
        }
        for (auto& order : drills_.next()) {
            const auto& session = registered_.find(order.to->entity())->second;
            orders.emplace_back(session, std::move(order));
        }
        next = drills_.nextDeadline();
    }
    for (auto& [session, order] : orders) {
        drills_.begin(order);
        session->signal->stopSignal(order.head, StopCause::Drill);
    }
    for (const auto& line : lines) note_(line);
    if (changed) pending_();
    return next;
}

std::vector<std::string> EntityServerCore::margins() const {
    std::vector<std::string> lines;
    const std::lock_guard lock(mutex_);
    const auto now = clock_.now();
    for (const auto& [entity, session] : registered_) {
        lines.push_back(*session->name.load() + ": " + describe(session->liveness.longest(now)) +
                        (session->drill->stopLatencyUs() > 0
                             ? "; a stop takes " + std::to_string(session->drill->stopLatencyUs()) + " us"
                             : ""));
    }
    return lines;
}

std::shared_ptr<const std::string> EntityServerCore::serverOf(const std::string& entity, Lane lane) const {
    // First this server's own: another one that announces one of them is not believed.
    if (table_.find(entity, index(lane)))
        return {std::shared_ptr<const void>(), &settings_.name};  // which lives as long as this object
    return elsewhere_.serverOf(entity, lane);
}

std::size_t EntityServerCore::entities() const {
    const std::lock_guard lock(mutex_);
    return registered_.size();
}

void EntityServerCore::publishPending() {
    publisher_.publishPending();
}

}  // namespace axon::entity_server
