// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "axon/client.hpp"
#include "client/alarm.hpp"
#include "client/connection/connection_events.hpp"
#include "client/connection/datagram_sender.hpp"
#include "client/connection/reconnection.hpp"
#include "client/core/session_core.hpp"
#include "client/direct/direct_links.hpp"
#include "client/news_desk.hpp"
#include "client/sending/departure.hpp"
#include "client/sending/message_sender.hpp"
#include "client/sending/stop_sender.hpp"
#include "common/release.hpp"
#include "common/snapshot.hpp"

namespace Ice {
class Endpoint;
}

namespace axon::client {

class Communicators;
class LaneReaders;
class ServerConnection;

/// The rim around SessionCore: its lock, threads, the connection and its recovery (README.md has the table of
/// threads).
///
/// Where in the flow: between the handles of the public header and the network. Whoever uses the core does so
/// by withCore(), and what the core gives to send leaves after it (collect(), depart()). Messages are
/// MessageSender's, stops StopSender's, and what the program is told is NewsDesk's; neither lock is held
/// across a call of Ice or of the user. Lifetime: held by the Client; handles refer to it weakly. close()
/// ends all threads, so the last reference may be dropped anywhere.
class Client::Session final : public LeaseOffers,
                              public ConnectionEvents,
                              public DirectPathEvents,
                              public std::enable_shared_from_this<Client::Session> {
  public:
    Session(Options options, std::shared_ptr<const Clock> clock);
    ~Session() override;

    Result<void> connect();
    void close();

    /// Which thread sends the messages of a use of the core: the calling thread, if it is the user's and does
    /// not send fast, or the sender's thread. The threads of heartbeats, deadlines and signals send no data,
    /// so that a flood on the data lane cannot hold them up. Reader: as Sender; and the callbacks of what the
    /// program is told run in directRead(), unless many wait.
    enum class Sends : std::uint8_t { Here, Sender, Reader };
    /// Runs `use` on the core under its lock; then what it gave to send leaves (depart()).
    template <class Use>
    auto withCore(Use&& use, Sends sends = Sends::Here) {
        return departure_.after([&]() -> decltype(auto) { return use(core_); }, sends);
    }
    /// A request of the core that answers by a callback; waits for the answer.
    template <class Answer, class Ask>
    Answer ask(Ask&& ask) {
        mayWait();
        auto promise = std::make_shared<std::promise<Answer>>();
        auto future = promise->get_future();
        withCore([&](SessionCore& core) {
            ask(core, [promise](Answer answer) { promise->set_value(std::move(answer)); });
            messages_.breakBurst();
        });
        return future.get();
    }
    template <class Use>
    auto look(Use&& use) const {
        const std::lock_guard lock(core_mutex_);
        return use(core_);
    }

    Result<Entity> waitFor(std::string_view name, Seconds time) const;
    /// Messages to this entity go by a direct path.
    bool direct(const Held& held) const;
    /// Throws std::logic_error inside a callback: waiting there would wait for itself.
    void mayWait() const;

    MessageSender& messages() { return messages_; }
    StopSender& stops() { return stops_; }
    /// What of it is guarded by the core's lock is used inside withCore() or look().
    NewsDesk& news() { return news_; }
    SignalMarks& marks() { return marks_; }
    RandomSource& random() { return random_; }
    const Options& options() const { return options_; }
    const std::shared_ptr<const Clock>& clock() const { return clock_; }

    // LeaseOffers: under core_mutex_.
    void onDatagrams(const Held& held, const std::string& endpoint, const std::string& key) override;
    void onDirect(const Held& held, const std::string& data_endpoint, const std::string& signal_endpoint,
                  const std::string& key) override;

    // ConnectionEvents: threads of Ice.
    void newProfile(std::uint64_t attempt, Presence presence, const Registration& registration,
                    std::string_view profile) override;
    void newStatus(std::uint64_t attempt, const EntityStatus& status) override;
    void newEntityMsg(std::uint64_t attempt, Lane lane, direct::Keeping keeping, const Header& head,
                      std::string_view message) override;
    void newRefusal(std::uint64_t attempt, const Header& head, const Refusal& refusal) override;
    void newStopAccepted(std::uint64_t attempt, const Header& head, int entities) override;
    void newServerText(std::uint64_t attempt, int code, const std::string& text) override;
    void newServerHeartbeat(std::uint64_t attempt) override;
    void newServerRelease(const std::string& release) override;
    void closed(std::uint64_t attempt, const std::string& reason) override { lost(attempt, reason); }

    // DirectPathEvents: threads of LaneReaders and of Ice.
    void newDirectMsg(const DirectPath& path, direct::Keeping keeping, Header head,
                      std::string_view message) override;
    void directRead() override;
    void newDirectReceipt(const DirectPath& path, const Header& head, std::string_view message) override;
    void directChanged() override;

  private:
    friend class Departure<Session>;
    /// What a use of the core has left to be done without its lock.
    struct Leaving {
        MessageSender::Leaving messages;
        bool told, wake_timer, wake_heartbeat;
    };
    Leaving collect(Sends sends);
    void depart(const Leaving& leaving) noexcept;
    /// For events of the server: nothing when they belong to an earlier attempt.
    template <class Use>
    void onCore(std::uint64_t attempt, Use&& use);

    Result<void> establish();
    void lost(std::uint64_t attempt, const std::string& reason);
    TimePoint onTimer();
    TimePoint onHeartbeat();
    /// What is due of the direct paths; when next.
    TimePoint directTurn();

    struct Threads {
        Alarm sender, timer, heartbeat, stops;
    };

    // Constant after construction.
    const Options options_;
    const std::shared_ptr<const Clock> clock_;
    SystemRandom random_;
    SignalMarks marks_;
    const std::shared_ptr<Communicators> communicators_;
    const std::shared_ptr<LaneReaders> lane_readers_;
    Threads threads_;

    // The attempt whose events count; 0 = none. Written under core_mutex_, and before the desk is told.
    std::atomic<std::uint64_t> listening_{0};

    mutable std::mutex core_mutex_;
    mutable std::condition_variable entities_changed_;
    // Guarded by core_mutex_:
    SessionCore core_;
    DirectLinks direct_;  // but paths()
    NewsDesk news_;       // in part
    std::uint64_t attempt_ = 0;
    bool up_ = false;
    bool may_beat_ = true;  // of the heartbeat's thread: what keep_running said last

    MessageSender messages_;
    DatagramSender datagrams_;
    StopSender stops_;
    const Departure<Session> departure_{*this, core_mutex_};

    Snapshot<ServerConnection> connection_{nullptr};
    Reconnection reconnection_;
    // Of connect(), then of the timer's thread: the router of the last session, until it has been tried
    // again.
    std::shared_ptr<Ice::Endpoint> last_router_;
    ReleaseNotes releases_;
    std::atomic<bool> closing_{false};
    std::atomic<bool> give_up_{false};  // the program does not return from its callbacks
    std::once_flag closed_once_;
};

}  // namespace axon::client
