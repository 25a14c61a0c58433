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
#include <variant>
#include <vector>

#include "collaboration/bindings.hpp"
#include "common/refusal.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

/// The client library: what an operator's program links to use robots (architecture, section 10).
/// Its log goes to the spdlog logger "axon" when the program has registered one before its first Client, else
/// to standard error (warnings and worse). It writes nothing to standard output.
namespace axon::client {

using Seconds = std::chrono::duration<double>;

/// One value of a parameter. An int64 is accepted where a double is asked for.
using Value = std::variant<std::int64_t, double, std::string, bool>;
std::string toText(const Value& value);

/// A parameter given to a task or set on a service: more than one value only for a "multiple" parameter.
/// With `from_text` the values are strings that are read by the parameter's declared type (a command line).
struct Argument {
    std::string name;
    std::vector<Value> values;
    std::string units;  ///< optional; refused with WRONG_UNITS when it is not the profile's
    bool from_text = false;
};

struct Parameter {
    std::string name, type, data_type, units,
        descr;  ///< type INPUT, OUTPUT, CONFIG, FEEDBACK; data_type INT, DBL, STR, BOOL
    bool ready = false, required = false, savable = false, multiple = false;
    std::vector<Value> values, choices;
    std::optional<double> minimum, maximum;
};

struct Resource {
    std::string name, descr;
    bool ready = false, required = false, savable = false;
    std::uint64_t size = 0;  ///< bytes
};

struct Service {
    std::string name, global_id, type, descr, notes;  ///< type SMPL or CMPLX
    bool active = true, executing = false, blocking = true, pausable = false;
    std::string inactive_reason;  ///< why it is switched off, where the robot application has said it
    std::vector<Parameter> parameters;
    std::vector<Resource> resources;
    std::vector<std::string> missing;  ///< what must be set or uploaded before it can run
    std::vector<std::string> parts;    ///< of a CMPLX one, in order, by name or global id
};

/// What everybody may see of an entity.
struct Entity {
    std::string id;  ///< UUID
    /// False until its robot application has uploaded valid profiles to its Entity Manager: then `name` is
    /// that of the application, `category`, `type` and `descr` are empty, and `reason` says what is missing.
    bool ready = true;
    std::string name, category, type, descr;
    double x_mm = 0, y_mm = 0, z_mm = 0;
    EntityState state = EntityState::UNAV;
    bool latched = false;
    std::int32_t stop_generation = 0;
    Sender holder;  ///< id empty when free
    std::string reason;                   ///< of UNAV, INIT and ERR; in IDLE from whom it was taken, and why
    bool orphaned = false;                ///< the holder is lost, and may still come back
    int waiting = 0;                      ///< how many wait for it
    std::optional<Seconds> stop_latency;  ///< of the servers' own last drill: to the application and back
};

/// Which entities a list has: those that are ready, or also those that are not (Entity::ready).
enum class Listed : std::uint8_t { Ready, All };

/// How near a dead-man came to its end.
struct WatchdogMargin {
    std::string hop;         ///< who watches whom
    Seconds timeout{0};      ///< the robot is stopped after so long a silence
    Seconds longest_gap{0};  ///< the longest silence of the last minute
};

/// What is not as an entity's profiles or its users mean it to be, for people.
struct EntityFinding {
    std::string message, fix;  ///< what is the matter, and what to do about it
};

/// What an entity tells of itself when it is asked.
struct Details {
    std::vector<Service> services;
    std::vector<WatchdogMargin> watchdogs;
    std::vector<EntityFinding> findings;
};

enum class TaskState : std::uint8_t {
    Queued = 1,
    Dispatched,
    Running,
    Paused,
    Succeeded,
    Failed,
    Stopped,
    Cancelled,
    Refused,
    Unknown
};
inline bool isFinal(TaskState state) {
    return state >= TaskState::Succeeded;
}
const char* toString(TaskState state);

struct TaskReport {
    std::string id;  ///< UUID text of the task
    std::string entity, service;
    TaskState state = TaskState::Queued;
    double progress = -1;  ///< 0 to 1; negative = not known
    std::string feedback;
    std::map<std::string, std::vector<Value>> results;
    Refusal reason;         ///< why it failed, was stopped, refused …
    bool accepted = false;  ///< the Entity Manager has taken it: it waits there for its turn, or has begun
};

// Global services: what several entities do together (docs/reference/profiles.md).

/// An input of a step that an earlier one gives as its output.
struct ParameterSource {
    std::string parameter, step, output;
};

struct GlobalStep {
    int role = 0;                ///< which participant
    std::string category, type;  ///< of who may play the role: ROBOT or MACHINE, MOBILE or STATIONARY
    std::string service_global_id;
    int preced = 0;                    ///< equal numbers run at the same time
    std::string name;                  ///< what later steps call it; empty = nothing
    std::vector<Argument> parameters;  ///< as texts: only the entity knows their types
    std::vector<ParameterSource> sources;
};

/// What happens to the others when a step fails. A stop stops all of them in any case.
enum class OnFailure : std::uint8_t {
    StopAll,
    HoldOthers,  ///< steps that can be paused are, the others are stopped; then the operator decides
    Compensate,  ///< all are stopped, then the steps of the compensation run
};
const char* toString(OnFailure on_failure);

struct GlobalService {
    std::string name, descr;
    std::string file;  ///< of the server, without its folder
    OnFailure on_failure = OnFailure::StopAll;
    std::vector<GlobalStep> steps, compensation;
};

/// One file of the server's folder. What has errors offers no services.
struct GlobalFile {
    std::string name;
    std::vector<std::string> findings;  ///< "file:line: severity: element: what was expected: how to mend it"
    bool bad = false;                   ///< there is an error among them
};

struct GlobalServices {
    std::vector<GlobalService> services;
    std::vector<GlobalFile> files;
};

/// Role → entity: a name as Client::find takes it.
using Bindings = std::map<int, std::string>;

enum class RunState : std::uint8_t {
    Checking = 1,  ///< the participants are asked whether they can and may
    Running,
    Paused,
    Held,      ///< a step failed, the others were held: resume tries it again, cancel ends the run
    Stopping,  ///< a step failed: everybody is being stopped
    Compensating,
    Succeeded,  ///< the states from here on are final; of a check: it would be possible
    Failed,
    Stopped,
    Cancelled,
    Refused,  ///< nothing has moved
    Unknown   ///< the master was lost while it ran
};
inline bool isFinal(RunState state) {
    return state >= RunState::Succeeded;
}
const char* toString(RunState state);

/// How far a step is.
struct StepReport {
    int step = 0;              ///< position in the service from 0; those of the compensation after the steps
    bool compensation = false;
    std::string called;        ///< its name in the service; empty = none
    std::string entity, name;  ///< UUID, name
    std::string service;       ///< global id
    int preced = 0;
    std::optional<TaskState> state;  ///< none: its turn has not come
    double progress = -1;            ///< 0 to 1; negative = not known
    std::string feedback;
    std::map<std::string, std::vector<Value>> parameters, results;
    Refusal reason;
    std::optional<Seconds> began, ended;  ///< since the launch
    int tries = 1;                        ///< above 1: after a hold it was tried again
};

/// Why a run is not possible.
struct RunProblem {
    int step = -1;       ///< as in StepReport; -1 = no single one
    std::string entity;  ///< name
    Refusal refusal;
};

struct RunReport {
    std::string id;       ///< UUID text of the run
    std::string service;  ///< name of the global service
    std::string master;   ///< UUID
    bool check = false;   ///< only whether it would be possible
    RunState state = RunState::Checking;
    double progress = 0;  ///< of the whole, 0 to 1
    Seconds elapsed{0};   ///< since the launch, by the master's clock
    std::vector<StepReport> steps;  ///< in order of their positions
    std::vector<RunProblem> problems;
    Refusal reason;  ///< why it failed, was stopped, refused …
};

/// Who played a role.
struct Participant {
    int role = 0;
    std::string entity, name;  ///< UUID, name
};

/// What became of a run; kept by its master.
struct RunRecord {
    std::string id;
    GlobalService service;
    std::string by;      ///< the client
    std::string master;  ///< UUID
    std::vector<Participant> participants;
    std::chrono::system_clock::time_point asked_at;  ///< by the client's clock
    Seconds duration{0};
    RunState state = RunState::Unknown;
    Refusal reason;
    std::vector<StepReport> steps;
};

struct RunHistory {
    std::vector<RunRecord> runs;  ///< newest first
    /// Entities that were asked and have not answered: names, and why.
    std::vector<std::pair<std::string, Refusal>> silent;
};

/// What became of a stop, stage by stage (architecture, section 7.4). Times since the call, on the client's
/// clock; a stage that has not answered within the deadline has no time.
struct Receipt {
    std::string entity, name;
    std::int32_t stop_generation = 0;
    EntityState state = EntityState::UNAV;
    std::optional<Seconds> server, manager, callback_returned, standstill;
    bool no_application =
        false;  ///< no robot application is linked, and none is missing: there was nothing to stop
    /// Why nobody can tell that the robot was stopped: its application was linked and fell silent, or its
    /// connection was closed without a good-bye. Empty = it is not so. An application that comes back within
    /// the deadline is given the stop, and confirms it.
    std::string application_lost;
    std::optional<Seconds> application_lost_for;  ///< at the time of the receipt
    std::string fault;  ///< the application's stop callback threw this; it is called again until it returns
    Seconds precision{0};  ///< of the times: the step of a laboratory's time (AXON_CLOCK), in which nothing
                           ///< shorter can be told
    /// The robot was moving, and its application reports when it stands still.
    bool standstill_follows = false;
    int tasks_ended = 0;    ///< of CheckOut::reset() and clear(): the running ones
    int tasks_removed = 0;  ///< of CheckOut::clear(): those that waited
    /// The EM and, where there is an application, its stop callback have answered.
    bool confirmed() const { return manager && (callback_returned || no_application); }
    /// Nothing more is expected of this robot.
    bool atRest() const { return confirmed() && (standstill || !standstill_follows); }
};

/// What a drill measured of one entity: one entry for each try, in order; no time = it never arrived.
struct DrillReport {
    std::string entity, name;
    std::vector<std::optional<Seconds>> manager;  ///< the Entity Manager's answer, back at this client
    std::vector<std::optional<Seconds>>
        callback;                 ///< the Entity Interfacer's, where its stop callback begins
    bool no_application = false;  ///< in the last try there was no robot application to answer
};

/// What becomes of the wishes of others for an entity that this client holds.
struct HandOverPolicy {
    Seconds answer_within{30};  ///< at most 600
    bool yield = false;         ///< silence hands over; otherwise it refuses
    bool refuse = false;        ///< nobody is asked: the library refuses at once, in this client's name
};

/// Somebody asks for an entity that this client holds.
struct HandOverRequest {
    std::string by, reason;
    Seconds answer_within{0};  ///< from when it is told, or asked for by CheckOut::handOverRequest()
    bool yield = false;      ///< what silence means
    bool withdrawn = false;  ///< who asked has gone, or the time was up: nothing is left to answer
};

/// How a check-out that cannot be had at once is coming along.
struct Waiting {
    std::string entity;   ///< UUID; empty where several are waited for
    int place = 0;        ///< in the Entity Manager's wait list, 1 = next; 0 where there is none
    std::string message;  ///< for people
};

/// How to check out. As it is: now or not at all.
struct CheckOutOptions {
    /// Wait so long for what is held by others; without a value do not wait. One entity: in the Entity
    /// Manager's wait list, first come, first served. Several, or a query: until all are free at once. With
    /// `ask`: for the holder's answer, and in the list when that is no.
    std::optional<Seconds> wait;
    /// Each change while it waits. On the library's callback thread.
    std::function<void(const Waiting&)> on_waiting;
    /// Ask the holder to hand it over (one entity, by name). Ends with the grant or HAND_OVER_REFUSED.
    bool ask = false;
    /// Take what is held from its holder: admins only. The robot is stopped first, and the holder told.
    bool force = false;
    std::string reason;        ///< for the holder, with `ask` and `force`
    HandOverPolicy hand_over;  ///< of the lease that this makes
    std::stop_token give_up;   ///< ends the wait with CANCELLED
};

/// One sample of a stream. `json` is the sample's content as JSON text; `raw` the serialized
/// axon.proto.StreamSample.
struct Sample {
    std::string entity, stream;
    std::uint64_t sequence = 0;
    std::string json, raw;
};

struct Options {
    /// HOST:PORT of a front-end server; or a Glacier2 router, as Axon.Clients/router:tcp -h HOST -p PORT.
    std::string server = "127.0.0.1:10410";
    std::string user, password;
    std::map<std::string, std::string> properties;  ///< of Ice (Ice.*, IceSSL.*), for both connections
    std::string display_name;  ///< empty = user@host
    Seconds timeout{5};        ///< of every request that waits for an answer; never infinite
    bool reconnect = true;
    /// After a lost connection the leases are kept for the time that their Entity Managers grant (5 s unless
    /// they are set otherwise) and resumed when this client is back in time. false = they are lost with it.
    bool resume = true;
    /// connect() returns when this client has been told of every entity there is, or the timeout has passed;
    /// false = as soon as both lanes stand, which is all that a stop of everything needs.
    bool await_entities = true;
    /// Talk to the Entity Managers of what is held without the servers in between, where they offer it and can be reached;
    /// false = by the servers only. Lease, refusals and order are the same either way. Where the server is called by TLS or
    /// through a router nothing but the servers' way is taken (docs/reference/direct.md).
    bool direct = true;
    /// At most so many of them; what is held beyond is reached by the servers. Each costs two connections, here and there.
    int direct_paths = 64;
    /// When set, it is asked before each heartbeat while a task runs; false = do not send it (a live socket
    /// is not a live operator). Called on the library's heartbeat thread.
    std::function<bool()> keep_running;
};

/// The options with what a file of lines KEY=VALUE says: Ice.Default.Router or Axon.Server, Axon.User,
/// Axon.Password, and properties Ice.* and IceSSL.* (docs/reference/routers.md). MALFORMED or
/// PERMISSION_DENIED with the mend.
Result<Options> readConfiguration(const std::filesystem::path& file, Options options = {});

class Client;

/// A task that was asked for. Copies refer to the same task. Dropping the last copy does not cancel it.
/// Threads: any. Ownership: valid as long as it is held; after the client is gone its state is Unknown.
class Task {
  public:
    const std::string& id() const;
    TaskReport report() const;
    /// Until it is final, or the time is up; the newest report either way.
    TaskReport wait(std::optional<Seconds> time = std::nullopt) const;
    /// Each change from now on, and the present state at once. On the library's callback thread.
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

/// A run of a global service, told of by its master. Copies refer to the same run. Dropping the last copy does
/// not cancel it. Threads and ownership: as of a Task.
class Run {
  public:
    const std::string& id() const;
    RunReport report() const;
    /// Until it is final, or the time is up; the newest report either way.
    RunReport wait(std::optional<Seconds> time = std::nullopt) const;
    /// Each change from now on, and the present state at once. On the library's callback thread.
    void onUpdate(std::function<void(const RunReport&)> callback) const;
    /// Of everything that runs in it. NOT_PAUSABLE where a running step is not.
    Result<void> pause() const;
    /// A run that is held tries its failed steps again.
    Result<void> resume() const;
    Result<void> cancel() const;

    struct Shared;

  private:
    friend class Client;
    explicit Run(std::shared_ptr<Shared> shared) : shared_(std::move(shared)) {}
    std::shared_ptr<Shared> shared_;
};

/// An entity that this client holds. Copies refer to the same lease; release() ends it for all of them. The
/// lease also ends when the client is destroyed; it does not end when a CheckOut is dropped. Every call is
/// refused with NOT_HOLDER once the lease is gone, and onLost has said why.
///
/// States: held; orphaned (the connection was lost, or the entity has left: the robot stands still and is
/// latched, calls answer NOT_CONNECTED, the lease waits for this client to come back); gone. From orphaned it
/// goes back to held (onResumed, the same lease) or is gone (onLost).
class CheckOut {
  public:
    Entity entity() const;
    std::vector<Service> services() const;
    Result<Service> service(std::string_view name_or_global_id) const;

    /// Granted or denied by the robot application; DENIED carries its reason.
    Result<void> set(std::string_view service, const Argument& argument) const;
    /// Sends a file in chunks, resuming where an earlier try of the same user ended, under this check-out or
    /// an earlier one. progress(sent, total) on the calling thread. A stop asked for through `give_up` ends
    /// it with CANCELLED before its next chunk; the same upload goes on from there. Returns when the robot
    /// application has accepted the file and it is in its place; behind a slow disk that takes as long as it
    /// takes.
    Result<void> upload(std::string_view service, std::string_view resource,
                        const std::filesystem::path& file,
                        std::function<void(std::uint64_t, std::uint64_t)> progress = {},
                        std::stop_token give_up = {}) const;
    /// Does not wait: returns when the request has been taken to be sent; refusals arrive as TaskState::Refused with their reason.
    Task run(std::string_view service, const std::vector<Argument>& arguments = {},
             Seconds not_after = Seconds{0}) const;

    Result<void> sendText(std::string_view text) const;
    /// OVERLOADED when more waits for the server than may. With `wait` it waits before it sends, at most so
    /// long, until little waits: for who sends much and does not want to be refused.
    Result<void> sendRaw(std::string_view bytes, Seconds wait = Seconds{0}) const;
    void onText(std::function<void(const std::string&)> callback) const;
    void onRaw(std::function<void(const std::string&)> callback) const;
    void onServiceChanged(std::function<void(const Service&)> callback) const;
    void onLost(std::function<void(const Refusal&)> callback) const;
    /// The connection is lost, or the entity has left, for this reason; onResumed or onLost follows.
    void onOrphaned(std::function<void(const std::string& reason)> callback) const;
    /// The lease is valid again after a lost connection. Tasks have been asked after: those that ended
    /// meanwhile are told as they ended, and are Unknown only where nobody knows.
    void onResumed(std::function<void()> callback) const;
    bool orphaned() const;
    /// Messages go straight to the Entity Manager and come from there (Options::direct); otherwise by the servers. It may
    /// change at any moment, and changes nothing else.
    bool direct() const;

    /// Somebody asks for this entity, or has withdrawn. An open request is told at once. Without an answer
    /// the policy decides.
    void onHandOverRequest(std::function<void(const HandOverRequest&)> callback) const;
    std::optional<HandOverRequest> handOverRequest() const;
    /// WRONG_STATE when nobody asks. Accepting stops the robot; then the lease ends (onLost).
    Result<void> answerHandOver(bool accept, std::string_view reason = {}) const;
    Result<void> setHandOverPolicy(const HandOverPolicy& policy) const;
    /// What Client::resume needs to take this lease over in another process. Whoever has it has the lease:
    /// keep it like a password.
    std::string ticket() const;

    /// Stops the running task and goes on with the next of the queue; does not latch (thesis: reset command).
    /// Like clear() it waits for the receipt, so neither may be called on the library's callback thread. The receipt says how many tasks that ended, which may be none. WRONG_STATE where it takes part in a
    /// collaboration and runs no step.
    Result<Receipt> reset() const;
    /// Stops the running task, empties the queue and leaves a collaboration; does not latch (thesis: clear
    /// command).
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
/// Where in the flow: the first station (architecture, section 3).
/// States: connected; lost (reconnecting with backoff, calls answer NOT_CONNECTED, leases are orphaned);
/// closed.
/// Threads: every member may be called from any thread. Callbacks run on one thread of the library, in order;
/// they may call anything except what waits (Task::wait, checkOut, …). Ownership: closing or destroying it
/// releases what it holds, in an orderly way. Failure: refusals as Result; nothing throws but misuse
/// (std::logic_error) and the bad_alloc of the system.
class Client {
  public:
    /// UNAVAILABLE, PERMISSION_DENIED, … with the mend in the message when there is no session within the
    /// timeout.
    static Result<std::unique_ptr<Client>> connect(Options options);
    ~Client();
    Client(const Client&) = delete;
    Client& operator=(const Client&) = delete;

    bool connected() const;
    Sender self() const;
    std::string server() const;

    std::vector<Entity> entities(Listed listed = Listed::Ready) const;
    /// By name, "Name#2" (the second of that name in order of UUID), UUID or unique beginning of one (at
    /// least 4 characters). AMBIGUOUS_ENTITY names the candidates, UNKNOWN_ENTITY the nearest names. One that
    /// is not ready is found where no ready one is meant.
    Result<Entity> find(std::string_view name) const;
    /// Waits until such an entity is there and ready (and not UNAV, INIT, ENVCONN or ERR), or the time is up.
    Result<Entity> waitFor(std::string_view name, Seconds time) const;
    /// Of entities that are ready; one that becomes so joins.
    void onEntity(std::function<void(Presence, const Entity&)> callback);
    void onConnection(std::function<void(bool connected, const std::string& reason)> callback);

    /// All of them or none (reserve, then commit or abort). ALREADY_HELD names the holder. TIMED_OUT when the
    /// time to wait is up, CANCELLED when it was given up.
    Result<std::vector<CheckOut>> checkOut(const std::vector<std::string>& names,
                                           const CheckOutOptions& options = {});
    Result<CheckOut> checkOut(std::string_view name, const CheckOutOptions& options = {});
    /// What the query says, chosen among those that are free and ready: "2 ROBOT/MOBILE + 1
    /// ROBOT/STATIONARY", "ROBOT with Driving". The refusal says what is missing, and of whom.
    Result<std::vector<CheckOut>> checkOutQuery(std::string_view query, const CheckOutOptions& options = {});
    /// The lease of a CheckOut::ticket() of another process (or of this one before it was restarted), within
    /// its grace. The robot is stopped if the other one still lives.
    Result<CheckOut> resume(std::string_view ticket);
    /// What this client holds now.
    std::vector<CheckOut> held() const;

    /// Stops entities, held or not; none named = every entity there is. Waits for the receipts up to the
    /// deadline, and, once all are confirmed, up to `standstill` after the call for those of robots that were
    /// moving and whose applications report when they stand still.
    Result<std::vector<Receipt>> stop(const std::vector<std::string>& names, Seconds deadline = Seconds{1},
                                      Seconds standstill = Seconds{0});
    /// Measures the way of a stop without stopping anything: the Entity Interfacer acknowledges without
    /// calling the application, nothing latches and no task ends. `count` tries, one each `period` (each may
    /// take a second, then it counts as never arrived). None named = every entity there is.
    Result<std::vector<DrillReport>> drill(const std::vector<std::string>& names, int count = 1,
                                           Seconds period = Seconds{0.1}, std::stop_token give_up = {});
    Result<void> rearm(std::string_view name);
    /// Services and parameters of any entity, held or not.
    Result<std::vector<Service>> services(std::string_view name) const;
    /// Likewise, and how near its dead-men came to their end.
    Result<Details> details(std::string_view name) const;

    /// The global services that the front-end server offers, and what it found in their files.
    Result<GlobalServices> globalServices() const;
    /// Who could play which role: everybody who is there is asked for their services. A name of `chosen` that
    /// means nobody, or several, refuses the whole; what else is in the way stands in the proposal.
    Result<collaboration::Proposal> propose(const GlobalService& service, const Bindings& chosen = {}) const;
    /// Asks `master`, one of the participants, to carry the service out; it makes no difference which. Every
    /// role needs an entity of its own that this client holds (NOT_HOLDER), all under leases of one root
    /// (check-outs of one session, or resumed from one: WRONG_STATE otherwise). What the participants have
    /// against it comes as RunState::Refused, with all the problems; nothing has moved then.
    Result<Run> runGlobal(const GlobalService& service, const Bindings& bindings, std::string_view master);
    /// Likewise, but nothing moves: Succeeded when it would be possible, else Refused with the problems.
    Result<Run> checkGlobal(const GlobalService& service, const Bindings& bindings, std::string_view master);
    /// The runs that these entities, or all that are there, were the master of; `most` of each, 0 = all that
    /// it keeps.
    Result<RunHistory> runHistory(const std::vector<std::string>& names = {}, int most = 0) const;

    /// Samples of an entity's streams, held or not; no stream named = all. The handle ends the watch when
    /// dropped.
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
