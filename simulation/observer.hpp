// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "common/ids.hpp"
#include "common/routed.hpp"
#include "entity_manager/ports/journal_record.hpp"
#include "simulation/network.hpp"
#include "simulation/timeline.hpp"

namespace axon::proto {
class EmToEi;
class TaskRequest;
class ToClient;
}  // namespace axon::proto

namespace axon::simulation {

/// The eleven promises, by the names that a violation is reported under (docs/how-to/simulate.md).
enum class Invariant : std::uint8_t {
    OneLease,   ///< 1 at most one obeyed lease for each entity, and no moving robot is handed over
    Fence,      ///< 2 nothing is executed below the highest lease or stop generation seen
    DeadMan,    ///< 3 every failure ends with the robot stopped within its bound
    Latch,      ///< 4 after a stop no motion before a rearm and then a new command
    Once,       ///< 5 a task id reaches the application at most once, and none whose end has been told
    TooLate,    ///< 6 nothing is dispatched after its expiry or a later stop
    Order,      ///< 7 the tasks of a lease are dispatched in the order of their sending
    ComesBack,  ///< 8 after the faults everything becomes available again
    Bounded,    ///< 9 queues stay below their bounds, and nothing is left behind at the end
    Journal,    ///< 10 every decision is told and written down
    Unhurt,     ///< 11 where nothing fails, nobody's lies end a session or stop a robot
};
inline constexpr std::size_t kInvariants = 11;
const char* toString(Invariant invariant);

struct Violation {
    Invariant invariant;
    TimePoint at;
    std::string what;
};

/// What happened in a run: a promise that was never put to the test is not one that was kept.
struct Counts {
    std::uint64_t tasks = 0, dispatches = 0, stops = 0, grants = 0, rearms = 0;
    std::uint64_t waits = 0;        ///< somebody was told a place in a wait list, or that the holder is asked
    std::uint64_t questions = 0;    ///< a holder was asked
    std::uint64_t kept = 0;         ///< … and has kept it
    std::uint64_t handed_over = 0;  ///< … and has not
    std::uint64_t forced = 0;       ///< an administrator took what somebody held
    std::uint64_t resumed = 0;      ///< a holder that was lost came back within its grace
    std::uint64_t tickets = 0;      ///< … of them: in another process, with the key that was written down
    std::uint64_t lost_for_good = 0;  ///< … and did not
    std::uint64_t held = 0;           ///< a client was lost, and its task is paused instead of stopped
    std::uint64_t finished = 0;       ///< a client was lost, and its task moved on for its time
    std::uint64_t slow_dropped = 0;   ///< data that a slow reader did not get
    std::uint64_t slow_lost = 0;      ///< slow readers that the server has given up
    std::uint64_t lies = 0;           ///< messages of who lies, that its sessions let it send
    std::uint64_t paths = 0;          ///< direct paths that stood …
    std::uint64_t paths_ended = 0;    ///< … and are over, for whatever reason …
    std::uint64_t paths_broken = 0;   ///< … or another one than the end of the lease
    std::uint64_t sent_again =
        0;  ///< messages that went by the servers because their path had not acknowledged them

    void add(const Counts& other);
};
struct CountName {
    const char* name;
    std::uint64_t Counts::*count;
};
inline constexpr std::array<CountName, 22> kCounts{{{"tasks", &Counts::tasks},
                                                    {"dispatches", &Counts::dispatches},
                                                    {"stops", &Counts::stops},
                                                    {"grants", &Counts::grants},
                                                    {"rearms", &Counts::rearms},
                                                    {"waits", &Counts::waits},
                                                    {"questions", &Counts::questions},
                                                    {"kept", &Counts::kept},
                                                    {"handed_over", &Counts::handed_over},
                                                    {"forced", &Counts::forced},
                                                    {"resumed", &Counts::resumed},
                                                    {"tickets", &Counts::tickets},
                                                    {"lost_for_good", &Counts::lost_for_good},
                                                    {"held", &Counts::held},
                                                    {"finished", &Counts::finished},
                                                    {"slow_dropped", &Counts::slow_dropped},
                                                    {"slow_lost", &Counts::slow_lost},
                                                    {"lies", &Counts::lies},
                                                    {"paths", &Counts::paths},
                                                    {"paths_ended", &Counts::paths_ended},
                                                    {"paths_broken", &Counts::paths_broken},
                                                    {"sent_again", &Counts::sent_again}}};

/// A client's session as the dead-man sees it: the process behind it, and the way to the server.
struct SessionHealth {
    std::string id;
    const Process* process = nullptr;
    std::uint32_t life = 0;
    std::optional<TimePoint> ended_at;  ///< its connection is gone at the client or the server
    const Path* path = nullptr;
};

/// Sees all that passes the Entity Managers and the robot applications, and judges it by rules of its own
/// that ask the cores nothing but what they say of themselves. The first violation ends the run.
class Observer {
  public:
    Observer(Timeline& timeline, Process& world) : timeline_(timeline), world_(world) {}

    struct Hops {
        const Process* server;
        const Process* manager;
        const Process* application;
        const Path* server_path;
    };
    void addEntity(const std::string& name, Hops hops);
    void addSession(const SessionHealth& session) { sessions_[session.id] = session; }
    void sessionEnded(const std::string& id);
    /// What the bounds of the dead-man allow beside the watchdogs: the longest delay that is being injected.
    void delayed(Duration most) { delay_ = std::max(delay_, most); }
    void clocksDiffer(double by) { drift_ = by; }
    /// At most direct paths do. Every end of a session that is not its own wish is somebody else's doing
    /// then, and so is every stop for a loss, and every message that is lost.
    void nothingFails(bool nothing) { nothing_fails_ = nothing; }
    /// Not even direct paths fail: they end with their leases.
    void pathsStand(bool stand) { paths_stand_ = stand; }
    void hurt(const std::string& what) {
        if (nothing_fails_) violated(Invariant::Unhurt, what);
    }
    void pathHurt(const std::string& what) {
        if (paths_stand_) violated(Invariant::Unhurt, what);
    }
    /// A fault has begun: whoever moves must have stopped in time.
    void faultBegins();

    // At an Entity Manager, by the entity's number.
    void managerStarts(std::size_t entity);
    void managerDies(std::size_t entity);
    /// The link to its application has broken: a loss, which latches what somebody holds.
    void linkLost(std::size_t entity);
    void taskArrives(std::size_t entity, const Header& head, const proto::TaskRequest& request,
                     TimePoint local);
    /// A client's message is being handled, or (null) no longer.
    void inHand(std::size_t entity, const Header* head);
    void toApplication(std::size_t entity, const proto::EmToEi& message, TimePoint local);
    /// A stop is on its way to the application; `signal`: of the signal thread, and so not of the core's own.
    void stopGoesOut(std::size_t entity, std::uint32_t generation, StopCause cause, bool signal);
    void toClient(std::size_t entity, const Header& head, const proto::ToClient& message);
    void managerIs(std::size_t entity, const EntityStatus& status);
    /// The holder that the core names; nothing else of a status that has not changed is looked at.
    void holderIs(std::size_t entity, const std::string& holder);

    /// The signal thread takes a stop for a new one.
    void stopRaises(std::size_t entity, const Header& head, std::uint32_t life);
    /// An entry of its journal.
    void noted(std::size_t entity, const entity_manager::JournalRecord& record);

    // Messages that may not be lost, whichever way they take: each is passed on once, in the order of
    // sending, and where nothing fails every one of them is. What goes by the servers always has no place in
    // that order.
    /// A client gives one to its library …
    void sends(const Header& head);
    /// … and its Entity Manager's core is given it. `repeated`: the network has made it come again.
    void passes(std::size_t entity, const Header& head, bool repeated);
    /// An Entity Manager's core gives one …
    void tells(const Header& head);
    /// … and the client's core hears it.
    void hears(const Header& head);
    /// A lane of a direct path is admitted. `proper`: to the present holder, who has proved it.
    void pathOpens(std::size_t entity, bool proper);
    /// Numbers and keys of leases that have ended, of any entity: those who held them know them still.
    std::vector<std::pair<LeaseNumber, std::string>> endedLeases() const;
    /// At the end: what has not been passed on.
    void judgeMessages();

    // At a robot application.
    void dispatched(std::size_t entity, const std::string& task_id);
    /// `alone`: how long after the loss of its client all that moves may go on.
    void moves(std::size_t entity, bool moves, Duration alone = {});
    bool moving(std::size_t entity) const { return entities_[entity].moves; }

    void violated(Invariant invariant, std::string what);
    const std::optional<Violation>& violation() const { return violation_; }

    const Counts& counts() const { return counts_; }
    Counts& counts() { return counts_; }

  private:
    struct Facts {
        std::size_t entity = 0;
        LeaseNumber held;
        std::uint32_t generation = 0;
        std::int64_t sequence = 0;
        TimePoint arrived;        ///< on the world's clock
        TimePoint arrived_local;  ///< on the Entity Manager's
        std::uint32_t life = 0;
        double not_after_s = 0;
        int dispatches = 0;
        int reached = 0;
        bool ended = false;
        bool noted = false;  ///< its dispatch is in the journal
        bool end_noted = false;
        std::uint64_t order = 0;
    };
    struct Entity {
        std::string name;
        Hops hops{};
        bool moves = false;
        TimePoint moves_since;   ///< without the short pauses between tasks
        TimePoint stands_since;  ///< if it does not move
        Duration alone{};        ///< of what moves now …
        TimePoint alone_since;   ///< … since when it has been no longer than that
        LeaseNumber highest;
        std::string holder;        ///< of the highest lease
        bool ended = true;         ///< that lease, as far as was told
        std::uint32_t raised = 0;  ///< newest stop generation that went to the application
        std::uint32_t voided = 0;  ///< newest that makes older commands void
        std::uint64_t voided_order = 0;
        bool latch_wanted = false;  ///< a stop that latches has been given, and no rearm since
        bool latch_told = false;    ///< the core has said so since
        std::uint64_t rearmed_order = 0;
        bool in_hand = false;  ///< a client's message is being handled
        bool rearm_in_hand = false;
        bool stale_in_hand = false;  ///< it was sent under an older lease than the newest
        std::optional<EntityStatus> status;
        std::string present_holder;
        TimePoint holder_since;
        std::vector<std::pair<LeaseNumber, std::string>> keys;  ///< of all leases, oldest first
        LeaseNumber end_told;  ///< newest lease whose end was told to its holder
        std::map<LeaseNumber, std::int64_t> last_sequence;
        // What the journal says.
        LeaseNumber granted;
        LeaseNumber lease_ended;
        LeaseNumber taken_over;  ///< newest that somebody took from its holder
        std::uint64_t rearms_noted = 0, rearms = 0;
        std::vector<std::uint32_t> stops_to_note;
        std::map<std::pair<std::string, std::int64_t>, std::uint32_t> stops_seen;  ///< and in which life
    };
    struct Row {                                              ///< of one sender's messages to one receiver
        std::deque<std::pair<std::int64_t, TimePoint>> sent;  ///< and not yet passed on; where nothing fails
        std::int64_t passed = 0;
        std::int64_t sent_at_us = 0;  ///< of the one that has passed
        std::uint32_t life = 0;       ///< of the Entity Manager
    };
    using Rows = std::map<std::pair<std::string, std::string>, Row>;  ///< by client and entity
    void takeNext(Row& row, const Header& head);
    void watchMotion(std::size_t entity, Duration in);
    void judgeMotion(std::size_t entity);
    std::string label(const std::string& task_id) const;
    static void wantLatch(Entity& entity);

    Timeline& timeline_;
    Process& world_;
    std::vector<Entity> entities_;
    std::map<std::string, SessionHealth> sessions_;
    std::unordered_map<std::string, Facts> tasks_;
    Rows to_entity_, to_client_;
    std::set<std::string> uuids_;  ///< of honest entities
    std::uint64_t order_ = 0;
    Duration delay_{};
    double drift_ = 0;
    bool nothing_fails_ = false;
    bool paths_stand_ = false;
    std::optional<Violation> violation_;
    Counts counts_;
};

}  // namespace axon::simulation
