// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <queue>
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
#include "entity_server/ports.hpp"

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
/// publishing already, and those of an entity that leaves are made by publishPending(): it may leave on a
/// thread of the signal lane or the heartbeats' timer, neither of which may be delayed.
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
/// falls silent or was restarted leaves clients behind that nobody watches: every entity that one of them
/// holds is stopped and told that it lost its client, even if the grant becomes known later. What comes by
/// the topic for an entity that is not here may be another's, and is not refused; what comes straight is.
/// Entity servers tell each other which entities they have, every second and when that changes: what one
/// entity sends another finds its way by that, or is refused, and an entity that another living server has is
/// refused as a duplicate (unless both join within the 50 ms until that is told).
///
/// It holds of each entity: UUID → outboxes, UUID → registration, basic profile bytes and last status; of
/// each that is elsewhere: UUID → entity server. Payloads are opaque. Threads: any, concurrently; calls for
/// one lane of one session come one after the other. Routing reads immutable tables, of which each lane has
/// its own reference; the registry's mutex is taken when entities join, change and leave and by the timer,
/// never by a message, a signal or a sign of life. Failure: refusals are returned or sent back; nothing
/// throws.
class EntityServerCore {
  public:
    class Session;
    using SessionRef = std::shared_ptr<Session>;
    using Note = std::function<void(const std::string& line)>;

    /// `note` gets a line for people; `wake` is called when onTimer() is due earlier than it said, `pending`
    /// when publishPending() is to be called, by a thread that is not the signal lane's.
    EntityServerCore(EntityServerCoreSettings settings, const Clock& clock, RandomSource& random,
                     FrontEndTopic& topic, Note note, std::function<void()> wake,
                     std::function<void()> pending);
    ~EntityServerCore();

    // From an Entity Manager. `session` is never null.
    SessionRef open(std::shared_ptr<EntityOutbox> data);
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
    /// `lane`: Signal = directly, Data = by the topic.
    void frontEndServerUpdate(Lane lane, const ServerAnnouncement& server);
    /// The topic has been found, or found again. Nobody has received messages published in between.
    void topicFound();

    // From the other entity servers. `head.sender` is an entity, and has been vouched for.
    /// `lane`: Signal = directly, Data = by the topic, with all its entities.
    void entityServerUpdate(Lane lane, const ServerAnnouncement& server,
                            const std::vector<std::string>& entities);
    void peerMsg(Lane lane, const Header& head, std::string_view message);
    void peerRefusal(Lane lane, const Header& head, const Refusal& refusal);

    /// Sends the heartbeats that are due and gives up silent EMs; returns when it wants to be called again.
    TimePoint onTimer();
    /// Publishes what others have left behind.
    void publishPending();

    std::size_t entities() const;
    /// For people, a line for each entity: how near its watchdog came to its end, and its stop latency.
    std::vector<std::string> margins() const;

  private:
    /// What the front-end servers know of an entity, replaced whole.
    struct Record {
        Registration registration;
        std::shared_ptr<const std::string> profile;
        EntityStatus status;
        bool heard = false;  ///< the status is one that it has sent
        std::uint64_t session = 0;
    };
    using RecordRef = std::shared_ptr<const Record>;
    struct Elsewhere {
        std::string entity;
        std::string server;
    };
    using ElsewhereRef = std::shared_ptr<const Elsewhere>;
    struct Drill {
        TimePoint answer_by;
        std::weak_ptr<Session> session;
    };
    struct Due {
        TimePoint at;
        std::uint64_t revision;
        std::weak_ptr<Session> session;
        bool operator<(const Due& other) const { return at > other.at; }  // earliest on top
    };

    template <class Send>
    void toEntities(const Header& head, Send&& send);
    void refuseUnknown(Lane lane, const Header& head, Via via = Via::Topic);
    SessionRef atHome(const std::string& entity, Lane lane) const {
        return table_.find(entity, static_cast<std::size_t>(lane));
    }
    ElsewhereRef elsewhere(const std::string& entity, Lane lane) const {
        return elsewhere_.find(entity, static_cast<std::size_t>(lane));
    }
    void learn(const std::string& server, const std::vector<std::string>& entities);
    bool refusedLately(const std::string& sender);
    void refuseSlow(Lane lane, const Header& head);
    void refuseAllSlow(const Header& head, const std::vector<std::string>& slow);
    void noteSlow(const Header& head);
    bool flooded(const SessionRef& session);
    bool tooMuchSignal(Session& session, std::string_view message);
    void schedule(const SessionRef& session, TimePoint at);
    void leaveToPublisher(const std::string& entity);
    void putInQueue(const std::string& entity, bool again);
    static bool tellsProfile(const RecordRef& before, const RecordRef& now, bool again);
    bool isPaced(Session& session, bool again);
    bool endPauses(TimePoint now);
    bool isDrill(const Header& head) const;
    void drillAnswered(const SessionRef& session, const Header& head);
    void settleDrills(TimePoint now, std::vector<std::string>& changed, std::vector<std::string>& lines);
    SessionRef nextDrill(TimePoint now);
    TimePoint onDrillTimer();
    void publishOne(const std::string& entity, const RecordRef& before, const RecordRef& now, bool again);
    bool alone() const { return settings_.name.empty(); }
    void publishAllAgain();
    bool publishSummary();
    void announce(Lane lane);
    void frontEndsLost(const std::vector<std::string>& names);
    void entityServersLost(const std::vector<std::string>& names);
    void countBusy(const EntityStatus& before, const EntityStatus& now, TimePoint at);
    void loseClient(EntityOutbox& signal, const EntityStatus& status) const;

    const EntityServerCoreSettings settings_;
    const Clock& clock_;
    RandomSource& random_;
    FrontEndTopic& topic_;
    const Note note_;
    const std::function<void()> wake_;
    const std::function<void()> pending_;

    OtherServers others_;
    OtherServers::Group& front_ends_;
    OtherServers::Group& entity_servers_;
    const std::string drill_;  // what the sender ids of drills begin with; nobody else's do

    SnapshotTable<SessionRef, 2> table_;        // by entity, for each lane
    SnapshotTable<ElsewhereRef, 2> elsewhere_;  // by entity, for each lane

    RateLimit slow_lines_;  // of the log, about who reads slowly
    // Confined to whoever publishes:
    std::int64_t publications_ = 0;

    std::mutex refused_mutex_;
    std::unordered_map<std::string, TimePoint> refused_;  // guarded by refused_mutex_: whose data, and when

    mutable std::mutex mutex_;
    // Guarded by mutex_:
    std::uint64_t sessions_opened_ = 0;
    std::unordered_map<std::string, std::weak_ptr<Session>> tokens_;
    std::unordered_map<std::string, SessionRef> registered_;
    std::priority_queue<Due> due_;
    std::unordered_map<std::string, RecordRef> published_;
    std::deque<std::string> to_publish_;  // each UUID at most once, so bounded by the number of entities
    std::unordered_map<std::string, bool> waiting_to_publish_;  // true: also where nothing has changed
    struct Paced {
        bool again = false;  // as in waiting_to_publish_
        TimePoint at;
    };
    std::unordered_map<std::string, Paced> paced_;  // to be published later
    TimePoint next_paced_ = TimePoint::max();
    bool list_due_ = false;
    bool announcement_due_ = false;
    // entity server → those of elsewhere_ that it has, or had before another one said that it has them
    std::unordered_map<std::string, std::vector<std::string>> entities_of_;
    bool publishing_ = false;
    TimePoint next_drill_;
    std::deque<std::weak_ptr<Session>> drill_round_;  // those whose turn is still to come
    std::vector<Drill> drills_;                       // unanswered; at most one for each entity
    std::uint64_t drills_given_ = 0;
};

}  // namespace axon::entity_server
