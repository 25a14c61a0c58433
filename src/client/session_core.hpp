// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/profile.pb.h>
#include <axon/task.pb.h>

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "axon/client.hpp"
#include "client/entity_query.hpp"
#include "client/name_index.hpp"
#include "client/server_link.hpp"
#include "client/signal_marks.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/watchdog.hpp"

namespace axon::proto {
class CheckOutReply;
class EntityStatus;
class HandOverRequest;
class Reply;
class RunEvent;
class RunHistory;
class ToClient;
class ToEntity;
}  // namespace axon::proto

namespace axon::client {

/// One granted check-out: the lease's number makes the difference between now and an earlier time.
struct Held {
    std::string entity;
    LeaseNumber lease;

    auto operator<=>(const Held&) const = default;
};

/// Ways to an entity besides the servers, as its lease offers them. Called from inside the core.
class LeaseWays {
  public:
    virtual ~LeaseWays() = default;
    /// Stops of this lease may be sent to `endpoint` as datagrams, keyed by `key`; empty = not, or no longer.
    virtual void onDatagrams(const Held& /*held*/, const std::string& /*endpoint*/,
                             const std::string& /*key*/) {}
    /// A direct path of this lease may be opened at these endpoints ("host:port"), by its key; empty = not, or no
    /// longer.
    virtual void onDirect(const Held& /*held*/, const std::string& /*data_endpoint*/,
                          const std::string& /*signal_endpoint*/, const std::string& /*key*/) {}
};

/// What the core tells its owner. Called from inside the core: implementations queue, they do not call back
/// and do not wait.
class SessionObserver : public LeaseWays {
  public:
    /// Of those that are ready: one that becomes so joins.
    virtual void onEntity(Presence presence, const Entity& entity) = 0;
    virtual void onTask(const TaskReport& report) = 0;
    virtual void onRun(const RunReport& /*report*/) {}
    virtual void onText(const Held& held, const std::string& text) = 0;
    virtual void onRaw(const Held& held, const std::string& bytes) = 0;
    virtual void onService(const Held& held, const Service& service) = 0;
    /// Not called for a lease that this client released itself.
    virtual void onLost(const Held& held, const Refusal& why) = 0;
    /// The connection is lost, or the entity has left, and the lease is not (yet): onResumed or onLost will
    /// follow.
    virtual void onOrphaned(const Held&, const std::string& /*reason*/) {}
    virtual void onResumed(const Held&) {}
    virtual void onHandOver(const Held&, const HandOverRequest&) {}
    /// `sample.json` is left empty: rendering it is the owner's affair, outside any lock.
    virtual void onSample(const Sample& sample) = 0;
    /// Send of the resource from `offset` up to `limit`.
    virtual void onTransferCredit(const Id128& transfer, std::uint64_t offset, std::uint64_t limit) = 0;
    /// What the servers say to people.
    virtual void onServerText(int code, const std::string& text) = 0;
};

/// Settings of one session's behaviour; the defaults are those of safety.md.
struct CoreSettings {
    Duration timeout = std::chrono::seconds{5};  ///< of every request that waits for an answer
    Duration server_silence_busy = std::chrono::seconds{1};  ///< 20 heartbeats of the server missed
    Duration server_silence_idle = std::chrono::seconds{10};
    std::size_t tasks_kept = 1024;  ///< finished tasks whose reports can still be asked for
    std::size_t runs_kept = 64;     ///< likewise of runs
    /// After a lost connection: how often a master that has not ended a run yet is asked what became of it.
    Duration outcome_again = std::chrono::seconds{1};
    bool resume = true;             ///< leases outlive the connection for their grace
    /// How long after this client a server may notice that the connection is gone; the grace begins then. Its
    /// idle watchdog, where that is longer.
    Duration loss_notice = std::chrono::seconds{10};
    /// A place in a wait list is asked for again this often; it is given up after three times as long.
    Duration wait_refresh = std::chrono::seconds{5};
    /// Several that were free and then were not: when to try again, at least; at most twice as long.
    Duration retry = std::chrono::milliseconds{200};
};

/// What proves that a lease is ours.
struct LeaseTicket {
    std::string entity;
    LeaseNumber lease;
    std::string key;  ///< 16 bytes

    std::string toText() const;
    /// MALFORMED for what toText() has not written.
    static Result<LeaseTicket> parse(std::string_view text);
};

/// A global service to be carried out, or to be checked.
struct RunOrder {
    const GlobalService& service;
    std::map<int, std::string> players;  ///< role → UUID
    std::string master;                  ///< UUID, one of the players
    bool check_only = false;
    std::int64_t asked_at_ms = 0;  ///< of the calendar, since 1970 in UTC
};

/// A client's session without its connections: entities, leases, tasks, runs, requests (architecture, sections
/// 6 and 8). Stops are StopDesk's.
///
/// Where in the flow: the first station. An event of the server goes in as one call of on…(), a wish of the
/// user as one of the other calls; messages leave through ServerLink, news through SessionObserver, answers
/// through the `done` of the request, all before the call returns (answers mostly later). Every request is
/// answered exactly once: granted, refused, TIMED_OUT, or NOT_CONNECTED and OUTCOME_UNKNOWN when the
/// connection is lost. `done` must not call back into the core.
///
/// States: connected or not; each entity held, orphaned or neither. On a lost connection entities are
/// forgotten until the server tells of them again, requests are answered, and leases become orphaned: each is
/// resumed with its key as soon as its entity is there again (onResumed), and its tasks are asked after. It
/// is lost (onLost, tasks Unknown) when its Entity Manager refuses, its time is up, or it has no grace. A run
/// shares the fate of its master's lease as a task does; its master is asked after it. A check-out of one entity is asked for, perhaps queued, then granted; of several (or by a query) reserved,
/// then committed, or parked until what is wanted is free again.
///
/// Threads: none of its own, not thread-safe; the owner confines it. Failure: refusals. Malformed bytes are
/// counted and dropped.
class SessionCore {
  public:
    using Done = std::function<void(Result<void>)>;
    using CheckOutDone = std::function<void(Result<std::vector<Held>>)>;
    using ServicesDone = std::function<void(Result<std::vector<Service>>)>;
    using DetailsDone = std::function<void(Result<Details>)>;
    using GlobalServicesDone = std::function<void(Result<GlobalServices>)>;
    using RunRecordsDone = std::function<void(Result<std::vector<RunRecord>>)>;

    SessionCore(CoreSettings settings, const Clock& clock, RandomSource& random, ServerLink& link,
                SessionObserver& observer, SignalMarks& marks);

    // From the server. Profiles may come before onConnected: the handshake's reply can be overtaken by them.
    /// `watchdogs`: of the server, for this client; a sign of life goes to it in a fifth of each.
    void onConnected(const Sender& self, int entities, const Watchdogs& watchdogs = {});
    /// `for_good`: there will be no other connection, so nothing is kept.
    void onDisconnected(const std::string& reason, bool for_good = false);
    void onProfile(Presence presence, const Registration& registration, std::string_view profile);
    void onStatus(const EntityStatus& status);
    /// A record of a services profile, to be kept for a lease that is held.
    void onServiceRecord(const Header& head, std::string_view record);
    /// `bytes` is an axon.proto.ToClient; receipts in it are not for this object. `of_server`: the server has brought
    /// it, and lives.
    void onEntityMsg(const Header& head, std::string_view bytes, bool of_server = true);
    /// newRefusalMsg: `head` repeats the sequence and entity of what this client sent.
    void onRefusal(const Header& head, const Refusal& refusal);
    void onServerText(int code, const std::string& text);
    void onServerHeartbeat();

    // What is due, at nextDeadline(): requests that nobody answered.
    void onTimer();
    TimePoint nextDeadline() const;
    // The beat that says that this client lives, apart from the above: its owner may have to ask somebody
    // first.
    void onHeartbeatTimer();
    TimePoint nextHeartbeat() const { return next_heartbeat_; }
    /// The server has been silent for longer than it may be.
    bool serverSilent() const { return connected_ && server_.expired(clock_.now()); }
    TimePoint serverDeadline() const { return connected_ ? server_.deadline() : TimePoint::max(); }

    // What is known.
    bool connected() const { return connected_; }
    const Sender& self() const { return self_; }
    /// Every entity that the server promised at the connection has been told of.
    bool complete() const { return connected_ && present_ >= promised_; }
    std::vector<Entity> entities(Listed listed = Listed::Ready) const;
    Result<Entity> find(std::string_view name) const;
    Result<Entity> entity(const std::string& id) const;
    /// The shortest name that means only this entity.
    std::string callName(const std::string& id) const { return names_.label(id); }
    std::vector<Held> held() const;
    bool holds(const Held& held) const;
    /// Held, and waiting for the connection or the Entity Manager's word that it still is.
    bool orphaned(const Held& held) const;
    std::optional<HandOverRequest> question(const Held& held) const;
    Result<LeaseTicket> ticket(const Held& held) const;
    Result<std::vector<Service>> services(const Held& held) const;
    Result<Service> service(const Held& held, std::string_view name_or_global_id) const;
    /// Nothing for a task that is not known (any more).
    std::optional<TaskReport> task(const Id128& id) const;
    std::optional<RunReport> runReport(const Id128& id) const;
    /// A task or a run of this client is not final, or an entity that it holds is busy: heartbeats are fast.
    bool busy() const;
    /// Held by this client as far as is known here or as its entity says, and BUSY or driven otherwise.
    bool moving(const std::string& entity) const { return moving_.count(entity) != 0; }
    std::uint64_t malformed() const { return malformed_; }
    std::size_t pendingRequests() const { return pending_.size(); }

    // What the user wants.
    void checkOut(const std::vector<std::string>& names, CheckOutDone done) {
        checkOut(names, {}, std::move(done));
    }
    /// The number is for giveUp(). `options.give_up` is the owner's affair; `options.on_waiting` must not
    /// call back into the core.
    Id128 checkOut(const std::vector<std::string>& names, const CheckOutOptions& options, CheckOutDone done);
    Id128 checkOut(const EntityQuery& query, const CheckOutOptions& options, CheckOutDone done);
    void giveUp(Id128 check_out);
    /// A lease of another session of the same user, by its key.
    void resume(const LeaseTicket& ticket, CheckOutDone done);
    Result<void> answerHandOver(const Held& held, bool accept, std::string_view reason);
    Result<void> setHandOverPolicy(const Held& held, const HandOverPolicy& policy);
    /// The lease is given up at once, whatever the answer.
    void release(const Held& held, Done done);
    void set(const Held& held, std::string_view service, const Argument& argument, Done done);
    /// The id of the new task; its refusal, should it be refused here, is told to the observer like any
    /// other.
    Id128 run(const Held& held, std::string_view service, const std::vector<Argument>& arguments,
              Duration not_after);
    /// PAUSE is done when the task is paused, RESUME when it runs, CANCEL when it has ended.
    void control(const Id128& task, proto::TaskAction action, Done done);
    /// Refused here: NOT_CONNECTED, NOT_HOLDER, WRONG_STATE for leases of more than one root, MALFORMED for
    /// roles without a player or a master without a role, WRONG_TYPE for an output that the input it feeds can
    /// never take. All else comes as reports of the run.
    Result<Id128> runGlobal(const RunOrder& order);
    void controlRun(const Id128& run, proto::TaskAction action, Done done);
    void fetchGlobalServices(GlobalServicesDone done);
    /// Runs of which the entity was the master; no lease needed. `most` = 0: all that it keeps.
    void fetchRuns(const std::string& entity, int most, RunRecordsDone done);
    Result<void> sendText(const Held& held, std::string_view text);
    Result<void> sendRaw(const Held& held, std::string_view bytes);
    /// `sequence`: of the signals of this client; 0 = the next one.
    Result<void> reset(const Held& held, std::int64_t sequence = 0);
    Result<void> clear(const Held& held, std::int64_t sequence = 0);
    void rearm(const std::string& entity, Done done);
    /// Asks the entity itself; no lease needed.
    void fetchDetails(const std::string& entity, DetailsDone done);
    void fetchServices(const std::string& entity, ServicesDone done);
    /// Each watch() needs one unwatch() of the same streams; what is watched is asked for again when the
    /// entity comes back.
    Result<void> watch(const std::string& entity, const std::vector<std::string>& streams);
    void unwatch(const std::string& entity, const std::vector<std::string>& streams);
    /// Offers a resource. Credits come through the observer until `done`; its time counts from the last of
    /// them.
    Id128 offer(const Held& held, std::string_view service, std::string_view resource,
                const std::string& file_name, std::uint64_t size, const std::string& sha256, Done done);
    /// Of one upload to this entity; 0 = it has not told.
    std::uint64_t resourceBytesMax(const Held& held) const;
    /// At most 64 KiB, inside the window of the last credit. The refusal of a transfer that has ended.
    Result<void> sendChunk(const Id128& transfer, std::uint64_t offset, std::string_view content);

  private:
    /// It is there for the program once its profile and its status have come; either may be first.
    struct KnownEntity {
        Entity facts;
        bool announced = false;
        bool heard = false;  // its status
        EntityState told = EntityState::UNAV;  // by the server; `facts` may be newer, by the entity itself
        bool there() const { return announced && heard; }
    };
    void join(const KnownEntity& known);
    /// To the observer, of an entity that it knows.
    void tellChanged(const KnownEntity& known);
    struct Lease {
        LeaseNumber number;
        std::string key, root;
        std::string name;  // the entity's, for when it is not known
        proto::ServicesProfile services;
        Duration grace{};
        std::uint64_t resource_bytes_max = 0;  // 0 = not known
        HandOverPolicy policy;
        std::string asked_by;  // request id of `question`
        std::optional<HandOverRequest> question;
        TimePoint answer_until{};  // of `question`
        bool orphaned = false;
        bool left = false;  // orphaned because the entity is gone, not the connection
        TimePoint expires;  // while orphaned
        Id128 resume;       // of the Ask::Resume in pending_, while orphaned
    };
    struct TaskRecord {
        Held held;
        TaskReport report;
    };
    struct RunEntry {
        Held master;
        RunReport report;
        std::uint64_t sequence = 0;  // of the last event
    };
    enum class Ask : std::uint8_t {
        CheckOut,
        Release,
        Set,
        Control,
        Rearm,
        Services,
        Upload,
        Task,
        Resume,  // of an orphaned lease; outlives the connection
        Tasks,   // what became of those of a lease that was resumed
        Run,
        Runs,  // what became of those whose master was resumed
        GlobalServices,
        RunRecords,
    };
    using Key = std::pair<Ask, Id128>;
    struct Pending {
        Ask ask = Ask::Set;
        std::string entity;
        LeaseNumber lease;  // under which it was asked; {0, 0} = none
        std::int64_t sequence = 0;
        TimePoint deadline;
        proto::TaskAction action = proto::TASK_ACTION_UNSPECIFIED;
        Done done;
        DetailsDone details_done;
        GlobalServicesDone global_services_done;
        RunRecordsDone run_records_done;
        std::vector<Id128> tasks;  // of Ask::Tasks; of Ask::Runs the runs
        TimePoint until;           // of Ask::Runs: when it is given up
    };
    /// One check-out of one or more entities, on its way.
    struct CheckOutParty {
        std::string entity;
        std::int64_t sequence = 0;
        bool answered = false;  // in the present phase
        bool refused = false;
        bool granted = false;
        LeaseNumber lease;
    };
    enum class Stage : std::uint8_t {
        Looking,     // for what the candidates of a query can do
        Asked,       // TAKE, RESERVE or RESUME_LEASE is under way
        Queued,      // in a wait list, or the holder is being asked
        Parked,      // several: until all are free
        Committing,  // several: COMMIT is under way
    };
    struct CheckOutOrder {
        CheckOutOptions options;
        std::vector<std::string> wanted;   // UUIDs …
        std::optional<EntityQuery> query;  // … or this
        std::optional<LeaseTicket> resume;
        Stage stage = Stage::Asked;
        Id128 request;  // of the present attempt; the entities know it by this
        bool several = false;
        std::vector<CheckOutParty> parties;                   // of the present attempt
        TimePoint due = TimePoint::max();                     // in deadlines_
        TimePoint until = TimePoint::max();                   // it waits no longer
        std::set<std::string> passed_over;                    // of a query: refused in this round
        std::map<std::string, std::set<std::string>> offers;  // of a query: names of services
        std::size_t looking = 0;
        Refusal last;
        int place = -1;
        std::string told;
        std::string kept;  // by the holder that was asked: what it said
        CheckOutDone done;
    };
    using CheckOutOrders = std::map<Id128, CheckOutOrder>;
    using Pendings = std::map<Key, Pending>;

    Header header(const std::string& entity, const char* msg_type, LeaseNumber lease = {});
    std::int64_t send(const std::string& entity, const char* msg_type, LeaseNumber lease,
                      const proto::ToEntity& body);
    Refusal notConnected() const;
    Refusal notHolder(const Held& held) const;
    Refusal ready(const Held& held) const;
    Lease* lease(const Held& held);
    const Lease* lease(const Held& held) const;
    std::string label(const std::string& entity) const { return names_.label(entity); }
    /// WRONG_TYPE names every result of a step that a later one cannot take for its type or units.
    Refusal misfits(const RunOrder& order) const;

    // Ids by value throughout: callers may name them by the very key that goes away.
    void await(Ask ask, Id128 id, Pending pending);
    /// Takes it out of everything that knows it.
    Pending take(Pendings::iterator found);
    bool answer(Ask ask, Id128 id, const Result<void>& result);
    void answerAll(const std::string& entity, const Refusal& why);
    std::vector<Key> pendingOf(const std::string& entity) const;
    void postpone(Pendings::iterator found, TimePoint deadline);
    void endReleases(const std::string& entity, const std::function<bool(LeaseNumber)>& which);

    void onCheckOutReply(const Header& head, const proto::CheckOutReply& reply);
    void onTaskEvent(const std::string& entity, const proto::TaskEvent& event);
    void onReply(const Header& head, const proto::Reply& reply);
    void onStatusMsg(const Header& head, const proto::EntityStatus& status);
    void onService(const std::string& entity, const proto::Service& service);
    void onHandOver(const std::string& entity, const proto::HandOverRequest& request);

    Id128 begin(CheckOutOrder order, CheckOutDone done);
    /// Asks for what is wanted, or for what of the query is there now.
    void attempt(Id128 id);
    /// Asks candidates of a query for their services. False when nothing is left to be asked.
    bool look(Id128 id);
    Assignment choose(const CheckOutOrder& order, bool optimistic, std::vector<std::string>& chosen) const;
    bool wantedAreFree(const CheckOutOrder& order) const;
    Refusal lacking(const CheckOutOrder& order, const Assignment& assignment) const;
    void park(Id128 id, const Refusal& why, bool soon);
    void wakeParked();
    void schedule(Id128 id, TimePoint due);
    void onCheckOutDue(Id128 id);
    void onPartyRefused(Id128 id, const std::string& entity, const Refusal& why);
    void onWaiting(Id128 id, int place);
    void tellWaiting(CheckOutOrder& order, Waiting waiting);
    void advanceCheckOut(Id128 id);
    void failCheckOut(Id128 id, Refusal why);
    /// Takes back what the present attempt has asked for.
    void endAttempt(CheckOutOrder& order, const Refusal& why);
    void forgetAttempt(CheckOutOrder& order);
    CheckOutOrder takeOrder(CheckOutOrders::iterator found);
    void sendCheckOut(CheckOutOrder& order, CheckOutParty& party, int phase);
    void orphan(const std::string& entity, bool left, const std::string& reason);
    void sendResume(const std::string& entity);
    /// Whether it was the answer to one of sendResume().
    bool onResumeReply(const std::string& entity, Id128 id, const proto::CheckOutReply& reply);
    void onResumeDue(Id128 id);
    void askAfterTasks(const Held& held);
    void sendRelease(const Held& held);
    void grant(const std::string& entity, const proto::CheckOutReply& reply, const HandOverPolicy& policy);
    /// The entity by value: callers name it by its key in leases_, which goes away here.
    void endLease(std::string entity, const Refusal& why, bool tell);
    /// Until it is final, or the time is up and it becomes Unknown.
    void awaitTask(Id128 id, const TaskRecord& record);
    void finishTask(Id128 id, TaskState state, const Refusal& why);
    void settleControls(Id128 id, const TaskReport& report);
    void noteFinal(Id128 id);
    std::vector<Id128> openTasks(const Held& held) const;
    /// Its master was released: until it is final, or the time is up and it becomes Unknown.
    void awaitRun(Id128 id);
    void onRunEvent(const std::string& entity, const proto::RunEvent& event);
    void onRunHistory(const std::string& entity, const proto::RunHistory& history);
    void onRunsDue(Id128 id);
    void askAfterRuns(const Held& master);
    void sendRunHistoryRequest(Pending& pending, Id128 id);
    void finishRun(Id128 id, RunState state, const Refusal& why);
    /// What is new of it, to the observer and to who waits for its state.
    void tellRun(Id128 id);
    void settleRunControls(Id128 id, const RunReport& report);
    void cancelRun(Id128 id, const Held& master);
    std::vector<Id128> openRuns(const Held& master) const;
    /// A refusal that says that the lease is no longer ours.
    void noteRefusal(const std::string& entity, LeaseNumber under, const Refusal& refusal);
    void sendWatches(const std::string& entity);
    /// Whether the entity is held and moves; after each change of its state or its lease.
    void countMoving(const std::string& entity);
    void pace();
    Duration beatPeriod(bool fast) const;

    // Constant after construction.
    const CoreSettings settings_;
    const Clock& clock_;
    RandomSource& random_;
    ServerLink& link_;
    SessionObserver& observer_;
    SignalMarks& marks_;

    bool connected_ = false;
    Sender self_;
    int promised_ = 0;
    int present_ = 0;
    Watchdog server_;
    Watchdogs watchdogs_;  // of the server, for this client
    std::int64_t sequence_ = 0;
    std::int64_t beat_ = 0;
    TimePoint next_heartbeat_ = TimePoint::max();
    std::uint64_t malformed_ = 0;

    NameIndex names_;
    std::unordered_map<std::string, KnownEntity> entities_;
    std::map<std::string, Lease> leases_;
    std::set<std::string> asked_;          // for a check-out, in this session
    std::set<std::string> moving_;         // held (countMoving), and BUSY or driven otherwise
    std::set<std::string> busy_;           // of those the BUSY ones that the server takes for this client's
    std::unordered_map<Id128, TaskRecord> tasks_;
    std::size_t running_tasks_ = 0;
    std::deque<Id128> finished_tasks_;
    std::map<Held, std::set<Id128>> open_tasks_;  // those of tasks_ that are not final
    std::unordered_map<Id128, RunEntry> runs_;
    std::set<Id128> open_runs_;  // those of runs_ that are not final
    std::deque<Id128> finished_runs_;
    std::string root_;  // of every lease of this session; of a resumed one, when that was the first
    CheckOutOrders check_outs_;
    std::unordered_map<Id128, Id128> attempts_;  // request → of which of check_outs_
    std::set<Id128> parked_;                     // those of check_outs_ that wait for entities to be free
    std::unordered_map<Id128, Held> transfers_;
    Pendings pending_;
    // Of pending_ and check_outs_:
    std::set<std::pair<TimePoint, Key>> deadlines_;
    std::unordered_map<std::int64_t, Key> by_sequence_;
    std::unordered_map<std::string, std::set<Key>> of_entity_;
    std::map<std::string, std::map<std::string, int>> watches_;  // entity → stream → how many; "" = all
};

}  // namespace axon::client
