// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/profile.pb.h>
#include <axon/task.pb.h>

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "axon/client.hpp"
#include "client/name_index.hpp"
#include "client/server_link.hpp"
#include "client/signal_marks.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/watchdog.hpp"

namespace axon::proto {
class CheckOutReply;
class EntityStatus;
class Reply;
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

/// What the core tells its owner. Called from inside the core: implementations queue, they do not call back
/// and do not wait.
class SessionObserver {
  public:
    virtual ~SessionObserver() = default;
    virtual void onEntity(Presence presence, const Entity& entity) = 0;
    virtual void onTask(const TaskReport& report) = 0;
    virtual void onText(const Held& held, const std::string& text) = 0;
    virtual void onRaw(const Held& held, const std::string& bytes) = 0;
    virtual void onService(const Held& held, const Service& service) = 0;
    /// Not called for a lease that this client released itself.
    virtual void onLost(const Held& held, const Refusal& why) = 0;
    /// Stops of this lease may be sent to `endpoint` as datagrams, keyed by `key`; empty = not (any more).
    virtual void onDatagrams(const Held& /*held*/, const std::string& /*endpoint*/, const std::string& /*key*/) {}
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
    Duration heartbeat_busy = std::chrono::milliseconds{50};
    Duration heartbeat_idle = std::chrono::seconds{2};
    Duration server_silence_busy = std::chrono::seconds{1};  ///< 20 heartbeats missed
    Duration server_silence_idle = std::chrono::seconds{10};
    std::size_t tasks_kept = 1024;  ///< finished tasks whose reports can still be asked for
};

/// A client's session without its connections: entities, leases, tasks, requests (architecture, sections 6
/// and 8). Stops are StopDesk's.
///
/// Where in the flow: the first station. An event of the server goes in as one call of on…(), a wish of the
/// user as one of the other calls; messages leave through ServerLink, news through SessionObserver, answers
/// through the `done` of the request, all before the call returns (answers mostly later). Every request is
/// answered exactly once: granted, refused, TIMED_OUT, or NOT_CONNECTED and OUTCOME_UNKNOWN when the
/// connection is lost. `done` must not call back into the core.
///
/// States: connected or not; each entity held or not. On a lost connection leases are gone (onLost), tasks
/// that are not final become Unknown, entities are forgotten until the server tells of them again.
///
/// Threads: none of its own, not thread-safe; the owner confines it. Failure: refusals. Malformed bytes are
/// counted and dropped.
class SessionCore {
  public:
    using Done = std::function<void(Result<void>)>;
    using CheckOutDone = std::function<void(Result<std::vector<Held>>)>;
    using ServicesDone = std::function<void(Result<std::vector<Service>>)>;

    SessionCore(CoreSettings settings, const Clock& clock, RandomSource& random, ServerLink& link,
                SessionObserver& observer, SignalMarks& marks);

    // From the server. Profiles may come before onConnected: the handshake's reply can be overtaken by them.
    void onConnected(const Sender& self, int entities);
    void onDisconnected(const std::string& reason);
    void onProfile(Presence presence, const Registration& registration, std::string_view profile);
    void onStatus(const EntityStatus& status);
    /// A record of a services profile, to be kept for a lease that is held.
    void onServiceRecord(const Header& head, std::string_view record);
    /// `bytes` is an axon.proto.ToClient; receipts in it are not for this object.
    void onEntityMsg(const Header& head, std::string_view bytes);
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
    bool complete() const { return connected_ && announced_ >= promised_; }
    std::vector<Entity> entities() const;
    Result<Entity> find(std::string_view name) const;
    Result<Entity> entity(const std::string& id) const;
    std::vector<Held> held() const;
    bool holds(const Held& held) const;
    Result<std::vector<Service>> services(const Held& held) const;
    Result<Service> service(const Held& held, std::string_view name_or_global_id) const;
    /// Nothing for a task that is not known (any more).
    std::optional<TaskReport> task(const Id128& id) const;
    /// A task of this client is not final, or an entity that it holds is busy: heartbeats are fast.
    bool busy() const;
    std::uint64_t malformed() const { return malformed_; }
    std::size_t pendingRequests() const { return pending_.size(); }

    // What the user wants.
    void checkOut(const std::vector<std::string>& names, CheckOutDone done);
    /// The lease is given up at once, whatever the answer.
    void release(const Held& held, Done done);
    void set(const Held& held, std::string_view service, const Argument& argument, Done done);
    /// The id of the new task; its refusal, should it be refused here, is told to the observer like any
    /// other.
    Id128 run(const Held& held, std::string_view service, const std::vector<Argument>& arguments,
              Duration not_after);
    /// PAUSE is done when the task is paused, RESUME when it runs, CANCEL when it has ended.
    void control(const Id128& task, proto::TaskAction action, Done done);
    Result<void> sendText(const Held& held, std::string_view text);
    Result<void> sendRaw(const Held& held, std::string_view bytes);
    Result<void> reset(const Held& held);
    Result<void> clear(const Held& held);
    void rearm(const std::string& entity, Done done);
    /// Asks the entity itself; no lease needed.
    void fetchServices(const std::string& entity, ServicesDone done);
    /// Each watch() needs one unwatch() of the same streams; what is watched is asked for again when the
    /// entity comes back.
    Result<void> watch(const std::string& entity, const std::vector<std::string>& streams);
    void unwatch(const std::string& entity, const std::vector<std::string>& streams);
    /// Offers a resource. Credits come through the observer until `done`; its time counts from the last of
    /// them.
    Id128 offer(const Held& held, std::string_view service, std::string_view resource,
                const std::string& file_name, std::uint64_t size, const std::string& sha256, Done done);
    /// At most 64 KiB, inside the window of the last credit. The refusal of a transfer that has ended.
    Result<void> sendChunk(const Id128& transfer, std::uint64_t offset, std::string_view content);

  private:
    struct KnownEntity {
        Entity facts;
        bool announced = false;  // a status can come before the profile
    };
    struct Lease {
        LeaseNumber number;
        std::string key;
        proto::ServicesProfile services;
    };
    struct TaskRecord {
        Held held;
        TaskReport report;
    };
    enum class Ask : std::uint8_t { CheckOut, Release, Set, Control, Rearm, Services, Upload, Task };
    struct Pending {
        Ask ask = Ask::Set;
        std::string entity;
        LeaseNumber lease;  // under which it was asked; {0, 0} = none
        std::int64_t sequence = 0;
        TimePoint deadline;
        proto::TaskAction action = proto::TASK_ACTION_UNSPECIFIED;
        Done done;
        ServicesDone services_done;
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
    struct CheckOutOrder {
        bool several = false;
        bool committing = false;
        std::vector<CheckOutParty> parties;
        TimePoint deadline;
        CheckOutDone done;
    };
    using Pendings = std::map<std::pair<Ask, Id128>, Pending>;

    Header header(const std::string& entity, const char* msg_type, LeaseNumber lease = {});
    std::int64_t send(const std::string& entity, const char* msg_type, LeaseNumber lease,
                      const proto::ToEntity& body);
    Refusal notConnected() const;
    Refusal notHolder(const Held& held) const;
    Refusal ready(const Held& held) const;
    Lease* lease(const Held& held);
    const Lease* lease(const Held& held) const;
    std::string label(const std::string& entity) const { return names_.label(entity); }

    void await(Ask ask, const Id128& id, Pending pending);
    bool answer(Ask ask, const Id128& id, const Result<void>& result);
    void answerAll(const std::string& entity, const Refusal& why);

    void onCheckOutReply(const Header& head, const proto::CheckOutReply& reply);
    void onTaskEvent(const std::string& entity, const proto::TaskEvent& event);
    void onReply(const Header& head, const proto::Reply& reply);
    void onStatusMsg(const Header& head, const proto::EntityStatus& status);
    void onService(const std::string& entity, const proto::Service& service);
    void advanceCheckOut(const Id128& id);
    void failCheckOut(Id128 id, Refusal why);
    void sendCheckOut(const Id128& id, CheckOutParty& party, int phase);
    void sendRelease(const Held& held);
    void grant(const std::string& entity, const proto::CheckOutReply& reply);
    /// The entity by value: callers name it by its key in leases_, which goes away here.
    void endLease(std::string entity, const Refusal& why, bool tell);
    /// Until it is final, or the time is up and it becomes Unknown.
    void awaitTask(const Id128& id, const TaskRecord& record);
    void finishTask(const Id128& id, TaskState state, const Refusal& why);
    void settleControls(const Id128& id, const TaskReport& report);
    void noteFinal(const Id128& id);
    /// A refusal that says that the lease is no longer ours.
    void noteRefusal(const std::string& entity, LeaseNumber under, const Refusal& refusal);
    void sendWatches(const std::string& entity);
    /// Whether the entity is held and moves; after each change of its state or its lease.
    void countMoving(const std::string& entity);
    void pace();

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
    int announced_ = 0;
    Watchdog server_;
    std::int64_t sequence_ = 0;
    std::int64_t beat_ = 0;
    TimePoint next_heartbeat_ = TimePoint::max();
    std::uint64_t malformed_ = 0;

    NameIndex names_;
    std::unordered_map<std::string, KnownEntity> entities_;
    std::map<std::string, Lease> leases_;
    std::set<std::string> moving_, busy_;  // held, and BUSY or driven otherwise; held and BUSY
    std::unordered_map<Id128, TaskRecord> tasks_;
    std::size_t running_tasks_ = 0;
    std::deque<Id128> finished_tasks_;
    std::map<Id128, CheckOutOrder> check_outs_;
    std::unordered_map<Id128, Held> transfers_;
    Pendings pending_;
    std::set<std::pair<TimePoint, std::pair<Ask, Id128>>> deadlines_;  // of pending_ and check_outs_
    std::map<std::string, std::map<std::string, int>> watches_;  // entity → stream → how many; "" = all
};

}  // namespace axon::client
