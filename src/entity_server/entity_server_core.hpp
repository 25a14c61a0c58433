// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/other_servers.hpp"
#include "common/rate_limit.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "common/snapshot_table.hpp"
#include "entity_server/drills/drills.hpp"
#include "entity_server/ports/ports.hpp"
#include "entity_server/publishing/publisher.hpp"
#include "entity_server/routing/entities_elsewhere.hpp"
#include "entity_server/routing/undelivered.hpp"
#include "entity_server/sessions/due_sessions.hpp"
#include "entity_server/sessions/entity_audit.hpp"
#include "entity_server/sessions/session.hpp"
#include "users/present_users.hpp"
#include "users/users_agreement.hpp"

namespace axon::entity_server {

struct EntityServerCoreSettings {
    /// Of one of several entity servers in processes of their own (isServerName); empty: it is the only one,
    /// with the only front-end server beside it.
    std::string name;
    Neighbours::Timeouts front_ends;
    Neighbours::Timeouts entity_servers;
    int heartbeats_missed = 5;  ///< periods of its registration until an EM is given up
    std::size_t entities_max = 65536;
    std::size_t profile_bytes_max = 1024 * 1024;
    std::uint32_t messages_per_second = 100'000;  ///< control messages of one EM; above is a flood
    Duration drill_period{};  ///< each entity is drilled once in this time; zero = no drills
    Duration drill_answer = std::chrono::seconds{1};  ///< later is no answer
};

/// The registry and router of all connected entities (thesis: EntityMonitor), without its sockets.
///
/// Where in the flow: between the Entity Managers (EntityOutbox, EntitySessionServant) and the front-end
/// servers (FrontEndTopic, FrontEndToEntityServant). An event goes in as one call; effects leave through the
/// ports before it returns, except that publications about one entity may be made by another thread that is
/// publishing already (Publisher), and those of an entity that leaves are made by publishPending(): it may
/// leave on a thread of the signal lane or the heartbeats' timer, neither of which may be delayed.
///
/// Drills: the core measures by itself how long a stop takes. In each `drill_period` every entity gets one
/// stop of cause Drill on its signal lane, spread over the period, but for those that are latched or have no
/// robot application. The Entity Interfacer acknowledges it without calling the application, and the time
/// from the sending to that answer becomes the status' stop_latency_us; 0 where none came within
/// `drill_answer`.
///
/// States of a session: opened ─ attach() ► two lanes ─ sendBasicPrfl() ► registered ─ leave() ► gone.
///
/// One of several: it announces itself to the front-end servers and watches them. A front-end server that
/// falls silent, refuses connections or was restarted leaves clients behind that nobody watches: every entity
/// that one of them holds is stopped and told that it lost its client, even if the grant becomes known later.
/// What comes by the topic for an entity that is not here may be another's, and is not refused; what comes
/// straight is. Entity servers tell each other which entities they have, every second and when that changes:
/// what one entity sends another finds its way by that, or is refused, and an entity that another living
/// server has is refused as a duplicate (unless both join within the 50 ms until that is told).
///
/// Parts: the registry of sessions is here; what others are told (Publisher), Drills, EntitiesElsewhere and
/// the answers for what is Undelivered have their own state. Payloads are opaque.
///
/// Threads: any, concurrently; calls for one lane of one session come one after the other. Routing reads
/// immutable tables, of which each lane has its own reference; the registry's mutex is taken when entities
/// join, change and leave and by the timer, never by a message, a signal or a sign of life. The mutexes of
/// Publisher and Neighbours may be taken while it is held, and no other. Failure: refusals are returned or
/// sent back; nothing throws.
class EntityServerCore {
  public:
    using SessionRef = entity_server::SessionRef;
    using Note = std::function<void(const std::string& line)>;

    /// `note` gets a line for people; `wake` is called when onTimer() is due earlier than it said, `pending`
    /// when publishPending() is to be called, by a thread that is not the signal lane's. `trail`,
    /// `users`: null where there are none.
    EntityServerCore(EntityServerCoreSettings settings, const Clock& clock, RandomSource& random,
                     FrontEndTopic& topic, Note note, std::function<void()> wake,
                     std::function<void()> pending, audit::AuditTrail* trail = nullptr,
                     const users::PresentUsers* users = nullptr);
    ~EntityServerCore();

    // From an Entity Manager. `session` is never null.
    /// `user`: who has logged in, empty where nobody has a name.
    SessionRef open(std::shared_ptr<EntityOutbox> data, const std::string& user = {});
    static const std::string& token(const Session& session);
    Result<SessionRef> attach(const std::string& token, std::shared_ptr<EntityOutbox> signal);
    Result<void> sendBasicPrfl(const SessionRef& session, Registration registration,
                               std::string_view profile);
    /// Its texts are corrected: cut to 1024 bytes, and made valid UTF-8.
    void sendStatus(const SessionRef& session, EntityStatus status);
    /// A message of an entity here, `head.entity`, did not reach the client's front-end server.
    void clientUnreached(const Header& head, const Refusal& refusal);
    /// An operation that came on the signal lane and belongs on the other: two lanes would overtake each
    /// other.
    void refuseOnSignalLane(const SessionRef& session, const char* msg_type);
    void sendToClient(const SessionRef& session, Lane lane, Header head, std::string_view message);
    void sendToClientDataSeq(const SessionRef& session, Header head, std::string_view data);
    /// Reaches the peer on the lane it came by; refused to the sender, on that lane, where it does not.
    void sendToPeer(const SessionRef& session, Lane lane, Header head, std::string_view message);
    void keepAlive(const SessionRef& session);
    /// The session is over: destroyed (orderly), its connection closed, silent or dropped. Idempotent.
    void leave(const SessionRef& session, bool orderly, const std::string& why);

    // From the front-end servers. `head.sender` has been vouched for.
    /// A message that came straight is for an entity of this server. It is refused if that entity is not
    /// here.
    void clientMsg(const Header& head, std::string_view message, Via via = Via::Topic);
    void clientMsgDataSeq(const Header& head, std::string_view data, Via via = Via::Topic);
    /// STATUS: everything that is known is published again, and a list of it all at the end; for a front-end
    /// server in a process of its own that comes later than the entities. The embedded one has heard of them
    /// all and does not ask. `head.entity` names the entity server, empty = all.
    void clientRequest(const Header& head);
    void clientUpdate(const Header& head, ClientChange change);
    void stopSignal(const Header& head, StopCause cause);
    void stopSignals(const Header& head, const std::vector<std::string>& entities, StopCause cause);
    void resetSignal(const Header& head);
    void clearSignal(const Header& head);
    /// `lane`: Signal = directly, Data = by the topic. `users`: the fingerprint of its users; empty: not
    /// told.
    void frontEndServerUpdate(Lane lane, const ServerAnnouncement& server, const std::string& users = {});
    /// A connection to `signals`, where this front-end or entity server takes signals, was refused.
    void serverRefused(const std::string& server, const std::string& signals);
    /// The topic has been found, or found again. Nobody has received messages published in between.
    void topicFound();

    // From the other entity servers. `head.sender` is an entity, and has been vouched for.
    /// `lane`: Signal = directly, Data = by the topic, with all its entities.
    void entityServerUpdate(Lane lane, const ServerAnnouncement& server,
                            const std::vector<std::string>& entities);
    void peerMsg(Lane lane, const Header& head, std::string_view message);
    void peerRefusal(Lane lane, const Header& head, const Refusal& refusal);

    /// The users are others now. The session of an Entity Manager that is none of them ends, and its robot is
    /// stopped as for any server that is lost.
    void usersChanged();

    /// Sends the heartbeats that are due and gives up silent EMs; returns when it wants to be called again.
    TimePoint onTimer();
    /// Publishes what others have left behind.
    void publishPending();

    /// Which entity server has it, this one included, as far as is known here; null: none. Without a lock.
    std::shared_ptr<const std::string> serverOf(const std::string& entity, Lane lane) const;
    std::size_t entities() const;
    /// For people, a line for each entity: how near its watchdog came to its end, and its stop latency.
    std::vector<std::string> margins() const;

  private:
    /// False where `head` names an entity that is not here.
    template <class Send>
    bool toEntities(const Header& head, Send&& send);
    bool flooded(const SessionRef& session);
    TimePoint onDrillTimer();
    bool isUser(const Session& session) const;
    bool alone() const { return settings_.name.empty(); }
    void announce(Lane lane);
    void frontEndsLost(const std::vector<std::string>& names);
    void entityServersLost(const std::vector<std::string>& names);
    void countBusy(const EntityStatus& before, const EntityStatus& now, TimePoint at);

    const EntityServerCoreSettings settings_;
    const Clock& clock_;
    RandomSource& random_;
    FrontEndTopic& topic_;
    const Note note_;
    const std::function<void()> wake_;
    const std::function<void()> pending_;
    const EntityAudit audit_;
    const users::PresentUsers* const users_;
    users::UsersAgreement agreement_;  // of the front-end servers and this one

    OtherServers others_;
    OtherServers::Group& front_ends_;
    OtherServers::Group& entity_servers_;

    SnapshotTable<SessionRef, 2> table_;  // by entity, for each lane
    EntitiesElsewhere elsewhere_;
    Undelivered undelivered_;

    Publisher publisher_;
    Drills drills_;  // guarded by mutex_, but for what an answer needs

    mutable std::mutex mutex_;
    // Guarded by mutex_:
    std::uint64_t sessions_opened_ = 0;
    std::unordered_map<std::string, std::weak_ptr<Session>> tokens_;
    std::unordered_map<std::string, SessionRef> registered_;
    DueSessions due_;
};

}  // namespace axon::entity_server
