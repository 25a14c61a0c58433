// SPDX-License-Identifier: MIT
#pragma once
#include <pybind11/pybind11.h>
#include <sys/types.h>

#include <atomic>
#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "python_stop.hpp"
#include "stop_action.hpp"
#include "values.hpp"

namespace axon::python {

namespace py = pybind11;

/// A process that was forked from the one that has started an Interfacer has none of its threads.
class ForkedError : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

/// Throws ForkedError in a process that was forked from one in which an Interfacer was started last.
void checkProcessOfTasks();

/// The EntityInterfacer of a Python program.
///
/// Where in the flow: between axon::EntityInterfacer, whose threads it lets into the interpreter, and
/// axon_entity.Entity, which is written in Python.
///
/// Locks: every function that can wait releases the interpreter lock first. No mutex of this class, and none
/// of the library below, is held by a thread that waits for the interpreter lock. The stop thread never waits
/// for it: native stop actions need none, and a Python function for stops has a thread of its own.
///
/// States: made → started → shutting down (beginShutdown(), a signal, quit()) → finished.
///
/// Threads: any. Ownership: whoever drops it after start() without shutdown() waits for its handlers.
class Interfacer {
  public:
    struct Settings {
        EntityInterfacer::Options options;
        bool queue_log = false;  ///< keep log lines for takeLog() instead of writing them to standard error
    };
    explicit Interfacer(Settings settings);
    ~Interfacer();
    Interfacer(const Interfacer&) = delete;
    Interfacer& operator=(const Interfacer&) = delete;

    void uploadBasicProfile(const std::string& file);
    void uploadServiceProfile(const std::string& file);
    /// `function(task)` of a service. Before start(), as all callbacks.
    void onTask(const std::string& service, py::object function);
    /// By name: parameter, config, resource, task_request, pause, resume, text, raw, not_sent, link_up,
    /// link_down.
    void on(const std::string& event, py::object function);
    /// What a stop does: the native actions in their order, then the function if there is one.
    void onStop(std::vector<std::shared_ptr<StopAction>> actions, py::object function, double bound_s);

    void start();
    /// Blocks until SIGINT, SIGTERM, quit() or beginShutdown(), and until the stop that follows was carried
    /// out. Handlers of other signals run meanwhile, and what they raise ends the waiting.
    /// From the beginning of the shutdown on, the process has this long; see forceExitAfter().
    void waitUntilQuit(double force_exit_after_s);
    void quit();
    /// Stops the robot and ends the link, on a thread of its own.
    void beginShutdown();
    /// Ends the process with status 1 if not everything has ended within this time, also while something
    /// keeps the interpreter. Only the first call counts.
    void forceExitAfter(double seconds);
    /// Whether everything has ended within this time.
    bool finish(double seconds);

    /// Calls on the library, refused in a forked process.
    EntityInterfacer& library() const;
    bool started() const { return started_; }
    /// This process is a copy of the one that has called start().
    bool forked() const;
    std::uint64_t stops() const { return stops_; }
    /// The oldest lines of the log, after waiting at most this long for one. Empty also when finished.
    std::vector<std::pair<int, std::string>> takeLog(double seconds);
    bool logEnded();

  private:
    void stop(const StopSignal& signal);
    void log(LogLevel level, const std::string& text);
    void endLog();
    void checkProcess() const;

    std::unique_ptr<EntityInterfacer> interfacer_;
    std::vector<std::shared_ptr<StopAction>> actions_;  // constant after start()
    std::unique_ptr<PythonStop> python_stop_;           // constant after start()
    // Python objects: touched only with the interpreter lock.
    std::vector<std::pair<std::string, py::object>> functions_;
    std::atomic<bool> started_{false};
    std::atomic<pid_t> process_{0};  // of start(); 0 before
    std::atomic<std::uint64_t> stops_{0};

    /// Everything that a thread waits for. In a forked process it stays as it is: destroying a condition
    /// variable for which a thread of the former process waits would never end.
    struct State {
        std::mutex mutex;
        std::condition_variable changed;
        bool closing = false;           // guarded by mutex
        bool stopped_for_good = false;  // guarded by mutex: the stop of the shutdown was carried out
        bool finished = false;          // guarded by mutex
        bool forced = false;            // guarded by mutex: forceExitAfter() was called
        std::thread closer;             // guarded by mutex

        std::mutex log_mutex;
        std::condition_variable log_changed;
        std::deque<std::pair<int, std::string>> log;  // guarded by log_mutex
        std::uint64_t log_lost = 0;                   // guarded by log_mutex
        bool log_ended = false;                       // guarded by log_mutex
    };
    std::shared_ptr<State> state_ = std::make_shared<State>();  // shared with the thread of forceExitAfter()
    int wake_ = -1;  // an eventfd: a signal of the process, quit(), or the end
};

}  // namespace axon::python
