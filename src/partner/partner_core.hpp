// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "client/base/server_link.hpp"
#include "common/backoff.hpp"
#include "common/clock.hpp"
#include "common/liveness.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "partner/ports.hpp"
#include "partner/signal_relay.hpp"

namespace axon::partner {

struct PartnerCoreSettings {
    std::string laboratory;  ///< what the partner's laboratory is called at home: "b"
    std::string home;        ///< what this one is called there: "a"
    /// Clients of home that use entities there at the same time. A server admits 256 sessions of one user.
    std::size_t visitors_max = 200;
};

/// Joins two laboratories: shows the entities of the partner's at home, and routes between the clients of
/// home and these entities (ADR 0046).
///
/// It does not know who holds what, what a lease is or what runs. The Entity Manager there decides about each
/// message, as it does for clients of its own laboratory: each client of home that uses an entity there is a
/// *visitor*, with a client session of its own there, and what that session may do is what the partner's
/// server and Entity Managers say. The core exchanges headers' ids, names the entities after their
/// laboratory, and removes the offers of direct paths and datagrams, which would go past it.
///
/// States: without the session that watches (nothing is shown, and it is opened again and again, 100 ms to 2
/// s apart), with it. A visitor is opening, up or gone. When a session there is lost or silent, its client is
/// lost there, and its robots stop. When the session that watches is, all sessions there end and every entity
/// leaves home. The session for stops of clients without one of their own is opened again in the same way,
/// and its end ends nothing else: until then these stops go by the session that watches. When the server at
/// home is lost or silent, the visitors who asked for that entity are dropped, for the same reason.
///
/// Threads: one strand, on which the ports call back, too. Signals do not pass here: SignalRelay.
/// Bounds: kWaitingMessages and kWaitingBytes for a visitor who is opening (then OVERLOADED), kAsked requests
/// of each visitor whose refusals by the server there are answered, kHolders names of visitors who are gone,
/// kEntities that are shown, kStreams of an entity that a visitor watches by name (then: all of them).
/// A visitor who has asked neither for an entity nor for a stream leaves after kIdle.
class PartnerCore {
  public:
    using Note = std::function<void(const std::string& line)>;

    static constexpr std::size_t kWaitingMessages = 256;
    static constexpr std::size_t kWaitingBytes = std::size_t{4} * 1024 * 1024;
    static constexpr std::size_t kAsked = 256;
    static constexpr std::size_t kHolders = 1024;
    static constexpr std::size_t kEntities = 1000;
    static constexpr std::size_t kStreams = 64;
    /// Of more than kEntities, others are asked for so long after one of those that are shown has left.
    static constexpr Duration kListAgain = std::chrono::seconds{2};
    static constexpr Duration kIdle = std::chrono::seconds{30};
    /// Beats of a visitor who uses an entity: a fifth of the shortest watchdog of a client. Call onTimer()
    /// twice as often.
    static constexpr Duration kTurn = std::chrono::milliseconds{50};

    PartnerCore(PartnerCoreSettings settings, const Clock& clock, HomePort& home, TherePort& there,
                SignalRelay& signals, Note note)
        : settings_(std::move(settings)),
          clock_(clock),
          home_(home),
          there_(there),
          signals_(signals),
          note_(std::move(note)) {}

    /// Opens the session that watches, and that for stops.
    void start();
    /// Ends all sessions in order: what visitors hold is released.
    void stop();
    void onTimer();
    /// More waits for the strand than it may: nobody knows what would be lost, so all sessions there end.
    void onOverflow() { lose("this gateway does not keep up with what it is sent"); }

    // Of the sessions there.
    void onOpened(SessionNumber session, const Sender& me, const client::Watchdogs& watchdogs);
    void onRefused(SessionNumber session, const Refusal& refusal);
    void onClosed(SessionNumber session, const std::string& reason);
    void onHeartbeat(SessionNumber session);
    void onProfile(SessionNumber session, Presence presence, const Registration& registration,
                   std::string_view profile);
    void onStatus(SessionNumber session, const EntityStatus& status);
    /// An axon.proto.ToClient of an entity there.
    void onEntityMsg(SessionNumber session, Lane lane, bool droppable, const Header& head,
                     std::string_view bytes);
    /// The server there did not pass on a message of this session.
    void onRefusal(SessionNumber session, const Header& head, const Refusal& refusal);

    // Of the entity sessions at home; `entity`: UUID at home.
    void onHomeUp(const std::string& entity);
    void onHomeDown(const std::string& entity, const std::string& reason);
    void onHomeHeartbeat(const std::string& entity);
    /// An axon.proto.ToEntity of a client at home.
    void onClientMsg(const std::string& entity, bool droppable, const Header& head, std::string bytes);
    void onClientUpdate(const std::string& entity, const std::string& client, ClientChange change);
    /// More of this client waits than its share; `answer`: refuses its message, but for the reason.
    void onClientFlood(const std::string& entity, const Sender& client, proto::ToClient answer);
    /// A reset or clear of a client who has no session there.
    void onCommandOfStranger(const std::string& entity, const Header& head);

    std::size_t visitors() const { return visitors_.size(); }
    std::size_t entities() const { return entities_.size(); }

  private:
    struct Shown {
        ShownEntity names;
        Registration registration;  // as at home
        proto::BasicProfile profile;
        std::optional<EntityStatus> status;  // as there
        bool up = false;                     // the session at home
        std::unique_ptr<Liveness> server;    // at home
    };
    /// A message of a visitor, as it goes there.
    struct Waiting {
        Header head;
        std::string bytes;
        bool droppable = false;
    };
    struct Asked {
        std::int64_t sequence = 0;
        std::string there;       // the entity
        proto::ToClient answer;  // with which it is refused, but for the reason
    };
    struct Visitor {
        Sender client;
        SessionNumber session = 0;
        Sender me;  // there; no id while it is opening
        std::deque<Waiting> waiting;
        std::size_t waiting_bytes = 0;
        std::deque<Asked> asked;
        // By entity there:
        std::map<std::string, std::string> check_outs;  // that wait or are granted: request_id of the last
        std::map<std::string, std::set<std::string>> watches;  // its streams; "" is all
        std::map<std::string, LeaseNumber> granted;
        std::set<std::string> busy;  // those that it holds and that do something
        TimePoint used{}, beats_at{};
        std::int64_t beats = 0;
        std::unique_ptr<Liveness> server;
    };
    enum class Ending : std::uint8_t { Orderly, Lost };

    Shown* ofHome(const std::string& entity);
    Shown* ofThere(const std::string& entity);
    Visitor* visitorOf(SessionNumber session);
    Visitor* admit(const Sender& client);

    void show(Shown& entity);
    void tellStatus(const Shown& entity);
    void hide(const std::string& there);
    /// Asks the server there for all entities again: there are more than are shown, and there is room.
    void listAgain();
    Sender holderAtHome(const Sender& there) const;
    /// The visitor of this id there.
    Visitor* visitorThere(const std::string& id);
    /// What the entity there says of its holder: whether it must be heard more often.
    void paceOf(Visitor* visitor, const std::string& there, bool busy);
    static bool engaged(const Visitor& visitor);
    static bool engagedWith(const Visitor& visitor, const std::string& there);
    static void noteAsked(Visitor& visitor, const std::string& there, const proto::ToEntity& asked);
    /// This check-out was refused, or is aborted.
    static void noteNotGranted(Visitor& visitor, const std::string& there, const std::string& request_id);
    /// The client may not go on with this entity: what it has asked there is taken back, and the session
    /// stays for what else it uses. False: too much waits for the server there.
    bool withdraw(Visitor& visitor, const std::string& there);
    void pass(Visitor& visitor, Waiting message);
    void tell(const Shown& entity, const Sender& client, const char* type, Lane lane,
              const proto::ToClient& message);
    void refuse(const Shown& entity, const Sender& client, proto::ToClient answer, const Refusal& refusal);
    /// `why`: what its requests are refused with; OK: it is gone from home, too.
    void end(const std::string& client, Ending ending, const Refusal& why);
    Refusal lostSession(const std::string& why) const;
    /// Nothing is shown and nobody visits until there is another session that watches.
    void lose(const std::string& why);
    void hideAll();
    void openWatch();
    void openStops();
    void endStops();
    /// Returns whether it changed.
    bool translate(const Shown& entity, Visitor& visitor, Lane lane, proto::ToClient& message);

    const PartnerCoreSettings settings_;
    const Clock& clock_;
    HomePort& home_;
    TherePort& there_;
    SignalRelay& signals_;
    const Note note_;

    bool stopped_ = false;
    SessionNumber last_session_ = 0;
    SessionNumber watch_ = 0;  // opening, or up
    Sender watcher_;           // no id: not up
    std::unique_ptr<Liveness> watched_;
    std::int64_t watch_beats_ = 0;
    TimePoint watch_beats_at_{};
    TimePoint watch_again_ = TimePoint::max();
    Backoff backoff_{std::chrono::milliseconds{100}, std::chrono::seconds{2}};
    SessionNumber stops_ = 0;                // opening, or up
    std::unique_ptr<Liveness> stops_heard_;  // null: not up
    std::int64_t stops_beats_ = 0;
    TimePoint stops_beats_at_{};
    TimePoint stops_again_ = TimePoint::max();
    Backoff stops_backoff_{std::chrono::milliseconds{100}, std::chrono::seconds{2}};
    bool stops_noted_ = false;  // that there is none
    std::string last_failure_;  // that was noted

    std::map<std::string, Shown> entities_;        // by UUID there
    std::map<std::string, std::string> there_of_;  // UUID there, by UUID at home
    bool limit_noted_ = false;                     // that there are more than kEntities
    bool more_ = false;                            // … that the server there has told
    TimePoint list_at_ = TimePoint::max();
    std::set<std::string> hidden_;             // UUIDs there of entities whose names are not shown, and noted
    std::map<std::string, Visitor> visitors_;  // by client id at home
    std::map<SessionNumber, std::string> clients_of_;  // client id at home, by session
    std::map<std::string, Sender> holders_;            // client at home, by its id there, also of the gone
    std::deque<std::string> gone_holders_;             // of holders_, those whose sessions have ended
};

}  // namespace axon::partner
