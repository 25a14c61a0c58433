// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/entity_server_core.hpp"

#include <algorithm>
#include <utility>

namespace axon::entity_server {

class EntityServerCore::Session {
  public:
    Session(std::uint64_t its_number, std::string its_token, std::shared_ptr<EntityOutbox> its_data,
            std::uint32_t messages_per_second)
        : number(its_number),
          token(std::move(its_token)),
          data(std::move(its_data)),
          rate(messages_per_second) {}

    // Constant after construction.
    const std::uint64_t number;
    const std::string token;
    const std::shared_ptr<EntityOutbox> data;

    // Written once, before `registered` is; read by others only after it.
    std::shared_ptr<EntityOutbox> signal;
    std::string entity;
    std::string name;
    std::atomic<bool> registered{false};

    RateLimit rate;
    std::atomic<Duration::rep> heard{0};  // the last sign of life, on the clock; written without a lock

    // Guarded by the core's mutex.
    RecordRef record;
    std::unique_ptr<Watchdog> watchdog;
    TimePoint next_heartbeat;
    std::uint64_t revision = 0;  // of its entry in the due queue; older entries are void
    std::int64_t heartbeats = 0;
    TimePoint fed;  // the last sign of life that the watchdog was told
    bool gone = false;

    /// Tells the watchdog of the signs of life since it was told last.
    void listen() {
        const TimePoint last{Duration{heard.load(std::memory_order_relaxed)}};
        if (last <= fed || !watchdog) return;
        fed = last;
        watchdog->feed(last);
    }
    Duration period() const {
        const auto& registration = record->registration;
        return std::chrono::milliseconds{watchdog->busy() ? registration.heartbeat_busy_ms
                                                          : registration.heartbeat_idle_ms};
    }
};

namespace {

Refusal refuse(RefusalCode code, std::string message) {
    return {code, std::move(message), {}};
}

constexpr int kHeartbeatMinMs = 10;
constexpr int kHeartbeatMaxMs = 60'000;
constexpr std::size_t kNameMax = 256;

Result<void> check(const Registration& registration, std::size_t profile_bytes,
                   std::size_t profile_bytes_max) {
    if (registration.name.empty() || registration.name.size() > kNameMax) {
        return refuse(RefusalCode::BadName,
                      "the entity's name must have 1 to 256 characters; mend <entity_name> in the "
                      "basic profile");
    }
    for (const int period : {registration.heartbeat_busy_ms, registration.heartbeat_idle_ms}) {
        if (period < kHeartbeatMinMs || period > kHeartbeatMaxMs) {
            return refuse(RefusalCode::OutOfRange,
                          "a heartbeat period of " + std::to_string(period) +
                              " ms: expected 10 to 60000 ms; mend it in the Entity Manager's "
                              "configuration");
        }
    }
    if (profile_bytes > profile_bytes_max) {
        return refuse(RefusalCode::TooLarge, "the basic profile has " + std::to_string(profile_bytes) +
                                                 " bytes; expected at most " +
                                                 std::to_string(profile_bytes_max));
    }
    return {};
}

}  // namespace

EntityServerCore::EntityServerCore(CoreSettings settings, const Clock& clock, RandomSource& random,
                                   FrontEndTopic& topic, Note note, std::function<void()> wake,
                                   std::function<void()> pending)
    : settings_(settings),
      clock_(clock),
      random_(random),
      topic_(topic),
      note_(std::move(note)),
      wake_(std::move(wake)),
      pending_(std::move(pending)) {}

EntityServerCore::~EntityServerCore() = default;

const std::string& EntityServerCore::token(const Session& session) {
    return session.token;
}

EntityServerCore::SessionRef EntityServerCore::open(std::shared_ptr<EntityOutbox> data) {
    const std::lock_guard lock(mutex_);
    auto session = std::make_shared<Session>(++sessions_opened_, Id128::random(random_).toString(),
                                             std::move(data), settings_.messages_per_second);
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
    registration.entity = id->toString();
    if (auto checked = check(registration, profile.size(), settings_.profile_bytes_max); !checked.ok())
        return checked;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        if (session->gone) return refuse(RefusalCode::NotConnected, "the session has ended; connect again");
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
                              "entity " + registration.entity + " ('" + other->second->name +
                                  "') is connected already; if the state folder of an Entity Manager was "
                                  "copied, delete "
                                  "the file uuid in the copy, and it makes a new one");
            }
            if (registered_.size() >= settings_.entities_max) {
                return refuse(RefusalCode::Overloaded, "the server has its " +
                                                           std::to_string(settings_.entities_max) +
                                                           " entities; raise EntityServer.EntitiesMax");
            }
            session->entity = registration.entity;
            session->name = registration.name;
        }
        auto record =
            session->record ? std::make_shared<Record>(*session->record) : std::make_shared<Record>();
        const bool busy = record->status.state == EntityState::BUSY;
        const std::chrono::milliseconds busy_period{registration.heartbeat_busy_ms};
        const std::chrono::milliseconds idle_period{registration.heartbeat_idle_ms};
        record->status.entity = registration.entity;
        record->registration = std::move(registration);
        record->profile = std::make_shared<const std::string>(profile);
        record->session = session->number;
        session->record = std::move(record);
        session->watchdog = std::make_unique<Watchdog>(settings_.heartbeats_missed * busy_period,
                                                       settings_.heartbeats_missed * idle_period, now);
        session->watchdog->setBusy(busy, now);
        session->fed = now;
        if (!session->registered) {
            session->registered = true;
            registered_.emplace(session->entity, session);
            rebuildTables();
            // Spread, so that many that joined together are not served all at once for ever.
            session->next_heartbeat = now + session->period() * static_cast<int>(session->number % 16) / 16;
        }
        schedule(session, std::min(session->next_heartbeat, now + session->period()));
    }
    wake_();
    leaveToPublisher(session->entity);
    publishPending();
    return {};
}

void EntityServerCore::sendStatus(const SessionRef& session, EntityStatus status) {
    if (!session->registered) return;
    status.entity = session->entity;
    bool became_busy = false;
    std::int64_t heartbeat = 0;
    std::string line;
    {
        const std::lock_guard lock(mutex_);
        if (session->gone) return;
        const auto now = clock_.now();
        const bool busy = status.state == EntityState::BUSY;
        const auto& before = session->record->status;
        if (before.holder.id != status.holder.id) {
            line = status.holder.id.empty() ? session->name + " is free, released by " + before.holder.name
                                            : session->name + " is checked out by " + status.holder.name;
        }
        became_busy = busy && !session->watchdog->busy();
        session->listen();
        session->watchdog->setBusy(busy, now);
        auto record = std::make_shared<Record>(*session->record);
        record->status = std::move(status);
        session->record = std::move(record);
        if (became_busy) {
            // The EM's own watchdog is short from now on.
            heartbeat = ++session->heartbeats;
            session->next_heartbeat = now + session->period();
            schedule(session, session->next_heartbeat);
        }
    }
    if (became_busy) {
        session->signal->newHeartbeat(heartbeat);
        wake_();
    }
    leaveToPublisher(session->entity);
    publishPending();
    if (!line.empty()) note_(line);
}

bool EntityServerCore::flooded(const SessionRef& session) {
    if (session->rate.admit(clock_.now())) return false;
    session->data->disconnect(false, "it flooded the server (more than " +
                                         std::to_string(settings_.messages_per_second) +
                                         " messages in a second)");
    return true;
}

void EntityServerCore::sendSvcPrflRecord(const SessionRef& session, Header head, std::int32_t record_id,
                                         std::int32_t count, std::string_view record) {
    if (!session->registered || flooded(session)) return;
    head.entity = session->entity;
    topic_.entitySvcRecord(head, record_id, count, record);
}

void EntityServerCore::sendToClient(const SessionRef& session, Lane lane, Header head,
                                    std::string_view message) {
    if (!session->registered || flooded(session)) return;
    head.entity = session->entity;
    topic_.entityMsg(lane, head, message);
}

void EntityServerCore::sendToClientDataSeq(const SessionRef& session, Header head, std::string_view data) {
    if (!session->registered) return;
    head.entity = session->entity;
    topic_.entityMsgDataSeq(head, data);
}

void EntityServerCore::sendToPeer(const SessionRef& session, Header head, std::string_view message) {
    if (!session->registered || flooded(session)) return;
    head.sender = {session->entity, session->name, Role::Operator};
    const auto table = data_table_.load();
    if (const auto peer = table->find(head.entity); peer != table->end()) {
        peer->second->data->newClientMsg(head, message);
    } else {
        session->data->newRefusalMsg(
            head,
            refuse(RefusalCode::UnknownEntity, "no entity " + head.entity.substr(0, 64) + " is connected"));
    }
}

void EntityServerCore::keepAlive(const SessionRef& session) {
    session->heard.store(clock_.now().time_since_epoch().count(), std::memory_order_relaxed);
}

void EntityServerCore::leave(const SessionRef& session, bool orderly, const std::string& why) {
    {
        const std::lock_guard lock(mutex_);
        if (session->gone) return;
        session->gone = true;
        tokens_.erase(session->token);
        if (session->registered) {
            registered_.erase(session->entity);
            rebuildTables();
        }
    }
    session->data->disconnect(orderly, why);
    if (session->signal) session->signal->disconnect(orderly, why);
    if (session->registered) {
        leaveToPublisher(session->entity);
        pending_();
        note_(session->name + " left: " + why);
    }
}

void EntityServerCore::rebuildTables() {
    auto table = std::make_shared<Table>();
    table->reserve(registered_.size());
    for (const auto& [entity, session] : registered_) table->emplace(session->entity, session);
    data_table_.store(table);
    signal_table_.store(std::move(table));
}

void EntityServerCore::refuseUnknown(Lane lane, const Header& head) {
    topic_.entityRefusal(
        lane, head,
        refuse(RefusalCode::UnknownEntity, "no entity " + head.entity.substr(0, 64) +
                                               " is connected; 'axon ls' shows those that are there"));
}

// Data is not answered message by message: a sender that streams to an entity that left needs one answer.
bool EntityServerCore::refusedLately(const std::string& sender) {
    constexpr std::size_t kRemembered = 4096;
    const auto now = clock_.now();
    const std::lock_guard lock(refused_mutex_);
    const auto found = refused_.find(sender);
    if (found != refused_.end() && now - found->second < std::chrono::seconds{1}) return true;
    if (found == refused_.end() && refused_.size() >= kRemembered) refused_.clear();
    refused_[sender] = now;
    return false;
}

void EntityServerCore::clientMsg(const Header& head, std::string_view message) {
    const auto table = data_table_.load();
    const auto entity = table->find(head.entity);
    if (entity == table->end()) return refuseUnknown(Lane::Data, head);
    entity->second->data->newClientMsg(head, message);
}

void EntityServerCore::clientMsgDataSeq(const Header& head, std::string_view data) {
    const auto table = data_table_.load();
    const auto entity = table->find(head.entity);
    if (entity == table->end()) {
        if (!refusedLately(head.sender.id)) refuseUnknown(Lane::Data, head);
        return;
    }
    entity->second->data->newClientMsgDataSeq(head, data);
}

void EntityServerCore::clientRequest(const Header& head) {
    if (head.msg_type != kMsgStatus) return;
    std::vector<RecordRef> records;
    {
        const std::lock_guard lock(mutex_);
        records.reserve(registered_.size());
        for (const auto& [entity, session] : registered_) records.push_back(session->record);
    }
    for (const auto& record : records) {
        topic_.entityBasicPrflUpdate(Presence::Changed, record->registration, *record->profile);
        topic_.entityUpdate(record->status);
    }
}

template <class Send>
void EntityServerCore::toEntities(const Header& head, Send&& send) {
    const auto table = signal_table_.load();
    if (head.entity.empty()) {
        for (const auto& [entity, session] : *table) send(*session->signal);
        return;
    }
    const auto entity = table->find(head.entity);
    if (entity == table->end()) return refuseUnknown(Lane::Signal, head);
    send(*entity->second->signal);
}

void EntityServerCore::clientUpdate(const Header& head, ClientChange change) {
    const auto table = signal_table_.load();
    const auto entity = table->find(head.entity);
    if (entity != table->end()) entity->second->signal->newClientUpdate(head, change);
}

void EntityServerCore::stopSignal(const Header& head, StopCause cause) {
    toEntities(head, [&](EntityOutbox& entity) { entity.stopSignal(head, cause); });
}

// All that are there first: no entity's stop waits for the refusals of those that are not.
void EntityServerCore::stopSignals(const Header& head, const std::vector<std::string>& entities,
                                   StopCause cause) {
    const auto table = signal_table_.load();
    std::vector<const std::string*> unknown;
    for (const auto& entity : entities) {
        const auto found = table->find(entity);
        if (found != table->end()) {
            found->second->signal->stopSignal(head, cause);
        } else {
            unknown.push_back(&entity);
        }
    }
    auto refused = head;
    for (const auto* entity : unknown) {
        refused.entity = entity->substr(0, 64);
        refuseUnknown(Lane::Signal, refused);
    }
}

void EntityServerCore::resetSignal(const Header& head) {
    toEntities(head, [&](EntityOutbox& entity) { entity.resetSignal(head); });
}

void EntityServerCore::clearSignal(const Header& head) {
    toEntities(head, [&](EntityOutbox& entity) { entity.clearSignal(head); });
}

void EntityServerCore::schedule(const SessionRef& session, TimePoint at) {
    due_.push({at, ++session->revision, session});
}

TimePoint EntityServerCore::onTimer() {
    std::vector<std::pair<SessionRef, std::int64_t>> heartbeats;
    std::vector<std::pair<SessionRef, Duration>> silent;
    TimePoint next;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        while (!due_.empty() && due_.top().at <= now) {
            const auto due = due_.top();
            due_.pop();
            const auto session = due.session.lock();
            if (!session || session->gone || session->revision != due.revision) continue;
            session->listen();
            if (session->watchdog->expired(now)) {
                silent.emplace_back(session, session->watchdog->timeout());
                continue;
            }
            if (session->next_heartbeat <= now) {
                heartbeats.emplace_back(session, ++session->heartbeats);
                // Catching up after a pause would only send a burst.
                session->next_heartbeat = std::max(session->next_heartbeat + session->period(), now);
            }
            schedule(session, std::min(std::max(session->next_heartbeat, now + std::chrono::milliseconds{1}),
                                       session->watchdog->deadline()));
        }
        next = due_.empty() ? now + std::chrono::seconds{1} : due_.top().at;
    }
    for (const auto& [session, sequence] : heartbeats) session->signal->newHeartbeat(sequence);
    for (const auto& [session, timeout] : silent) {
        leave(session, false,
              "nothing was heard of it for " +
                  std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(timeout).count()) +
                  " ms");
    }
    return next;
}

std::size_t EntityServerCore::entities() const {
    const std::lock_guard lock(mutex_);
    return registered_.size();
}

// Front-end servers are told of levels: what is now, compared with what was told last. One thread publishes
// at a time, so that they hear of one entity in order though no lock is held while they are told; a thread
// that finds another one publishing leaves the entity's name behind and goes.
void EntityServerCore::leaveToPublisher(const std::string& entity) {
    const std::lock_guard lock(mutex_);
    if (!std::exchange(waiting_to_publish_[entity], true)) to_publish_.push_back(entity);
}

void EntityServerCore::publishPending() {
    {
        const std::lock_guard lock(mutex_);
        if (publishing_) return;
        publishing_ = true;
    }
    while (true) {
        std::string one;
        RecordRef before;
        RecordRef now;
        {
            const std::lock_guard lock(mutex_);
            if (to_publish_.empty()) {
                publishing_ = false;
                return;
            }
            one = std::move(to_publish_.front());
            to_publish_.pop_front();
            waiting_to_publish_.erase(one);
            if (const auto found = published_.find(one); found != published_.end()) before = found->second;
            if (const auto found = registered_.find(one); found != registered_.end())
                now = found->second->record;
            if (now) {
                published_[one] = now;
            } else {
                published_.erase(one);
            }
        }
        publishOne(one, before, now);
    }
}

void EntityServerCore::publishOne(const std::string& entity, const RecordRef& before, const RecordRef& now) {
    const bool same_session = before && now && before->session == now->session;
    if (before && !same_session) topic_.entityBasicPrflUpdate(Presence::Left, before->registration, {});
    if (!now) return;
    if (!same_session) {
        topic_.entityBasicPrflUpdate(Presence::Joined, now->registration, *now->profile);
        note_(now->registration.name + " joined (" + entity + ")");
    } else if (now->registration != before->registration || *now->profile != *before->profile) {
        topic_.entityBasicPrflUpdate(Presence::Changed, now->registration, *now->profile);
    }
    if (!same_session || now->status != before->status) topic_.entityUpdate(now->status);
}

}  // namespace axon::entity_server
