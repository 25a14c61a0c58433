// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/other_servers.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "common/snapshot.hpp"
#include "front_end_server/clients/clients.hpp"
#include "front_end_server/clients/holdings.hpp"
#include "front_end_server/endings/gone_clients.hpp"
#include "front_end_server/endings/settlement.hpp"
#include "front_end_server/entities/entities.hpp"
#include "front_end_server/log/client_log.hpp"
#include "front_end_server/ports/core_settings.hpp"
#include "front_end_server/ports/ports.hpp"
#include "users/present_users.hpp"

namespace axon::front_end_server {

/// The most entities that one list of stops may name. A stop goes to the first of a longer one, and its
/// sender's session ends.
inline constexpr std::size_t kStopsAtOnce = 8192;

/// The clients and their check-outs, and the front-end's copy of what entities there are (thesis:
/// ClientMonitor), without its sockets.
///
/// Where in the flow: between the clients (ClientOutbox, ClientSessionServant) and the entity servers
/// (EntityTopic, EntityToFrontEndServant). An event goes in as one call, effects leave through the ports
/// before it returns, but for statuses that are held (tellHeld()).
///
/// States of a client: setCallback() ► here ─ attach() ► with two lanes ─ leave() ► gone. Its check-outs are
/// what entities' statuses say of their holders; a client that goes is stopped for on each of them, even
/// where the status that names it comes late.
///
/// One of several: it announces itself to the entity servers and watches them. When an entity server falls
/// silent, refuses connections or was restarted, its entities have left; so have those that are missing in
/// the list at the end of a STATUS. It asks for STATUS when it finds a server or the topic, and when it has
/// heard fewer registrations and statuses of a server than that one has published; again, until the answer
/// has come whole. An entity belongs to the server that announced its joining last. As it knows all entities
/// it refuses what is for none; a stop is passed on all the same.
///
/// Who may see, check out, take over and rearm an entity, the lists of users.cfg say (users::Access); they
/// are asked here, before anything is routed, and for what comes back on the data lane. No stop is ever kept
/// back by a list, and no receipt.
///
/// Parts: Clients, Entities, Holdings and GoneClients have its state; Settlement tells entities that a client
/// is gone, and ClientLog people what clients do.
///
/// Threads: any, concurrently; calls for one lane of one client, and those from one entity server about
/// entities, come one after the other. Routing reads immutable tables, of which each lane has its own
/// reference; the mutex is taken for joins, statuses, leaves, a client's first check-out of an entity and by
/// the two timers, never by another message, a sign of life or a client's signal. Failure: refusals are sent
/// back; nothing throws.
class FrontEndCore {
  public:
    using ClientRef = front_end_server::ClientRef;
    using Note = std::function<void(const std::string& line)>;
    /// Which of its two functions of time wants to be called earlier than it said. They are for two threads:
    /// what clients are told of many entities must not make heartbeats late.
    enum class Due : std::uint8_t { OnTimer, TellHeld };
    using Wake = std::function<void(Due)>;

    /// `global_services`, `trail`, `users`: null where there are none. `machine_time`: of the pace of
    /// statuses, which goes on where the laboratory's time stands; null: the same clock. All outlive it.
    FrontEndCore(FrontEndCoreSettings settings, const Clock& clock, RandomSource& random, EntityTopic& topic,
                 Note note, Wake wake, GlobalServicesPort* global_services = nullptr,
                 audit::AuditTrail* trail = nullptr, const users::PresentUsers* users = nullptr,
                 const Clock* machine_time = nullptr);
    ~FrontEndCore();

    // From a client.
    /// A client is here: it is told of every entity, now and from now on. `user` and `role` come from the
    /// login; `user` is empty where the login names none, and each session then counts for itself. Refused
    /// where the users have changed since, and the user has no longer this role. Beyond the sessions that a
    /// user may have it is an observer's: it can still stop.
    Result<ClientRef> setCallback(const std::string& display_name, Role role,
                                  std::shared_ptr<ClientOutbox> data, const std::string& user = {});
    Result<ClientRef> attach(const std::string& token, std::shared_ptr<ClientOutbox> signal);
    static const Sender& me(const Client& client);
    static const std::string& token(const Client& client);
    /// The number of entities whose profile and status it was told when it joined, without those that left
    /// in that time.
    static std::size_t told(const Client& client);
    /// STATUS: everything that is known is sent again. GLOBAL_SERVICES: answered with that msg_type, of no
    /// entity.
    void sendRequest(const ClientRef& client, Header head, std::string_view message);
    void sendToEntity(const ClientRef& client, Header head, std::string_view message);
    void sendToEntityDataSeq(const ClientRef& client, Header head, std::string_view data);
    void sendStopSignal(const ClientRef& client, Header head, StopCause cause);
    void sendStopSignals(const ClientRef& client, Header head, const std::vector<std::string>& entities,
                         StopCause cause);
    void sendResetSignal(const ClientRef& client, Header head);
    void sendClearSignal(const ClientRef& client, Header head);
    void keepAlive(const ClientRef& client);
    /// Idempotent; the first ending counts.
    void leave(const ClientRef& client, Ending ending, const std::string& why);

    // From the entity servers. `head.sender` is the recipient, its id empty for all.
    void entityBasicPrflUpdate(Presence presence, Registration registration, std::string_view profile);
    /// `number`: grows with each of its server, and the first copy counts; 0 = there is one copy.
    void entityUpdate(EntityStatus status, std::int64_t number = 0, Via via = Via::Topic);
    void entityMsg(Lane lane, const Header& head, std::string_view message);
    void entityMsgDataSeq(const Header& head, std::string_view data);
    void entityRefusal(Lane lane, const Header& head, const Refusal& refusal);
    void entityServerEntities(const std::string& server, const std::vector<std::string>& entities);
    /// `lane`: Signal = directly, Data = by the topic.
    void entityServerUpdate(Lane lane, const ServerAnnouncement& server);
    /// A connection to `signals`, where this entity server takes signals, was refused.
    void entityServerRefused(const std::string& server, const std::string& signals);
    /// The topic has been found, or found again. Messages published in between were not received here.
    void topicFound();

    /// The users, or the lists of entities, are others now. Whoever is none of them, has a lower role than in
    /// its session, or holds an entity that it may no longer check out, is lost: its robots stop as for any
    /// client that is lost. Who has a higher role gets it with the next session. Clients are told of the
    /// entities that they see now, and that those have left which they see no more.
    void usersChanged();

    /// Gives up silent clients and sends heartbeats; returns when it wants to be called again.
    TimePoint onTimer();
    /// Tells clients the statuses that were held back because many changed; returns when it wants to be
    /// called again.
    TimePoint tellHeld();
    /// Tells every client that the server is shutting down.
    void shutDown();

    /// For people, a line for each client: how close its watchdog came to tripping in the last minute.
    std::vector<std::string> margins() const;

    /// Which entity server has it, as far as is known here; null: none. Without a lock.
    std::shared_ptr<const std::string> serverOf(const std::string& entity, Lane lane) const {
        return entities_.serverOf(entity, lane);
    }
    std::size_t clients() const;
    std::size_t entities() const;
    const FrontEndCoreSettings& settings() const { return settings_; }

  private:
    /// What was known of an entity before its status changed.
    struct Before {
        std::string holder;
        bool busy = false;
        bool heard = false;  ///< there was a status
    };
    /// A holder that has not the right, and has to go.
    struct Barred {
        ClientRef client;
        std::string why;
    };
    /// What a client asked of an entity, and has no longer the right to.
    struct GivenUp {
        ClientRef client;
        std::string entity, name;
    };

    /// A client whose session is over, and what it held.
    struct Leaving {
        ClientRef client;
        Ending ending;
        std::string why;
        Holdings::Held held;
    };

    /// All at once; one that has left already is left out.
    void leave(std::vector<Leaving> leaving);
    template <class Send>
    void toClients(Lane lane, const std::string& recipient, Send&& send);
    bool flooded(const ClientRef& client, std::size_t messages = 1);
    bool drillsTooMuch(const ClientRef& client, const Header& head, std::size_t entities);
    Result<void> mayGoOn(Client& client, Header& head, std::size_t bytes, bool droppable);
    std::shared_ptr<UserShare> shareOf(const std::string& user);
    Entities::Records seenBy(const Client& client, const std::vector<std::string>* names) const;
    std::size_t pushAll(const Client& client, Entities::Records told = {},
                        const std::vector<std::string>* names = nullptr);
    std::shared_ptr<const users::Access> access(Lane lane) const {
        return access_[static_cast<std::size_t>(lane)].load();
    }
    static bool sees(const Client& client, const users::Access& access, const Registration& registration);
    bool sees(const Client& client, const std::string& entity, Lane lane) const;
    Result<void> mayByLists(const Client& client, Header& head, Lane lane) const;
    bool refuseUnseen(const ClientRef& client, const Header& head);
    static Result<void> isHere(const Client& client);
    bool refuseGone(const Client& client, const Header& head, ClientOutbox& to) const;
    bool keptBack(const Client& client, const Header& head) const;
    std::vector<std::string> allSeen(const Client& client) const;
    std::size_t drillAll(const Client& client, const Header& head);
    template <class Send>
    void sendSignal(const ClientRef& client, Header head, const char* what, Send&& send);
    bool heldByUser(const Client& client, const std::string& entity) const;
    std::optional<std::string> mayNotHold(const Client& client, const Registration& its) const;
    std::optional<std::string> lessBy(const ClientRef& client, const Entities::Records& records,
                                      const users::Access& before, const users::Access& now,
                                      std::vector<GivenUp>& given_up) const;
    void giveUp(const GivenUp& what);
    template <class Send>
    void toThoseWhoSee(const Registration& registration, Send&& send);
    void tellStatus(const Registration& registration, const EntityStatus& status, const Before& before);
    void updateHolding(const std::string& holder);
    bool alone() const { return settings_.name.empty(); }
    void ask(const std::string& server);
    std::optional<std::string> lessThan(const std::string& user, Role role) const;
    void letGo(const std::string& holder, const std::string& entity);
    void forget(const std::string& server, const std::unordered_set<std::string>& but);
    void announce(Lane lane);

    const FrontEndCoreSettings settings_;
    const Clock& clock_;
    const Clock& machine_time_;
    RandomSource& random_;
    EntityTopic& topic_;
    const Note note_;
    const Wake wake_;
    GlobalServicesPort* const global_services_;
    const users::PresentUsers* const users_;

    Settlement settlement_;

    ClientLog log_;

    OtherServers others_;
    OtherServers::Group& entity_servers_;
    std::array<Snapshot<users::Access>, 2> access_;  // of each lane
    // Guarded by mutex_, but for what routing needs:
    Clients clients_;
    Entities entities_;

    mutable std::mutex mutex_;
    // Guarded by mutex_:
    static constexpr std::size_t kPhases = 16;
    std::size_t phases_ = 0;  // given to clients
    Holdings holdings_;
    GoneClients gone_;
    std::unordered_map<std::string, std::shared_ptr<UserShare>> shares_;  // of users who have a session
};

}  // namespace axon::front_end_server
