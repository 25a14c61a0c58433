// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "axon/global.hpp"
#include "axon/result.hpp"
#include "axon/types.hpp"

/// The client library: an operator's program links it to use robots.
///
/// The library logs to the spdlog logger "axon" if the program has registered one before it makes its first
/// Client. Otherwise it logs warnings and errors to standard error. It writes nothing to standard output.
namespace axon::client {

struct Options {
    /// HOST:PORT of a front-end server, or a Glacier2 router: Axon.Clients/router:tcp -h HOST -p PORT.
    std::string server = "127.0.0.1:10410";
    std::string user, password;
    std::map<std::string, std::string> properties;  ///< Ice.* and IceSSL.* properties, for both lanes
    std::string display_name;                       ///< empty = user@host
    /// How long a request waits for its answer before it is refused with TIMED_OUT. Never infinite.
    Seconds timeout{5};
    bool reconnect = true;
    /// If true, a lost connection does not end the leases at once: each Entity Manager keeps its lease for a
    /// grace (5 s unless it is configured otherwise), and the library resumes it if it reconnects in time.
    /// If false, the leases end with the connection.
    bool resume = true;
    /// If true, connect() returns when this client knows every entity of the server, or after `timeout`.
    /// If false, connect() returns as soon as both lanes are connected; a program that only stops everything
    /// needs no more than that.
    bool await_entities = true;
    /// If true, the library talks straight to the Entity Managers of the entities that it holds, where they
    /// offer that and can be reached. If false, every message goes through the servers. Lease, refusals and
    /// order of messages are the same either way. If the server is reached over TLS, so are they; if through
    /// a router, every message goes through the servers (docs/reference/direct.md).
    bool direct = true;
    /// At most this many direct paths. The other entities are reached through the servers. A direct path
    /// costs two connections at each end.
    int direct_paths = 64;
    /// The longest time, up to 250 µs, for which the thread that reads direct paths looks for the next
    /// message before it sleeps. 0 = none. It does so while messages come in quick succession, and not on a
    /// machine with one core (docs/reference/direct.md, "Spinning").
    std::chrono::microseconds direct_spin{0};
    /// If set, the library calls it before each heartbeat while a task runs, on its heartbeat thread. Return
    /// false to suppress the heartbeat: a program whose socket is alive can still have lost its operator.
    std::function<bool()> keep_running;
};

/// Returns `options` with the settings of a configuration file applied (docs/reference/settings_files.md).
/// The keys are Axon.Server or Ice.Default.Router, Axon.User, Axon.Password, and any property Ice.* or
/// IceSSL.* (docs/reference/routers.md). Refused with MALFORMED if the file cannot be read or understood, and
/// with PERMISSION_DENIED if it holds a password and others may read it. The message says how to fix it.
Result<Options> readConfiguration(const std::filesystem::path& file, Options options = {});

class Client;

/// A task that this client has asked for.
///
/// Copies refer to the same task. Destroying the last copy does not cancel it. A task object may outlive its
/// client; its state is then Unknown. Threads: any.
class Task {
  public:
    const std::string& id() const;
    TaskReport report() const;
    /// Blocks until the state is final and the callbacks of onUpdate() have been called with it, or until
    /// `time` has passed. Returns the newest report in both cases. Do not hold a lock that a callback takes.
    TaskReport wait(std::optional<Seconds> time = std::nullopt) const;
    /// The callback is called immediately with the current report, then on every change. It runs as
    /// all callbacks do (see Client).
    void onUpdate(std::function<void(const TaskReport&)> callback) const;
    Result<void> pause() const;
    Result<void> resume() const;
    Result<void> cancel() const;

    struct Shared;

  private:
    friend class CheckOut;
    explicit Task(std::shared_ptr<Shared> shared) : shared_(std::move(shared)) {}
    std::shared_ptr<Shared> shared_;
};

/// A run of a global service. Its master reports on it.
///
/// Copies refer to the same run. Destroying the last copy does not cancel it. Threads and ownership are those
/// of a Task.
class Run {
  public:
    const std::string& id() const;
    RunReport report() const;
    /// Blocks until the state is final and the callbacks of onUpdate() have been called with it, or until
    /// `time` has passed. Returns the newest report in both cases. Do not hold a lock that a callback takes.
    RunReport wait(std::optional<Seconds> time = std::nullopt) const;
    /// The callback is called immediately with the current report, then on every change. It runs as
    /// all callbacks do (see Client).
    void onUpdate(std::function<void(const RunReport&)> callback) const;
    /// Pauses every running step. Refused with NOT_PAUSABLE if one of them cannot be paused.
    Result<void> pause() const;
    /// Continues a paused run. In a run that is held (RunState::Held), tries the failed steps again.
    Result<void> resume() const;
    Result<void> cancel() const;

    struct Shared;

  private:
    friend class Client;
    explicit Run(std::shared_ptr<Shared> shared) : shared_(std::move(shared)) {}
    std::shared_ptr<Shared> shared_;
};

/// An entity that this client holds.
///
/// Copies refer to the same lease. release() ends the lease for all of them, and so does the destruction of
/// the client. Destroying a CheckOut does not end the lease. Once the lease has ended, every call is refused
/// with NOT_HOLDER; onLost has given the reason.
///
/// States:
///   held      the client may use the entity.
///   orphaned  the connection was lost, the entity has left, or the servers or its Entity Manager had lost
///             this client for a moment. The robot stands still and is latched. Calls are refused with
///             NOT_CONNECTED. The lease waits for this client to come back.
///   gone      the lease has ended.
/// An orphaned lease becomes held again (onResumed; it is the same lease) or gone (onLost).
class CheckOut {
  public:
    Entity entity() const;
    std::vector<Service> services() const;
    Result<Service> service(std::string_view name_or_global_id) const;

    /// Sets a parameter of a service. The robot application grants or denies it; DENIED carries its reason.
    Result<void> set(std::string_view service, const Argument& argument) const;
    /// Sends a file in chunks. Blocks until the robot application has accepted the file and the Entity
    /// Manager has stored it, which has no time limit: a slow disk makes it slow.
    ///
    /// If the same user has begun to upload this file before, under this check-out or an earlier one, the
    /// upload goes on where it ended. progress(sent, total), in bytes, is called on the calling thread. A
    /// stop requested through `give_up` ends the upload with CANCELLED before its next chunk; a later call
    /// goes on from there.
    Result<void> upload(std::string_view service, std::string_view resource,
                        const std::filesystem::path& file,
                        std::function<void(std::uint64_t, std::uint64_t)> progress = {},
                        std::stop_token give_up = {}) const;
    /// Asks for a task. Does not wait: returns when the request is in the send queue. A refusal arrives as
    /// TaskState::Refused, with its reason in the report. A task that has not begun `not_after` after the
    /// Entity Manager received it is refused with EXPIRED; 0 = it may begin at any time.
    Task run(std::string_view service, const std::vector<Argument>& arguments = {},
             Seconds not_after = Seconds{0}) const;

    Result<void> sendText(std::string_view text) const;
    /// Refused with OVERLOADED if the send queue is full. With `wait`, first blocks up to that long for the
    /// send queue to drain. Use it for bulk sending.
    Result<void> sendRaw(std::string_view bytes, Seconds wait = Seconds{0}) const;
    void onText(std::function<void(const std::string&)> callback) const;
    void onRaw(std::function<void(const std::string&)> callback) const;
    void onServiceChanged(std::function<void(const Service&)> callback) const;
    void onLost(std::function<void(const Refusal&)> callback) const;
    /// Called with the reason when the lease is orphaned. onResumed or onLost follows.
    void onOrphaned(std::function<void(const std::string& reason)> callback) const;
    /// Called when the lease is valid again. The library has then asked about the
    /// tasks: a task that ended meanwhile is reported as it ended, or as Unknown if nobody knows how.
    void onResumed(std::function<void()> callback) const;
    bool orphaned() const;
    /// True while messages go straight to the Entity Manager and come straight from it (Options::direct),
    /// false while they go through the servers. It can change at any moment. Nothing else changes with it.
    bool direct() const;

    /// Called when somebody asks for this entity, and when they have withdrawn. A request that is already
    /// open is reported at once. If nobody answers it, the hand-over policy decides.
    void onHandOverRequest(std::function<void(const HandOverRequest&)> callback) const;
    std::optional<HandOverRequest> handOverRequest() const;
    /// Answers the open request; refused with WRONG_STATE if there is none. Accepting stops the robot, then
    /// ends the lease (onLost).
    Result<void> answerHandOver(bool accept, std::string_view reason = {}) const;
    Result<void> setHandOverPolicy(const HandOverPolicy& policy) const;
    /// Returns what Client::resume needs to take this lease over in another process. Whoever has the ticket
    /// has the lease: keep it like a password.
    std::string ticket() const;

    /// Stops the running task and goes on with the next one of the queue. Does not latch. (The reset command
    /// of the thesis.)
    ///
    /// Blocks until the receipt arrives, as clear() does: call neither in a callback. The
    /// receipt says how many tasks have ended, which can be none. Refused with WRONG_STATE if the entity
    /// takes part in a collaboration and runs no step.
    Result<Receipt> reset() const;
    /// Stops the running task, empties the queue and leaves a collaboration. Does not latch. (The clear
    /// command of the thesis.)
    Result<Receipt> clear() const;
    Result<void> release() const;

    struct Shared;

  private:
    friend class Client;
    explicit CheckOut(std::shared_ptr<Shared> shared) : shared_(std::move(shared)) {}
    std::shared_ptr<Shared> shared_;
};

/// A connection to an Axon server, with its own signal lane, heartbeats and reconnection.
///
/// Where in the flow: the first station (ARCHITECTURE.md, section 1).
///
/// States:
///   connected  requests are sent.
///   lost       the library reconnects with back-off. Calls are refused with NOT_CONNECTED, and the leases
///   are
///              orphaned.
///   closed     final.
///
/// Threads: any thread may call every member. Callbacks run one at a time, in order, on threads of the
/// library; two callbacks may run on different threads. While one does not return, later ones wait, and
/// messages, heartbeats and stops go on. A callback may call everything except a function that waits
/// (Task::wait, checkOut, …).
///
/// Ownership: close() and the destructor release the entities that the client holds and wait for the answers.
///
/// Failure: refusals come as a Result. Two exceptions are thrown: std::logic_error for misuse, and
/// std::bad_alloc. A std::bad_alloc while a message is being sent ends the program.
class Client {
  public:
    /// Logs in. Refused with UNAVAILABLE, PERMISSION_DENIED, … if there is no session within the timeout; the
    /// message says how to fix it.
    static Result<std::unique_ptr<Client>> connect(Options options);
    ~Client();
    Client(const Client&) = delete;
    Client& operator=(const Client&) = delete;

    bool connected() const;
    Sender self() const;
    std::string server() const;

    std::vector<Entity> entities(Listed listed = Listed::Ready) const;
    /// Finds an entity by its name, by "Name#2" (the second one of that name, in order of UUID), by its UUID,
    /// or by a unique beginning of the UUID (at least 4 characters). Entities that are not ready are
    /// considered only if no ready one matches. AMBIGUOUS_ENTITY names the candidates, UNKNOWN_ENTITY the
    /// nearest names.
    Result<Entity> find(std::string_view name) const;
    /// Blocks until such an entity is there and ready (and not UNAV, INIT, ENVCONN or ERR), or until `time`
    /// has passed.
    Result<Entity> waitFor(std::string_view name, Seconds time) const;
    /// Called for entities that are ready. One that becomes ready is reported as joined. While many statuses
    /// change, those of entities that this client does not hold come about 0.1 s later, and what lasted less
    /// may be missing (ADR 0048).
    void onEntity(std::function<void(Presence, const Entity&)> callback);
    void onConnection(std::function<void(bool connected, const std::string& reason)> callback);

    /// Checks out all of the named entities, or none of them. Blocks as `options` says. ALREADY_HELD names
    /// the holder. TIMED_OUT means that the time to wait has passed, CANCELLED that `give_up` has ended the
    /// wait.
    Result<std::vector<CheckOut>> checkOut(const std::vector<std::string>& names,
                                           const CheckOutOptions& options = {});
    Result<CheckOut> checkOut(std::string_view name, const CheckOutOptions& options = {});
    /// Checks out entities that match a query, chosen among those that are free and ready. Examples: "2
    /// ROBOT/MOBILE + 1 ROBOT/STATIONARY", "ROBOT with Driving". A refusal says what is missing and which
    /// entities lack it.
    Result<std::vector<CheckOut>> checkOutQuery(std::string_view query, const CheckOutOptions& options = {});
    /// Takes over the lease whose CheckOut::ticket() came from another process, or from an earlier run of
    /// this one. Only possible within the grace of the lease. If the other process is still alive, the robot
    /// is stopped.
    Result<CheckOut> resume(std::string_view ticket);
    /// The entities that this client holds now.
    std::vector<CheckOut> held() const;

    /// Stops entities, whoever holds them. An empty `names` stops every entity.
    ///
    /// Blocks until all receipts have arrived, at most for `deadline`. If all are confirmed by then, goes on
    /// waiting until the robots that were moving stand still, at most until `standstill` after the call; only
    /// robots whose applications report standstill are waited for.
    Result<std::vector<Receipt>> stop(const std::vector<std::string>& names, Seconds deadline = Seconds{1},
                                      Seconds standstill = Seconds{0});
    /// Measures how long a stop takes, without stopping anything. The Entity Interfacer acknowledges without
    /// calling the application; nothing latches and no task ends. An empty `names` measures every entity.
    ///
    /// Makes `count` tries, one every `period`. A try that has no answer after 1 s counts as never arrived.
    Result<std::vector<DrillReport>> drill(const std::vector<std::string>& names, int count = 1,
                                           Seconds period = Seconds{0.1}, std::stop_token give_up = {});
    Result<void> rearm(std::string_view name);
    /// Services and parameters of an entity, whoever holds it.
    Result<std::vector<Service>> services(std::string_view name) const;
    /// The same, with its findings and how close its watchdogs came to tripping.
    Result<Details> details(std::string_view name) const;

    /// The global services that the front-end server offers, and what it found in their files.
    Result<GlobalServices> globalServices() const;
    /// Finds out which entity could play which role. Asks every entity that is present for its services.
    /// `chosen` fixes some of the roles; a name in it that matches no entity, or several, refuses the call.
    /// All other obstacles are listed in the proposal.
    Result<Proposal> propose(const GlobalService& service, const Bindings& chosen = {}) const;
    /// Asks `master` to carry the service out. Any participant can be the master; it makes no difference
    /// which.
    ///
    /// Every role needs a different entity that this client holds (NOT_HOLDER). All their leases must come
    /// from one session, or be resumed from leases of one session (WRONG_STATE). Objections of the
    /// participants arrive as RunState::Refused with all problems; nothing has moved then.
    Result<Run> runGlobal(const GlobalService& service, const Bindings& bindings, std::string_view master);
    /// Checks whether runGlobal() would be possible. Nothing moves. The run ends as Succeeded if it would be,
    /// and as Refused with the problems if not.
    Result<Run> checkGlobal(const GlobalService& service, const Bindings& bindings, std::string_view master);
    /// The past runs whose master was one of these entities; an empty `names` asks every entity. At most
    /// `most` runs of each; 0 = all that it keeps.
    Result<RunHistory> runHistory(const std::vector<std::string>& names = {}, int most = 0) const;

    /// Subscribes to streams of an entity, whoever holds it. An empty `streams` subscribes to all of them.
    /// The callback runs as all callbacks do (see Client). Destroying the handle ends the subscription.
    Result<std::shared_ptr<void>> watch(std::string_view name, const std::vector<std::string>& streams,
                                        std::function<void(const Sample&)> callback);
    void close();

    class Session;

  private:
    using Granted = Result<std::vector<std::shared_ptr<CheckOut::Shared>>>;
    explicit Client(std::shared_ptr<Session> session);
    static Result<std::vector<CheckOut>> handlesOf(Granted granted);
    Result<Run> beginRun(const GlobalService& service, const Bindings& bindings, std::string_view master,
                         bool check_only);
    std::shared_ptr<Session> session_;
};

}  // namespace axon::client
