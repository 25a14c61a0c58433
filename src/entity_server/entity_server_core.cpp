// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/entity_server_core.hpp"

#include <algorithm>
#include <charconv>
#include <optional>
#include <unordered_set>
#include <utility>

#include "common/entity_name.hpp"
#include "common/liveness.hpp"
#include "common/pace.hpp"
#include "common/queue_share.hpp"
#include "common/rights.hpp"
#include "common/snapshot.hpp"
#include "common/utf8.hpp"

namespace axon::entity_server {
namespace {

// Of one entity for all others, of messages of runs: in one what a step may give back, which is a frame of
// the link and some more; in a second the invitations of the largest run twice over. Raw data gives way by
// itself.
constexpr std::size_t kPeerBytes = (1024 + 64) * 1024U;
constexpr std::uint32_t kPeerBytesPerSecond = 8 * 1024 * 1024U;
// Of one entity for anybody on a signal lane, which stops share: beats and ends of runs, receipts, refusals.
constexpr std::size_t kSignalBytes = 16 * 1024U;
constexpr std::uint32_t kSignalBytesPerSecond = 1024 * 1024U;
constexpr std::size_t kSignalOverhead = 64;  // of each
// What every client is told of one entity: each status, and each begun 16 KiB of a profile, counts once.
constexpr std::uint32_t kPublishedPerSecond = 200;
constexpr std::size_t kProfileStep = 16 * 1024U;
constexpr std::uint32_t kLinesPerSecond = 20;  // of the log, about one entity

}  // namespace

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
    std::atomic<bool> registered{false};

    Snapshot<std::string> name;    // of its newest registration
    Snapshot<std::string> holder;  // by its newest status

    RateLimit rate, peer_bytes{kPeerBytesPerSecond}, signal_bytes{kSignalBytesPerSecond},
        lines{kLinesPerSecond};
    Liveness liveness;  // hears without a lock; judged under the core's mutex, once registered
    // The drill that is out, 0 = none; when it was sent and how long it took, written without a lock.
    std::atomic<std::uint64_t> drill{0};
    std::atomic<Duration::rep> drill_sent{0};
    std::atomic<Duration::rep> drill_took{0};

    // Guarded by the core's mutex.
    RecordRef record;
    TimePoint next_heartbeat;
    std::uint64_t revision = 0;  // of its entry in the due queue; older entries are void
    std::int64_t heartbeats = 0;
    TimePoint warn_again;
    std::int32_t stop_latency_us = 0;
    std::size_t lines_left_out = 0;
    Pace pace{kPublishedPerSecond};
    bool gone = false;

    EntityOutbox& outbox(Lane lane) const { return lane == Lane::Signal ? *signal : *data; }
    Duration period() const {
        const auto& registration = record->registration;
        return std::chrono::milliseconds{liveness.busy() ? registration.heartbeat_busy_ms
                                                         : registration.heartbeat_idle_ms};
    }
    /// The last time not after `latest` at which heartbeats of this period are sent: 16 in each period, the
    /// same for all sessions with that period, so that the timer wakes for many at once.
    TimePoint beatBy(TimePoint latest) const {
        return latest - latest.time_since_epoch() % (period() / kBeatsApart);
    }
    static constexpr int kBeatsApart = 16;
    /// Within a period from now, each session in its turn of the sixteen, so that many that joined, or began
    /// to move, together are not served all at once for ever.
    TimePoint beatInTurn(TimePoint now) const {
        return beatBy(now + period() * static_cast<int>(number % kBeatsApart + 1) / kBeatsApart);
    }
};

namespace {

Refusal refuse(RefusalCode code, std::string message) {
    return {code, std::move(message), {}};
}

constexpr auto kData = static_cast<std::size_t>(Lane::Data);
constexpr auto kSignal = static_cast<std::size_t>(Lane::Signal);
constexpr const char* kDataLaneOnly =
    "registration and status belong on the data lane; send them on that session";
constexpr int kHeartbeatMinMs = 10;
constexpr int kHeartbeatMaxMs = 60'000;
constexpr std::size_t kNameMax = 256;
constexpr std::size_t kTextMax = 1024;
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

Refusal slowEntity(const Header& head) {
    return queueShareFull("entity " + head.entity.substr(0, 64));
}

Refusal notForPeers(const Header& head) {
    return {RefusalCode::PermissionDenied,
            "an entity sends other entities COLLABORATION and RAW only, found '" +
                head.msg_type.substr(0, 64) + '\'',
            {}};
}

Refusal tooMuchForPeers(bool in_one) {
    return {
        in_one ? RefusalCode::TooLarge : RefusalCode::Overloaded,
        "an entity sends other entities at most " +
            (in_one ? std::to_string(kPeerBytes / 1024) + " KiB in a message"
                    : std::to_string(kPeerBytesPerSecond / 1024) + " KiB of messages of runs in a second"),
        {}};
}

Refusal tooMuchOnSignalLane() {
    return {RefusalCode::Overloaded,
            "the signal lane takes no raw data, messages of at most " + std::to_string(kSignalBytes / 1024) +
                " KiB, and " + std::to_string(kSignalBytesPerSecond / 1024) + " KiB in a second",
            {}};
}

Refusal noSuchPeer(const Header& head) {
    return {RefusalCode::UnknownEntity,
            "no entity " + head.entity.substr(0, 64) + " is connected; 'axon ls' shows those that are there",
            {}};
}

/// Like it, and one that isEntityName().
std::string otherName(std::string name) {
    const auto hash = name.rfind('#');
    if (hash == std::string::npos) return "Robot " + name.substr(0, 8);
    name[hash] = ' ';
    return validUtf8(name);
}

void makeValid(std::string& text) {
    text = cutUtf8(validUtf8(text), kTextMax);
}

Result<void> check(const Registration& registration, std::size_t profile_bytes,
                   std::size_t profile_bytes_max) {
    if (registration.name.empty() || registration.name.size() > kNameMax) {
        return refuse(RefusalCode::BadName,
                      "the entity's name must have 1 to 256 characters; fix <entity_name> in the "
                      "basic profile");
    }
    if (!isEntityName(registration.name)) {
        return refuse(RefusalCode::BadName, "'" + validUtf8(registration.name) +
                                                "' is how people call another entity, by NAME#NUMBER or its "
                                                "UUID: expected a name that is neither; "
                                                "fix: rename it in the basic profile, such as '" +
                                                otherName(registration.name) + "'");
    }
    for (const auto* text : {&registration.name, &registration.category, &registration.type}) {
        if (text->size() > kTextMax || validUtf8(*text) != *text) {
            return refuse(RefusalCode::Malformed,
                          "a text of the registration is no UTF-8 or longer than 1024 bytes; fix the basic "
                          "profile");
        }
    }
    for (const int period : {registration.heartbeat_busy_ms, registration.heartbeat_idle_ms}) {
        if (period < kHeartbeatMinMs || period > kHeartbeatMaxMs) {
            return refuse(RefusalCode::OutOfRange,
                          "a heartbeat period of " + std::to_string(period) +
                              " ms: expected 10 to 60000 ms; fix it in the Entity Manager's "
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

EntityServerCore::EntityServerCore(EntityServerCoreSettings settings, const Clock& clock,
                                   RandomSource& random, FrontEndTopic& topic, Note note,
                                   std::function<void()> wake, std::function<void()> pending)
    : settings_(settings),
      clock_(clock),
      random_(random),
      topic_(topic),
      note_(std::move(note)),
      wake_(std::move(wake)),
      pending_(std::move(pending)),
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
      drill_(settings.drill_period > Duration{} ? "drill-" + Id128::random(random).toString() + "-"
                                                : std::string()),
      slow_lines_(kLinesPerSecond) {}

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
    if (flooded(session)) return refuse(RefusalCode::Overloaded, "it flooded the server");
    registration.entity = id->toString();
    registration.server = settings_.name;
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
                              "entity " + registration.entity + " ('" + *other->second->name.load() +
                                  "') is connected already; if the state folder of an Entity Manager was "
                                  "copied, give the copy an "
                                  "empty one (--state), and it becomes another entity");
            }
            const auto at = elsewhere(registration.entity, Lane::Data);
            if (at && entity_servers_.hears(at->server, kPeerLives, now)) {
                return refuse(
                    RefusalCode::Duplicate,
                    "entity " + registration.entity + " is connected already, to entity server " +
                        at->server +
                        "; if the state folder of an Entity Manager was copied, give the copy an empty "
                        "one (--state), and it becomes another entity");
            }
            if (registered_.size() >= settings_.entities_max) {
                return refuse(RefusalCode::Overloaded, "the server has its " +
                                                           std::to_string(settings_.entities_max) +
                                                           " entities; raise EntityServer.EntitiesMax");
            }
            session->entity = registration.entity;
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
            session->registered = true;
            others_.announceSoon();
            registered_.emplace(session->entity, session);
            table_.put(session->entity, session);
            session->next_heartbeat = session->beatInTurn(now);
        }
        schedule(session, std::min(session->next_heartbeat, now + session->period()));
    }
    wake_();
    leaveToPublisher(session->entity);
    publishPending();
    return {};
}

void EntityServerCore::sendStatus(const SessionRef& session, EntityStatus status) {
    if (!session->registered || flooded(session)) return;
    status.entity = session->entity;
    status.server = settings_.name;
    for (auto* text : {&status.holder.id, &status.holder.name, &status.reason}) makeValid(*text);
    bool became_busy = false;
    bool late = false;  // granted to a client whose server was gone before the grant was known here
    std::int64_t heartbeat = 0;
    std::string line;
    EntityStatus given;
    {
        const std::lock_guard lock(mutex_);
        if (session->gone) return;
        const auto now = clock_.now();
        const bool busy = status.state == EntityState::BUSY;
        const auto& before = session->record->status;
        if (before.holder.id != status.holder.id) {
            const auto name = *session->name.load();
            if (!status.holder.id.empty()) {
                line = name + " is checked out by " + status.holder.name;
            } else if (status.state == EntityState::IDLE && !status.reason.empty()) {
                line = "audit: " + name + " is taken from " + before.holder.name + ": " + status.reason;
            } else {
                line = name + " is free, released by " + before.holder.name;
            }
            if (!session->lines.admit(now)) {
                ++session->lines_left_out;
                line.clear();
            } else if (const auto left_out = std::exchange(session->lines_left_out, 0); left_out > 0) {
                line += " (" + std::to_string(left_out) +
                        " changes of its holder before this one are not in the log)";
            }
        }
        if (before.holder.id != status.holder.id)
            session->holder.store(std::make_shared<const std::string>(status.holder.id));
        late =
            before.holder.id != status.holder.id && !status.orphaned && !front_ends_.serves(status.holder.id);
        if (late) given = status;
        countBusy(before, status, now);
        became_busy = busy && !session->liveness.busy();
        const bool became_idle = !busy && session->liveness.busy();
        session->liveness.setBusy(busy, now);
        status.stop_latency_us = session->stop_latency_us;
        auto record = std::make_shared<Record>(*session->record);
        record->status = std::move(status);
        record->heard = true;
        session->record = std::move(record);
        // The EM's own watchdog is short from now on.
        if (became_busy) heartbeat = ++session->heartbeats;
        if (became_busy || became_idle) {
            session->next_heartbeat = session->beatInTurn(now);
            schedule(session, session->next_heartbeat);
        }
    }
    if (became_busy) {
        session->signal->newHeartbeat(heartbeat);
        wake_();
    }
    if (late) loseClient(*session->signal, given);
    leaveToPublisher(session->entity);
    publishPending();
    if (!line.empty()) note_(line);
}

void EntityServerCore::refuseOnSignalLane(const SessionRef& session, const char* msg_type) {
    Header head;
    if (session->registered) head.entity = session->entity;
    head.msg_type = msg_type;
    session->data->newRefusalMsg(head, refuse(RefusalCode::WrongState, kDataLaneOnly));
}

bool EntityServerCore::flooded(const SessionRef& session) {
    if (session->rate.admit(clock_.now())) return false;
    session->data->disconnect(false, "it flooded the server (more than " +
                                         std::to_string(settings_.messages_per_second) +
                                         " messages in a second)");
    return true;
}

bool EntityServerCore::tooMuchSignal(Session& session, std::string_view message) {
    return message.size() > kSignalBytes ||
           !session.signal_bytes.admit(clock_.now(),
                                       static_cast<std::uint32_t>(message.size() + kSignalOverhead));
}

void EntityServerCore::sendToClient(const SessionRef& session, Lane lane, Header head,
                                    std::string_view message) {
    if (!session->registered || flooded(session)) return;
    if (isDrill(head)) return drillAnswered(session, head);
    head.entity = session->entity;
    if (lane == Lane::Signal && tooMuchSignal(*session, message))
        return session->outbox(lane).newRefusalMsg(head, tooMuchOnSignalLane());
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
    if (!entitiesMaySend(head.msg_type)) return session->outbox(lane).newRefusalMsg(head, notForPeers(head));
    if (lane == Lane::Signal && (head.msg_type == kMsgRaw || tooMuchSignal(*session, message)))
        return session->outbox(lane).newRefusalMsg(head, tooMuchOnSignalLane());
    const bool large = message.size() > kPeerBytes;
    if (large || (lane == Lane::Data && head.msg_type != kMsgRaw &&
                  !session->peer_bytes.admit(clock_.now(), static_cast<std::uint32_t>(message.size()))))
        return session->outbox(lane).newRefusalMsg(head, tooMuchForPeers(large));
    head.sender = {session->entity, *session->name.load(), Role::Operator};
    if (const auto peer = atHome(head.entity, lane)) {
        if (!deliver(peer->outbox(lane), head, message)) {
            session->outbox(lane).newRefusalMsg(head, slowEntity(head));
            noteSlow(head);
        }
        return;
    }
    const auto at = elsewhere(head.entity, lane);
    if (!at) return session->outbox(lane).newRefusalMsg(head, noSuchPeer(head));
    if (const auto sent = topic_.peerMsg(lane, at->server, head, message); !sent.ok())
        session->outbox(lane).newRefusalMsg(head, sent.refusal());
}

void EntityServerCore::peerMsg(Lane lane, const Header& head, std::string_view message) {
    const auto peer = atHome(head.entity, lane);
    if (peer && deliver(peer->outbox(lane), head, message)) return;
    if (peer) noteSlow(head);
    // Or it left before that was known at the sender's server.
    if (const auto from = elsewhere(head.sender.id, lane))
        topic_.peerRefusal(lane, from->server, head, peer ? slowEntity(head) : noSuchPeer(head));
}

void EntityServerCore::clientUnreached(const Header& head, const Refusal& refusal) {
    if (const auto sender = atHome(head.entity, Lane::Data)) sender->data->newRefusalMsg(head, refusal);
}

void EntityServerCore::peerRefusal(Lane lane, const Header& head, const Refusal& refusal) {
    if (const auto sender = atHome(head.sender.id, lane)) sender->outbox(lane).newRefusalMsg(head, refusal);
}

void EntityServerCore::keepAlive(const SessionRef& session) {
    session->liveness.heard(clock_.now());
}

void EntityServerCore::leave(const SessionRef& session, bool orderly, const std::string& why) {
    std::size_t lines_left_out = 0;
    {
        const std::lock_guard lock(mutex_);
        if (session->gone) return;
        session->gone = true;
        lines_left_out = session->lines_left_out;
        tokens_.erase(session->token);
        if (session->registered) {
            countBusy(session->record->status, {}, clock_.now());
            others_.announceSoon();
            registered_.erase(session->entity);
            table_.erase(session->entity);
        }
    }
    session->data->disconnect(orderly, why);
    if (session->signal) session->signal->disconnect(orderly, why);
    if (session->registered) {
        leaveToPublisher(session->entity);
        pending_();
        note_(*session->name.load() + " left: " + why +
              (lines_left_out > 0
                   ? " (" + std::to_string(lines_left_out) + " changes of its holder are not in the log)"
                   : ""));
    }
}

void EntityServerCore::refuseUnknown(Lane lane, const Header& head, Via via) {
    if (!alone() && via == Via::Topic) return;
    topic_.entityRefusal(
        lane, head,
        refuse(RefusalCode::UnknownEntity, "no entity " + head.entity.substr(0, 64) +
                                               " is connected; 'axon ls' shows those that are there"));
}

void EntityServerCore::refuseSlow(Lane lane, const Header& head) {
    topic_.entityRefusal(lane, head, slowEntity(head));
    noteSlow(head);
}

void EntityServerCore::noteSlow(const Header& head) {
    if (slow_lines_.admit(clock_.now()))
        note_("entity " + head.entity.substr(0, 64) + " reads slowly, and " + head.sender.name + " (" +
              head.sender.id + ") sends it more than its share of the queue: refused");
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

void EntityServerCore::clientMsg(const Header& head, std::string_view message, Via via) {
    const auto entity = table_.find(head.entity, kData);
    if (!entity) return refuseUnknown(Lane::Data, head, via);
    // Its holder's orders are never refused for what others send: it has the whole queue.
    const auto share = head.sender.id == *entity->holder.load() ? QueueShare::Whole : QueueShare::OfSender;
    if (!entity->data->newClientMsg(head, message, share)) refuseSlow(Lane::Data, head);
}

void EntityServerCore::clientMsgDataSeq(const Header& head, std::string_view data, Via via) {
    const auto entity = table_.find(head.entity, kData);
    if (!entity) {
        if (!refusedLately(head.sender.id)) refuseUnknown(Lane::Data, head, via);
        return;
    }
    entity->data->newClientMsgDataSeq(head, data);
}

void EntityServerCore::clientRequest(const Header& head) {
    if (head.msg_type != kMsgStatus) return;
    if (head.entity.empty() || head.entity == settings_.name) publishAllAgain();
}

void EntityServerCore::publishAllAgain() {
    {
        const std::lock_guard lock(mutex_);
        for (const auto& [entity, session] : registered_) putInQueue(entity, true);
        list_due_ = !alone();
    }
    publishPending();
}

void EntityServerCore::topicFound() {
    {
        const std::lock_guard lock(mutex_);
        announcement_due_ = true;
    }
    publishAllAgain();
}

// No lock that a message could hold: this is the signal lane, too.
void EntityServerCore::frontEndServerUpdate(Lane lane, const ServerAnnouncement& server) {
    if (!alone() && front_ends_.heard(lane, server, clock_.now())) wake_();
}

void EntityServerCore::entityServerUpdate(Lane lane, const ServerAnnouncement& server,
                                          const std::vector<std::string>& entities) {
    if (alone() || server.name == settings_.name || !isServerName(server.name)) return;
    if (entity_servers_.heard(lane, server, clock_.now())) wake_();
    // What is late of one that is gone is not believed; should it come back, it says so again.
    if (lane == Lane::Data && !entity_servers_.lost(server.name)) learn(server.name, entities);
}

void EntityServerCore::learn(const std::string& server, const std::vector<std::string>& entities) {
    const std::lock_guard lock(mutex_);
    if (entities.size() > settings_.entities_max ||
        (entities_of_.size() >= Neighbours::kMost && !entities_of_.contains(server)))
        return;
    auto& known = entities_of_[server];
    const std::unordered_set<std::string_view> present(entities.begin(), entities.end());
    for (const auto& entity : known) {
        const auto at = elsewhere_.find(entity);
        if (!present.contains(entity) && at && at->server == server) elsewhere_.erase(entity);
    }
    for (const auto& entity : entities) {
        if (const auto at = elsewhere_.find(entity); at && at->server == server) continue;
        auto its = std::make_shared<const Elsewhere>(Elsewhere{entity, server});
        elsewhere_.put(its->entity, its);
    }
    known = entities;
    if (entities.empty()) entities_of_.erase(server);
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

/// What the front-end server would have said, had it lost its client. The clock makes the number new.
void EntityServerCore::loseClient(EntityOutbox& signal, const EntityStatus& status) const {
    Header head;
    head.sender = status.holder;
    head.entity = status.entity;
    head.sent_at_us = toMicroseconds(clock_.now());
    head.sequence = kEntityServerSequences + head.sent_at_us % (kServerSequences / 2);
    signal.stopSignal(head, StopCause::ClientLost);
    signal.newClientUpdate(head, ClientChange::Lost);
}

void EntityServerCore::announce(Lane lane) {
    if (lane == Lane::Signal) {
        topic_.entityServerUpdate(lane, others_.self());
        topic_.peersUpdate(lane, others_.self(), {});
        return;
    }
    {
        const std::lock_guard lock(mutex_);
        announcement_due_ = true;  // says how much has been published, so it comes after that
    }
    pending_();
}

void EntityServerCore::frontEndsLost(const std::vector<std::string>& names) {
    std::vector<std::pair<SessionRef, EntityStatus>> left_behind;
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
    for (const auto& [session, status] : left_behind) loseClient(*session->signal, status);
    for (const auto& name : names) {
        note_("front-end server " + name + " is gone; its clients held " +
              std::to_string(left_behind.size()) + (left_behind.size() == 1 ? " entity" : " entities") +
              " here");
    }
}

void EntityServerCore::entityServersLost(const std::vector<std::string>& names) {
    for (const auto& name : names) {
        learn(name, {});
        note_("entity server " + name + " is gone");
    }
}

/// `send` returns whether the outbox took it. All that take it first: no entity's stop waits for others'
/// refusals.
template <class Send>
void EntityServerCore::toEntities(const Header& head, Send&& send) {
    if (!head.entity.empty()) {
        const auto entity = table_.find(head.entity, kSignal);
        if (!entity) return refuseUnknown(Lane::Signal, head);
        if (!send(*entity->signal)) refuseSlow(Lane::Signal, head);
        return;
    }
    std::vector<std::string> slow;
    table_.each(
        [&](const SessionRef& session) {
            if (!send(*session->signal)) slow.push_back(session->entity);
        },
        kSignal);
    refuseAllSlow(head, slow);
}

void EntityServerCore::refuseAllSlow(const Header& head, const std::vector<std::string>& slow) {
    auto refused = head;
    for (const auto& entity : slow) {
        refused.entity = entity;
        refuseSlow(Lane::Signal, refused);
    }
}

void EntityServerCore::clientUpdate(const Header& head, ClientChange change) {
    if (const auto entity = table_.find(head.entity, kSignal)) entity->signal->newClientUpdate(head, change);
}

void EntityServerCore::stopSignal(const Header& head, StopCause cause) {
    toEntities(head, [&](EntityOutbox& entity) { return entity.stopSignal(head, cause); });
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
    refuseAllSlow(head, slow);
    auto refused = head;
    for (const auto* entity : unknown) {
        refused.entity = entity->substr(0, 64);
        refuseUnknown(Lane::Signal, refused);
    }
}

void EntityServerCore::resetSignal(const Header& head) {
    toEntities(head, [&](EntityOutbox& entity) { return entity.resetSignal(head); });
}

void EntityServerCore::clearSignal(const Header& head) {
    toEntities(head, [&](EntityOutbox& entity) { return entity.clearSignal(head); });
}

void EntityServerCore::schedule(const SessionRef& session, TimePoint at) {
    due_.push({at, ++session->revision, session});
}

TimePoint EntityServerCore::onTimer() {
    std::vector<std::pair<SessionRef, std::int64_t>> heartbeats;
    std::vector<std::pair<SessionRef, Duration>> silent;
    std::vector<std::string> warnings;
    TimePoint next;
    bool paced = false;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        paced = endPauses(now);
        while (!due_.empty() && due_.top().at <= now) {
            const auto due = due_.top();
            due_.pop();
            const auto session = due.session.lock();
            if (!session || session->gone || session->revision != due.revision) continue;
            if (session->liveness.expired(now)) {
                silent.emplace_back(session, session->liveness.timeout());
                continue;
            }
            if (now >= session->warn_again) {
                if (const auto gap = session->liveness.longest(now); gap.part() >= Liveness::kWarnFrom) {
                    session->warn_again = now + Liveness::kWarnAgain;
                    warnings.push_back(*session->name.load() + " is late: " + describe(gap));
                }
            }
            if (session->next_heartbeat <= now) {
                heartbeats.emplace_back(session, ++session->heartbeats);
                // From when it was due, so that late ones keep apart. Catching up after a pause would only
                // send a burst.
                const auto beat = session->beatBy(session->next_heartbeat + session->period());
                session->next_heartbeat = beat > now ? beat : session->beatInTurn(now);
            }
            schedule(session, std::min(std::max(session->next_heartbeat, now + std::chrono::milliseconds{1}),
                                       session->liveness.deadline()));
        }
        next = std::min(next_paced_, due_.empty() ? now + std::chrono::seconds{1} : due_.top().at);
    }
    if (paced) pending_();
    for (const auto& [session, sequence] : heartbeats) session->signal->newHeartbeat(sequence);
    for (const auto& [session, timeout] : silent) {
        leave(session, false,
              "nothing was heard of it for " +
                  std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(timeout).count()) +
                  " ms");
    }
    next = std::min(next, others_.onTimer(clock_.now()));
    for (const auto& warning : warnings) note_(warning);
    return drill_.empty() ? next : std::min(next, onDrillTimer());
}

bool EntityServerCore::isDrill(const Header& head) const {
    return !drill_.empty() && head.sender.id.starts_with(drill_);
}

// Of its receipts only the last has a routing key of its own: the Entity Interfacer has acknowledged. Without
// the registry's lock, as this is the way of every stop's receipt.
void EntityServerCore::drillAnswered(const SessionRef& session, const Header& head) {
    if (head.msg_type != kMsgDrill) return;
    std::uint64_t number = 0;
    std::from_chars(head.sender.id.data() + drill_.size(), head.sender.id.data() + head.sender.id.size(),
                    number);
    if (number == 0 || number != session->drill || session->drill_took != 0) return;  // too late, or twice
    const auto took = clock_.now().time_since_epoch().count() - session->drill_sent;
    session->drill_took = std::max<Duration::rep>(took, 1);
    wake_();
}

/// Under the registry's mutex: takes what was answered, and gives up what is late.
void EntityServerCore::settleDrills(TimePoint now, std::vector<std::string>& changed,
                                    std::vector<std::string>& lines) {
    std::erase_if(drills_, [&](const Drill& drill) {
        const auto session = drill.session.lock();
        if (!session || session->gone) return true;
        const Duration took{session->drill_took.load()};
        if (took == Duration{} && now < drill.answer_by) return false;
        session->drill = 0;
        if (took == Duration{}) {
            lines.push_back(
                *session->name.load() + " has not answered a drill within " +
                std::to_string(
                    std::chrono::duration_cast<std::chrono::milliseconds>(settings_.drill_answer).count()) +
                " ms: how long a stop takes there is unknown");
        }
        // 0 says unknown, so what took less than a microsecond took one.
        const auto us = took == Duration{}
                            ? 0
                            : std::max<std::int64_t>(
                                  std::chrono::duration_cast<std::chrono::microseconds>(took).count(), 1);
        if (std::exchange(session->stop_latency_us, static_cast<std::int32_t>(us)) == us) return true;
        auto record = std::make_shared<Record>(*session->record);
        record->status.stop_latency_us = session->stop_latency_us;
        session->record = std::move(record);
        changed.push_back(session->entity);
        return true;
    });
}

/// Under the registry's mutex: whose turn it is, null where a drill would tell nothing or disturb.
EntityServerCore::SessionRef EntityServerCore::nextDrill(TimePoint now) {
    if (drill_round_.empty()) {
        for (const auto& [entity, session] : registered_) drill_round_.push_back(session);
        if (drill_round_.empty()) return nullptr;
    }
    auto session = drill_round_.front().lock();
    drill_round_.pop_front();
    if (!session || session->gone || session->drill != 0) return nullptr;
    const auto& status = session->record->status;
    if (status.latched || status.state == EntityState::UNAV || status.state == EntityState::INIT)
        return nullptr;
    session->drill_took = 0;
    session->drill = ++drills_given_;
    drills_.push_back({now + settings_.drill_answer, session});
    return session;
}

TimePoint EntityServerCore::onDrillTimer() {
    std::vector<std::string> changed;
    std::vector<std::string> lines;
    std::vector<SessionRef> orders;
    TimePoint next;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        settleDrills(now, changed, lines);
        const auto step =
            settings_.drill_period / static_cast<int>(std::max<std::size_t>(registered_.size(), 1));
        // After a pause one turn is enough; a burst would measure itself.
        if (next_drill_ + settings_.drill_period <= now) next_drill_ = now + step;
        for (; next_drill_ <= now; next_drill_ += std::max(step, Duration{1})) {
            if (auto session = nextDrill(now)) orders.push_back(std::move(session));
        }
        next = next_drill_;
        for (const auto& drill : drills_) next = std::min(next, drill.answer_by);
    }
    for (const auto& session : orders) {
        Header head;
        const auto number = session->drill.load();
        head.sender = {drill_ + std::to_string(number), "the entity server", Role::Operator};
        head.entity = session->entity;
        head.msg_type = kMsgDrill;
        head.sequence = static_cast<std::int64_t>(number);
        const auto now = clock_.now();
        head.sent_at_us = toMicroseconds(now);
        session->drill_sent = now.time_since_epoch().count();
        session->signal->stopSignal(head, StopCause::Drill);
    }
    for (const auto& line : lines) note_(line);
    for (const auto& entity : changed) leaveToPublisher(entity);
    if (!changed.empty()) pending_();
    return next;
}

std::vector<std::string> EntityServerCore::margins() const {
    std::vector<std::string> lines;
    const std::lock_guard lock(mutex_);
    const auto now = clock_.now();
    for (const auto& [entity, session] : registered_) {
        lines.push_back(*session->name.load() + ": " + describe(session->liveness.longest(now)) +
                        (session->stop_latency_us > 0
                             ? "; a stop takes " + std::to_string(session->stop_latency_us) + " us"
                             : ""));
    }
    return lines;
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
    putInQueue(entity, false);
}

/// Under the registry's mutex.
void EntityServerCore::putInQueue(const std::string& entity, bool again) {
    const auto [waiting, is_new] = waiting_to_publish_.try_emplace(entity, again);
    if (is_new) {
        to_publish_.push_back(entity);
    } else if (again) {
        waiting->second = true;
    }
}

/// Whether front-end servers are told the profile, and not its status alone.
bool EntityServerCore::tellsProfile(const RecordRef& before, const RecordRef& now, bool again) {
    return again || !before || before->session != now->session || now->registration != before->registration ||
           (now->profile != before->profile && *now->profile != *before->profile);
}

/// Under the registry's mutex: whether this entity changes faster than all clients are told. It comes again
/// then, and what is told is what holds by then.
bool EntityServerCore::isPaced(Session& session, bool again) {
    const auto now = clock_.now();
    const auto at = session.pace.next(now);
    if (at > now) {
        auto& its = paced_[session.entity];
        its.again = its.again || again;
        its.at = at;
        next_paced_ = std::min(next_paced_, at);
        return true;
    }
    const auto published = published_.find(session.entity);
    const auto before = published != published_.end() ? published->second : nullptr;
    const auto profile =
        tellsProfile(before, session.record, again) ? session.record->profile->size() / kProfileStep : 0;
    session.pace.take(now, 1 + static_cast<std::uint32_t>(profile));
    return false;
}

/// Under the registry's mutex: queues those whose time has come.
bool EntityServerCore::endPauses(TimePoint now) {
    if (next_paced_ > now) return false;
    next_paced_ = TimePoint::max();
    for (auto its = paced_.begin(); its != paced_.end();) {
        if (its->second.at > now) {
            next_paced_ = std::min(next_paced_, its->second.at);
            ++its;
            continue;
        }
        putInQueue(its->first, its->second.again);
        its = paced_.erase(its);
    }
    return true;
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
        bool again = false;
        if (publishSummary()) continue;
        {
            std::unique_lock lock(mutex_);
            if (to_publish_.empty()) {
                if (list_due_ || announcement_due_) continue;
                publishing_ = false;
                return;
            }
            one = std::move(to_publish_.front());
            to_publish_.pop_front();
            const auto waiting = waiting_to_publish_.find(one);
            again = waiting->second;
            waiting_to_publish_.erase(waiting);
            const auto session = registered_.find(one);
            const auto timer = next_paced_;
            if (session != registered_.end() && isPaced(*session->second, again)) {
                const bool earlier = next_paced_ < timer;
                lock.unlock();
                if (earlier) wake_();
                continue;
            }
            if (const auto found = published_.find(one); found != published_.end()) before = found->second;
            if (session != registered_.end()) {
                now = session->second->record;
                published_[one] = now;
            } else {
                published_.erase(one);
            }
        }
        publishOne(one, before, now, again);
    }
}

/// When everything about entities has been said: the list of them, and this server's word of itself, whose
/// count tells a front-end server whether it has heard everything before it. Returns whether it said one of
/// them.
bool EntityServerCore::publishSummary() {
    std::optional<std::vector<std::string>> entities;
    std::vector<std::string> here;
    {
        const std::lock_guard lock(mutex_);
        if (!to_publish_.empty() || !(list_due_ || announcement_due_)) return false;
        if (std::exchange(list_due_, false)) {
            entities.emplace();
            for (const auto& [entity, record] : published_) entities->push_back(entity);
        } else {
            announcement_due_ = false;
            for (const auto& [entity, session] : registered_) here.push_back(entity);
        }
    }
    if (entities) {
        topic_.entityServerEntities(settings_.name, *entities);
    } else {
        auto self = others_.self();
        self.published = publications_;
        topic_.entityServerUpdate(Lane::Data, self);
        topic_.peersUpdate(Lane::Data, self, here);
    }
    return true;
}

void EntityServerCore::publishOne(const std::string& entity, const RecordRef& before, const RecordRef& now,
                                  bool again) {
    const bool same_session = before && now && before->session == now->session;
    const auto presence = [&](Presence what, const Registration& registration, std::string_view profile) {
        ++publications_;
        topic_.entityBasicPrflUpdate(what, registration, profile);
    };
    if (before && !same_session) presence(Presence::Left, before->registration, {});
    if (!now) return;
    if (!same_session) {
        presence(Presence::Joined, now->registration, *now->profile);
    } else if (tellsProfile(before, now, again)) {
        presence(Presence::Changed, now->registration, *now->profile);
    }
    const bool was_ready = same_session && !before->profile->empty();
    if (!now->profile->empty() && !was_ready)
        note_(now->registration.name + " joined (" + entity + ")");
    else if (!same_session)
        note_(now->registration.name + " is connected and not ready (" + entity +
              "); axon ls --all shows why");
    if (now->heard && (again || !same_session || !before->heard || now->status != before->status)) {
        topic_.entityUpdate(now->status, ++publications_);
    }
}

}  // namespace axon::entity_server
