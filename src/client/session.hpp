// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <atomic>
#include <condition_variable>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <unordered_map>
#include <vector>

#include "axon/client.hpp"
#include "client/callback_queue.hpp"
#include "client/datagram_sender.hpp"
#include "client/direct_links.hpp"
#include "client/direct_sending.hpp"
#include "client/ice_direct_path.hpp"
#include "client/send_queue.hpp"
#include "client/server_connection.hpp"
#include "client/session_core.hpp"
#include "client/stop_desk.hpp"
#include "client/upload.hpp"
#include "common/snapshot.hpp"
#include "transport/timer_thread.hpp"

namespace axon::client {

/// What copies of one Task share. The report is the core's newest; the callbacks run on the callback thread.
struct Task::Shared {
    Shared(Id128 task, std::weak_ptr<Client::Session> owner, TaskReport first)
        : id(task), text(task.toString()), session(std::move(owner)), report(std::move(first)) {}

    const Id128 id;
    const std::string text;
    const std::weak_ptr<Client::Session> session;

    std::mutex mutex;
    std::condition_variable changed;
    // Guarded by mutex:
    TaskReport report;
    std::vector<std::function<void(const TaskReport&)>> callbacks;
};

/// What copies of one Run share; as of a Task.
struct Run::Shared {
    Shared(Id128 run, std::weak_ptr<Client::Session> owner, RunReport first)
        : id(run), text(run.toString()), session(std::move(owner)), report(std::move(first)) {}

    const Id128 id;
    const std::string text;
    const std::weak_ptr<Client::Session> session;

    std::mutex mutex;
    std::condition_variable changed;
    // Guarded by mutex:
    RunReport report;
    std::vector<std::function<void(const RunReport&)>> callbacks;
};

/// What copies of one CheckOut share.
struct CheckOut::Shared {
    Shared(Held granted, std::weak_ptr<Client::Session> owner, Entity first)
        : held(std::move(granted)), session(std::move(owner)), last(std::move(first)) {}

    const Held held;
    const std::weak_ptr<Client::Session> session;

    std::mutex mutex;
    // Guarded by mutex:
    Entity last;  // for entity() when it has left
    std::function<void(const std::string&)> text, raw;
    std::function<void(const Service&)> service;
    std::function<void(const Refusal&)> lost;
    std::function<void(const std::string&)> orphaned;
    std::function<void()> resumed;
    std::function<void(const HandOverRequest&)> hand_over;
    std::optional<Refusal> lost_why;
};

/// The rim around SessionCore and StopDesk: locks, threads, connections (README.md has the table of threads).
///
/// Where in the flow: between the public header and the network. Each core has a mutex; neither is held
/// across a call of Ice or of the user. The cores' messages are collected while the lock is held and sent
/// after it, in order. The way of a stop takes only the desk's mutex and the signal lane, neither of which
/// data ever holds. Lifetime: held by the Client; handles refer to it weakly. close() ends all threads, so
/// the last reference may be dropped anywhere.
class Client::Session final : public SessionObserver,
                              public ServerLink,
                              public StopLink,
                              public ConnectionEvents,
                              public DirectPathEvents,
                              public std::enable_shared_from_this<Client::Session> {
  public:
    Session(Options options, std::shared_ptr<const Clock> clock);
    ~Session() override;

    Result<void> connect();
    const std::shared_ptr<const Clock>& clock() const { return time_; }
    void close();

    /// Who sends what a use of the core gave to send: the calling thread, when it is the user's and does not send fast
    /// (leavesToSender()), or the sender's thread. The threads of heartbeats, deadlines and signals send no data: whoever floods the
    /// data lane must not hold them up.
    enum class Sends : std::uint8_t { Here, Sender };
    /// Runs `use` on the core, then sends what it gave to send and wakes the threads that wait for its times.
    template <class Use>
    auto withCore(Use&& use, Sends sends = Sends::Here);
    /// A request of the core that answers by a callback; waits for the answer.
    template <class Answer, class Ask>
    Answer ask(Ask&& ask);
    template <class Use>
    auto look(Use&& use) const {
        const std::lock_guard lock(core_mutex_);
        return use(core_);
    }

    /// `begin` gives the core an order to check out, and returns its number.
    using BeginCheckOut =
        std::function<Id128(SessionCore&, const CheckOutOptions&, SessionCore::CheckOutDone)>;
    Result<std::vector<CheckOut>> checkOut(const CheckOutOptions& options, const BeginCheckOut& begin);
    std::vector<CheckOut> held() const;
    Task run(const Held& held, std::string_view service, const std::vector<Argument>& arguments,
             Seconds not_after);
    Result<Run> runGlobal(const GlobalService& service, const Bindings& bindings, std::string_view master,
                          bool check_only);
    Result<collaboration::Proposal> propose(const GlobalService& service, const Bindings& chosen);
    Result<RunHistory> runHistory(const std::vector<std::string>& names, int most);
    Result<void> upload(const Held& held, std::string_view service, std::string_view resource,
                        const std::filesystem::path& file,
                        const std::function<void(std::uint64_t, std::uint64_t)>& progress,
                        const std::stop_token& give_up);
    Result<void> release(const Held& held);
    Result<std::vector<Receipt>> stop(const std::vector<std::string>& names, Seconds deadline,
                                      Seconds standstill);
    /// A reset or clear, and what became of it.
    Result<Receipt> command(const Held& held, Result<void> (SessionCore::*give)(const Held&, std::int64_t));
    Result<std::vector<DrillReport>> drill(const std::vector<std::string>& names, int count, Seconds period,
                                           const std::stop_token& give_up);
    Result<Entity> waitFor(std::string_view name, Seconds time) const;
    Result<std::shared_ptr<void>> watch(std::string_view name, const std::vector<std::string>& streams,
                                        std::function<void(const Sample&)> callback);
    void unwatch(std::uint64_t watch);
    /// OVERLOADED while the server does not read, TOO_LARGE for what no message holds. Binding under
    /// core_mutex_, in one with the sending, so that several threads do not share the last place.
    Refusal admit(std::size_t bytes) const;
    /// Until little waits for the server, or the connection ends, or `wait` is over.
    void awaitRoom(Seconds wait) const;

    void setOnEntity(std::function<void(Presence, const Entity&)> callback);
    void setOnConnection(std::function<void(bool, const std::string&)> callback);
    void post(std::function<void()> callback, bool may_be_left_out);
    /// Waiting on the callback thread would wait for itself.
    void mayWait() const;
    const Options& options() const { return options_; }

    // SessionObserver: under core_mutex_.
    void onEntity(Presence presence, const Entity& entity) override;
    void onTask(const TaskReport& report) override;
    void onRun(const RunReport& report) override;
    void onText(const Held& held, const std::string& text) override;
    void onRaw(const Held& held, const std::string& bytes) override;
    void onService(const Held& held, const Service& service) override;
    void onLost(const Held& held, const Refusal& why) override;
    void onDatagrams(const Held& held, const std::string& endpoint, const std::string& key) override;
    void onDirect(const Held& held, const std::string& data_endpoint, const std::string& signal_endpoint,
                  const std::string& key) override;
    void onOrphaned(const Held& held, const std::string& reason) override;
    void onResumed(const Held& held) override;
    void onHandOver(const Held& held, const HandOverRequest& request) override;
    void onSample(const Sample& sample) override;
    void onTransferCredit(const Id128& transfer, std::uint64_t offset, std::uint64_t limit) override;
    void onServerText(int code, const std::string& text) override;

    // ServerLink: under core_mutex_.
    void sendToEntity(const Header& head, std::string bytes) override;
    void sendToEntityDataSeq(const Header& head, std::string bytes) override;
    void sendRequest(const Header& head, std::string bytes) override;
    void sendReset(const Header& head) override;
    void sendClear(const Header& head) override;
    void keepAlive(std::int64_t sequence, bool busy) override;

    // StopLink: under desk_mutex_.
    void sendStopSignal(Lane lane, const Header& head, StopCause cause) override;
    void sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                         StopCause cause) override;

    // ConnectionEvents: threads of Ice.
    void newProfile(std::uint64_t attempt, Presence presence, const Registration& registration,
                    std::string_view profile) override;
    void newStatus(std::uint64_t attempt, const EntityStatus& status) override;
    void newServiceRecord(std::uint64_t attempt, const Header& head, std::string_view record) override;
    void newEntityMsg(std::uint64_t attempt, Lane lane, direct::Keeping keeping, const Header& head,
                      std::string_view message) override;
    void newRefusal(std::uint64_t attempt, const Header& head, const Refusal& refusal) override;
    void newStopAccepted(std::uint64_t attempt, const Header& head, int entities) override;
    void newServerText(std::uint64_t attempt, int code, const std::string& text) override;
    void newServerHeartbeat(std::uint64_t attempt) override;
    void closed(std::uint64_t attempt, const std::string& reason) override;

    // DirectPathEvents: threads of Ice.
    void newDirectMsg(const DirectPath& path, direct::Keeping keeping, Header head,
                      std::string_view message) override;
    void newDirectReceipt(const DirectPath& path, const Header& head, std::string_view message) override;
    void directChanged() override;

    /// Messages to this entity go by a direct path.
    bool direct(const Held& held) const;

  private:
    /// A timer thread that other threads may wake while it is being ended.
    class Alarm {
      public:
        void start(const char* name, Lane lane, const Clock& clock, std::function<TimePoint()> tick);
        void wake();
        void end();

      private:
        std::mutex mutex_;
        std::unique_ptr<transport::TimerThread> thread_;  // guarded by mutex_
    };
    struct OutgoingStop {
        Lane lane;
        Header head;
        std::vector<std::string> entities;  // none: what the head names
        StopCause cause;
    };
    struct Watching {
        std::string entity;
        std::vector<std::string> streams;
        std::shared_ptr<const std::function<void(const Sample&)>> callback;
        std::shared_ptr<std::atomic<bool>> wanted;
    };
    /// For events of the server: nothing when they belong to an earlier attempt.
    template <class Use>
    void onCore(std::uint64_t attempt, Use&& use);
    template <class Use>
    auto withDesk(Use&& use);

    void put(Operation kind, const Header& head, std::string bytes);
    void flush(std::uint64_t ticket);
    /// Whether it was a receipt.
    bool receipt(const Header& head, std::string_view message);
    void signalReply(const Header& head, std::string_view message);
    /// What is due of the direct paths; when next.
    TimePoint directTurn();
    static void close(const DirectLinks::Closing& closing, const std::string& why);
    void withdrawDirect(const Held& held);
    bool leavesToSender();
    Result<void> establish();
    void lost(std::uint64_t attempt, const std::string& reason);
    void acknowledgedByDatagram(const radio::StopRepeater::Acknowledged& acknowledged);
    void tellConnection(bool connected, const std::string& reason);
    TimePoint onTimer();
    TimePoint onHeartbeat();
    TimePoint onStopTimer();
    std::shared_ptr<CheckOut::Shared> shared(const Held& held) const;

    // Constant after construction.
    const Options options_;
    const std::shared_ptr<const Clock> time_;
    const Clock& clock_{*time_};
    SystemRandom random_;
    SignalMarks marks_;

    // The attempt whose events count; 0 = none. Written under core_mutex_, and before the desk is told.
    std::atomic<std::uint64_t> listening_{0};

    mutable std::mutex core_mutex_;
    mutable std::condition_variable entities_changed_;
    // Guarded by core_mutex_:
    SessionCore core_;
    std::uint64_t attempt_ = 0;
    bool up_ = false;
    std::optional<std::pair<std::int64_t, bool>> beat_;
    TimePoint sent_at_{};  // the last message, if none came from the servers since and nobody waits for an answer
    std::size_t last_bytes_ = 0;  // of the message that was put last
    bool posted_ = false;         // a callback, by the thread in withCore()
    bool may_beat_ = true;  // of the heartbeat's thread: what keep_running said last
    TimePoint timer_at_ = TimePoint::max(), heartbeat_at_ = TimePoint::max();
    std::unordered_map<std::string, std::weak_ptr<Task::Shared>> tasks_;
    std::unordered_map<std::string, std::weak_ptr<Run::Shared>> runs_;
    std::map<Held, std::shared_ptr<CheckOut::Shared>> check_outs_;
    std::unordered_map<Id128, std::shared_ptr<UploadWindow>> uploads_;
    std::map<std::uint64_t, Watching> watches_;
    DirectLinks direct_;  // but paths()
    std::uint64_t next_watch_ = 0;

    std::mutex desk_mutex_;
    // Guarded by desk_mutex_:
    StopDesk desk_;
    std::vector<OutgoingStop> stops_;
    TimePoint stops_at_ = TimePoint::max();

    SendQueue<Outgoing> outgoing_;  // put into under core_mutex_
    std::mutex send_mutex_;         // the order of outgoing_ is that on the wire
    DirectSending ways_;            // guarded by send_mutex_

    std::mutex callbacks_mutex_;
    // Guarded by callbacks_mutex_:
    std::function<void(Presence, const Entity&)> on_entity_;
    std::function<void(bool, const std::string&)> on_connection_;

    // The connection in use, twice: the stop's reference is behind a lock of its own.
    Snapshot<ServerConnection> connection_{nullptr};
    Snapshot<ServerConnection> signal_connection_{nullptr};

    // Confined to the timer thread, after connect().
    Duration backoff_{};
    TimePoint retry_at_ = TimePoint::max();
    std::atomic<bool> retry_{false};

    std::atomic<bool> closing_{false};
    std::atomic<bool> give_up_{false};  // the program does not return from its callbacks
    std::once_flag closed_once_;
    CallbackQueue callbacks_;
    Ice::CommunicatorHolder data_communicator_, signal_communicator_;
    LaneHome data_, signal_;
    Alarm sender_, timer_, heartbeat_, stop_timer_;
    DatagramSender datagrams_{clock_, [this](const auto& acknowledged) { acknowledgedByDatagram(acknowledged); }};
};

}  // namespace axon::client
