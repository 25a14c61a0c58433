// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
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

/// The client library: what an operator's program links to use robots.
/// Its log goes to the spdlog logger "axon" when the program has registered one before its first Client, else
/// to standard error (warnings and worse). It writes nothing to standard output.
namespace axon::client {

struct Options {
    /// HOST:PORT of a front-end server; or a Glacier2 router, as Axon.Clients/router:tcp -h HOST -p PORT.
    std::string server = "127.0.0.1:10410";
    std::string user, password;
    std::map<std::string, std::string> properties;  ///< of Ice (Ice.*, IceSSL.*), for both connections
    std::string display_name;                       ///< empty = user@host
    Seconds timeout{5};  ///< of every request that waits for an answer; never infinite
    bool reconnect = true;
    /// After a lost connection the leases are kept for the time that their Entity Managers grant (5 s unless
    /// they are set otherwise) and resumed when this client is back in time. false = they are lost with it.
    bool resume = true;
    /// connect() returns when this client has been told of every entity there is, or the timeout has passed;
    /// false = as soon as both lanes stand, which is all that a stop of everything needs.
    bool await_entities = true;
    /// Talk to the Entity Managers of what is held without the servers in between, where they offer it and
    /// can be reached; false = by the servers only. Lease, refusals and order are the same either way. Where
    /// the server is called by TLS or through a router nothing but the servers' way is taken
    /// (docs/reference/direct.md).
    bool direct = true;
    /// At most so many of them; what is held beyond is reached by the servers. Each costs two connections,
    /// here and there.
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

/// A run of a global service, told of by its master. Copies refer to the same run. Dropping the last copy
/// does not cancel it. Threads and ownership: as of a Task.
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
    /// Does not wait: returns when the request has been taken to be sent; refusals arrive as
    /// TaskState::Refused with their reason.
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
    /// Messages go straight to the Entity Manager and come from there (Options::direct); otherwise by the
    /// servers. It may change at any moment, and changes nothing else.
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
    /// Like clear() it waits for the receipt, so neither may be called on the library's callback thread. The
    /// receipt says how many tasks that ended, which may be none. WRONG_STATE where it takes part in a
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
/// Where in the flow: the first station (ARCHITECTURE.md, section 1).
/// States: connected; lost (reconnecting with backoff, calls answer NOT_CONNECTED, leases are orphaned);
/// closed.
/// Threads: every member may be called from any thread. Callbacks run on one thread of the library, in order;
/// they may call anything except what waits (Task::wait, checkOut, …). Ownership: closing or destroying it
/// releases what it holds, in an orderly way. Failure: refusals as Result; nothing throws but misuse
/// (std::logic_error) and std::bad_alloc, which ends the program where it comes while a message leaves.
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
    Result<Proposal> propose(const GlobalService& service, const Bindings& chosen = {}) const;
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
