// SPDX-License-Identifier: MIT
#pragma once
#include <array>
#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/liveness.hpp"
#include "common/release.hpp"
#include "entity_interfacer/axon/entity_interfacer.hpp"
#include "entity_interfacer/handshakes.hpp"
#include "entity_interfacer/link.hpp"
#include "entity_interfacer/running_task.hpp"
#include "entity_interfacer/statements.hpp"
#include "entity_interfacer/stop_level.hpp"
#include "entity_interfacer/stream_channels.hpp"
#include "entity_interfacer/task_threads.hpp"
#include "host/port_range.hpp"

namespace axon::proto {
class Configuration;
class EiToEm;
class EmToEi;
class LinkBeat;
class NotSent;
class StopSignal;
class TaskDispatch;
}  // namespace axon::proto

namespace axon {

struct Stream::Channel {
    Channel(std::string stream_name, Communicator& owner)
        : name(std::move(stream_name)), communicator(owner) {}
    const std::string name;
    Communicator& communicator;
    std::atomic<std::uint64_t> sequence{0};
    std::atomic<bool> wanted{true};
};

/// The communication port of the Entity Interfacer (thesis 3.3.2): sockets and threads.
///
/// Threads: the *stop thread* reads the signal connection and runs the stop callback; the *watch thread*
/// accepts, beats and watches for silence; the *data thread* reads the data connection and runs all other
/// callbacks; one thread per running task. They hand links over by pointer and wake each other by eventfd.
///
/// Parts with state of their own: Handshakes (connections that are not a link yet), TaskThreads, Statements
/// and StreamChannels (what a new link must be told, or takes back). None of their locks is taken before
/// onStop is called.
class Communicator : private Handshakes::Others {
  public:
    struct Callbacks {
        std::function<Decision(const std::string&, const Parameter&)> parameter;
        std::function<void(const std::string&, const Parameter&)> config;
        std::function<Decision(const std::string&, const std::string&, const std::filesystem::path&)>
            resource;
        std::function<Decision(const Task&)> task_request;
        std::map<std::string, EntityInterfacer::TaskHandler, std::less<>> tasks;
        EntityInterfacer::TaskHandler any_task;
        std::function<void(const Task&)> pause, resume;
        std::function<void(const std::string&, const std::string&)> text;
        std::function<void(const std::vector<std::string>&, const std::string&)> raw;
        std::function<void(const StopSignal&)> stop;
        std::function<void()> link_up;
        std::function<void(const std::string&)> link_down;
        std::function<void(const std::string&, const std::string&)> not_sent;
    };

    explicit Communicator(EntityInterfacer::Options options);
    ~Communicator() override;

    /// Throws std::logic_error once started.
    Callbacks& settableCallbacks();
    void upload(bool services, const std::filesystem::path& file);

    void start();
    void run();
    void quit();
    void shutdown();

    TimePoint now() const { return clock_->now(); }
    bool linked() const;
    std::uint16_t port() const { return port_.load(); }

    /// To the Entity Manager that is linked now, if any. False when larger than a frame.
    bool send(const proto::EiToEm& message, Link::Kind kind);
    void standstill();
    void setPosition(double x, double y, double z);
    void setServiceActive(std::string_view service, bool active, std::string_view reason);
    void sendTaskFeedback(std::string_view service, std::string_view text);
    std::shared_ptr<Stream::Channel> channel(std::string_view name);
    void log(LogLevel level, const std::string& text) const;

  private:
    struct Profile {
        std::filesystem::path file;
        std::filesystem::file_time_type changed;
        std::uintmax_t size = 0;
        std::string xml;
        bool send = false;
    };

    // Stop thread
    void stopThread();
    void readSignals(Link& link);
    void onSignal(Link& link, const proto::EmToEi& message);
    void dispatchStop(StopSignal::Cause cause);
    /// The stop is over, and acknowledged, when the callback has returned, and nothing older that could move
    /// the robot runs; until then it is owed.
    void callStop(const StopSignal& signal);
    void acknowledge(Link& link, std::uint32_t generation);
    void tellStandstill(Link& link, std::uint32_t generation);

    // Watch thread
    void watchThread();
    bool stopFailed() const override { return stop_failed_; }
    std::optional<std::string> linkedWith() const override;
    void linkWith(Handshakes::Pair pair) override;
    void beat();
    void checkSilence();

    // Data thread
    void dataThread();
    void readData(const std::shared_ptr<Link>& link);
    void onData(const std::shared_ptr<Link>& link, const proto::EmToEi& message);
    /// Of every value that a client gives, by itself or with a task.
    Decision decideParameter(const std::string& service, const Parameter& parameter) const;
    void onConfiguration(const std::shared_ptr<Link>& link, const proto::Configuration& configuration);
    void onNotSent(const proto::NotSent& refused);
    void onTask(const std::shared_ptr<Link>& link, const proto::TaskDispatch& dispatch);
    void runTask(const std::shared_ptr<Task::Running>& task, const EntityInterfacer::TaskHandler& handler);
    void adoptDataLink(const std::shared_ptr<Link>& link);
    void sendProfiles(Link& link, bool all);
    void watchProfiles();
    /// " (what)" of an exception that has left the call; nothing where none has.
    template <class Call>
    static std::optional<std::string> thrownBy(Call call);
    /// False when it threw, which is a fault.
    template <class Call>
    bool guarded(const char* what, Call call, const std::function<void()>& last_words = {});
    /// Whether a stop has come since the Entity Manager, at this generation, passed something on.
    bool overtaken(const Link& link, std::uint32_t generation) const;
    /// Makes a call that may move the robot, unless a stop has overtaken it. A stop that comes during the
    /// call is called again afterwards.
    template <class Call>
    void unlessOvertaken(const Link& link, std::uint32_t generation, Call call);
    void logNotes();

    std::shared_ptr<Link> currentLink() const;
    void publish(std::shared_ptr<Link> link);
    /// Stops the application and cuts the link, so that the Entity Manager cannot start the next task. The
    /// last words are sent once nothing that answers them can begin.
    void fault(const std::string& what, const std::function<void()>& last_words);
    /// A log line of the stop or the watch thread, which never wait for a logger: the data thread writes it.
    void note(LogLevel level, std::string text);
    bool onOwnThread() const;

    static thread_local const Communicator* this_thread_of;  // a thread knows whose it is

    // Constant after start()
    EntityInterfacer::Options options_;
    std::shared_ptr<const Clock> clock_;
    std::atomic<bool> reports_standstill_;
    LinkPorts where_;
    Callbacks callbacks_;

    std::atomic<bool> started_{false};
    std::atomic<bool> shut_down_{false};
    std::atomic<std::uint16_t> port_{0};
    std::mutex shutdown_mutex_;

    StopLevel level_{*clock_};
    WakeUp stop_wake_, watch_wake_, data_wake_, run_wake_;
    std::atomic<bool> quit_{false};
    std::atomic<bool> end_stop_thread_{false}, end_watch_thread_{false}, end_data_thread_{false};
    std::atomic<unsigned> faults_{0};

    // Written by the stop thread, read by the watch thread
    Liveness manager_;  // of the Entity Manager; the watch thread judges it, and sets it up for each link
    std::atomic<bool> in_callback_{false};

    // Links on their way from the watch thread to the stop thread, and from there to the data thread
    std::mutex signal_handover_mutex_, data_handover_mutex_;
    std::shared_ptr<Link> signal_handover_, data_handover_;

    // Stop thread
    std::shared_ptr<Link> signal_link_;
    bool baseline_known_ = false;
    std::optional<StopSignal> owed_;        // called, and to be called again
    TimePoint call_again_{};                // not before, where the callback threw
    std::atomic<bool> stop_failed_{false};  // the last call threw; read by the watch thread

    // Watch thread
    std::shared_ptr<Link> watched_;
    Handshakes handshakes_;
    ReleaseNotes releases_{"this robot application", "protocol " + std::to_string(Handshakes::kProtocol)};
    TimePoint next_beat_{};
    std::uint64_t beat_sequence_ = 0;
    TimePoint slow_warn_again_{};

    // Data thread
    bool may_move_ = false;  // something that may move the robot has come by the present link
    std::string last_not_sent_;
    TimePoint tell_not_sent_{};
    TimePoint next_profile_look_{};

    mutable std::mutex link_mutex_;
    std::shared_ptr<Link> link_;  // what senders see, published by the data thread; guarded by link_mutex_

    std::mutex notes_mutex_;                               // held for a push or a swap
    std::vector<std::pair<LogLevel, std::string>> notes_;  // guarded by notes_mutex_

    std::mutex profiles_mutex_;        // held for a copy, and while they are sent
    std::array<Profile, 2> profiles_;  // guarded by profiles_mutex_

    Statements statements_;
    StreamChannels<Stream::Channel> channels_;
    TaskThreads<Task::Running> tasks_{data_wake_};

    std::thread stop_thread_, watch_thread_, data_thread_;
};

}  // namespace axon
