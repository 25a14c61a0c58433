// SPDX-License-Identifier: MIT
#include "interfacer.hpp"

#include <poll.h>
#include <pthread.h>
#include <pybind11/stl.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <string_view>

namespace axon::python {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kLogMax = 1000;

std::atomic<int> wake_of_program{-1};  // of waitUntilQuit(), for the signal handler
static_assert(std::atomic<int>::is_always_lock_free);

std::atomic<pid_t> process_of_tasks{0};  // in which an Interfacer was started last

[[noreturn]] void refuseFork() {
    throw ForkedError(
        "this process is a fork of the one that runs the entity, and has none of its threads; fix: start "
        "other processes with subprocess or multiprocessing.get_context('spawn'), or fork before "
        "entity.start()");
}

void onSignalOfProcess(int) {
    const int saved = errno;
    const int wake = wake_of_program.load();
    const std::uint64_t one = 1;
    if (wake >= 0) (void)!::write(wake, &one, sizeof one);
    errno = saved;
}

std::chrono::nanoseconds nanoseconds(double seconds) {
    if (!(seconds >= 0) || seconds > 1e9) seconds = seconds > 1e9 ? 1e9 : 0;
    return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double>(seconds));
}

/// What a Python exception says, in one line: "ValueError: too far". Needs the interpreter lock.
std::string textOf(py::error_already_set& error) {
    std::string text = "a Python exception";
    try {
        text = py::str(error.type().attr("__name__"));
        const std::string said = py::str(error.value());
        if (!said.empty()) text += ": " + said;
    } catch (py::error_already_set&) {
    }
    return text;
}

/// Calls Python from a thread of the library. Its exceptions become text before the interpreter is left.
template <class Call>
auto inPython(Call call) {
    const py::gil_scoped_acquire interpreter;
    try {
        return call();
    } catch (py::error_already_set& error) {
        throw std::runtime_error(textOf(error));
    } catch (const py::cast_error& error) {
        throw std::runtime_error(error.what());
    }
}

/// A decision in Python: None or True grants; a text, or (text, True) where the robot is lost, denies.
Decision toDecision(const py::object& answer) {
    if (answer.is_none()) return Decision::grant();
    if (py::isinstance<py::bool_>(answer))
        return answer.cast<bool>() ? Decision::grant() : Decision::deny("the robot application denies it");
    if (py::isinstance<py::str>(answer)) return Decision::deny(answer.cast<std::string>());
    const auto [reason, lost] = answer.cast<std::pair<std::string, bool>>();
    return lost ? Decision::robotLost(reason) : Decision::deny(reason);
}

}  // namespace

void checkProcessOfTasks() {
    const auto process = process_of_tasks.load();
    if (process != 0 && process != ::getpid()) refuseFork();
}

Interfacer::Interfacer(Settings settings) : wake_(::eventfd(0, EFD_CLOEXEC)) {
    if (settings.queue_log)
        settings.options.logger = [this](LogLevel level, const std::string& text) { log(level, text); };
    try {
        interfacer_ = std::make_unique<EntityInterfacer>(std::move(settings.options));
    } catch (...) {
        ::close(wake_);
        throw;
    }
}

Interfacer::~Interfacer() {
    if (forked()) {  // its threads are not in this process, and cannot be waited for
        (void)interfacer_.release();
        (void)python_stop_.release();
        (void)new std::shared_ptr<State>(std::move(state_));
        return;
    }
    if (started_) {
        const py::gil_scoped_release others;
        beginShutdown();
        while (!finish(3600)) {
        }
    }
    interfacer_.reset();  // it may log until then
    ::close(wake_);
}

bool Interfacer::forked() const {
    return process_ != 0 && process_ != ::getpid();
}

void Interfacer::checkProcess() const {
    if (forked()) refuseFork();
}

EntityInterfacer& Interfacer::library() const {
    checkProcess();
    return *interfacer_;
}

void Interfacer::uploadBasicProfile(const std::string& file) {
    library().uploadBasicProfile(file);
}
void Interfacer::uploadServiceProfile(const std::string& file) {
    library().uploadServiceProfile(file);
}

void Interfacer::onTask(const std::string& service, py::object function) {
    functions_.emplace_back(service, function);
    library().onTask(service, [function = function.ptr()](Task& task) {
        inPython([&] { py::reinterpret_borrow<py::object>(function)(Task(task)); });
    });
}

void Interfacer::on(const std::string& event, py::object function) {
    auto& library = this->library();
    auto* const called = function.ptr();  // functions_ keeps it
    const auto call = [called](const auto&... arguments) {
        return py::reinterpret_borrow<py::object>(called)(arguments...);
    };
    // A callback that may move the robot while a stop is called.
    const auto moving = [this](const auto& body) {
        struct End {
            Interfacer& of;
            ~End() {
                if (of.python_stop_) of.python_stop_->moverReturned();
            }
        } const end{*this};
        inPython(body);
    };
    if (event == "parameter")
        library.onParameter([=](const std::string& service, const Parameter& parameter) {
            return inPython([&] { return toDecision(call(service, parameter)); });
        });
    else if (event == "config")
        library.onConfig([=](const std::string& service, const Parameter& parameter) {
            inPython([&] { call(service, parameter); });
        });
    else if (event == "resource")
        library.onResource(
            [=](const std::string& service, const std::string& resource, const std::filesystem::path& file) {
                return inPython([&] { return toDecision(call(service, resource, file.string())); });
            });
    else if (event == "task_request")
        library.onTaskRequest(
            [=](const Task& task) { return inPython([&] { return toDecision(call(task)); }); });
    else if (event == "pause")
        library.onPause([=](const Task& task) { inPython([&] { call(task); }); });
    else if (event == "resume")
        library.onResume([=](const Task& task) { moving([&] { call(task); }); });
    else if (event == "text")
        library.onText(
            [=](const std::string& text, const std::string& from) { inPython([&] { call(text, from); }); });
    else if (event == "raw")
        library.onRaw([=](const std::vector<std::string>& blocks, const std::string& from) {
            moving([&] {
                py::list bytes;
                for (const auto& block : blocks) bytes.append(py::bytes(block));
                call(bytes, from);
            });
        });
    else if (event == "not_sent")
        library.onNotSent([=](const std::string& participant, const std::string& why) {
            inPython([&] { call(participant, why); });
        });
    else if (event == "link_up")
        library.onLinkUp([=] { inPython([&] { call(); }); });
    else if (event == "link_down")
        library.onLinkDown([=](const std::string& reason) { inPython([&] { call(reason); }); });
    else
        throw py::value_error("unknown event '" + event + "'");
    functions_.emplace_back(event, std::move(function));
}

void Interfacer::onStop(std::vector<std::shared_ptr<StopAction>> actions, py::object function,
                        double bound_s) {
    if (started_)
        throw std::logic_error("on_stop was set after start(); fix: set it before start() or run()");
    if (!(bound_s >= 0.01 && bound_s <= 10))
        throw py::value_error("within: expected 0.01 to 10 seconds, found " + std::to_string(bound_s));
    actions_ = std::move(actions);
    python_stop_.reset();
    if (function.is_none()) return;
    auto* const called = function.ptr();
    functions_.emplace_back("stop", std::move(function));
    python_stop_ = std::make_unique<PythonStop>(
        [called](const StopSignal& signal) -> std::string {
            try {
                inPython([&] { py::reinterpret_borrow<py::object>(called)(signal); });
                return {};
            } catch (const std::exception& error) {
                return error.what();
            }
        },
        nanoseconds(bound_s));
}

void Interfacer::stop(const StopSignal& signal) {
    stops_.fetch_add(1);
    std::string failed;
    for (const auto& action : actions_) try {
            action->carryOut();
        } catch (const std::exception& error) {
            failed += (failed.empty() ? "" : "; ") + std::string(error.what());
        }
    if (signal.cause == StopSignal::Cause::Shutdown) {
        const std::lock_guard lock(state_->mutex);
        state_->stopped_for_good = true;
        state_->changed.notify_all();
    }
    if (python_stop_) try {
            python_stop_->call(signal);
        } catch (const std::exception& error) {
            failed += (failed.empty() ? "" : "; ") + std::string(error.what());
        }
    if (!failed.empty()) throw std::runtime_error(failed);
}

void Interfacer::start() {
    checkProcess();
    if (started_) return;
    interfacer_->onStop([this](const StopSignal& signal) { stop(signal); });
    const py::gil_scoped_release others;
    process_ = ::getpid();
    process_of_tasks = ::getpid();
    interfacer_->start();
    started_ = true;
}

void Interfacer::waitUntilQuit(double force_exit_after_s) {
    checkProcess();
    if (!started_) throw std::logic_error("start() comes first");
    int nobody = -1;
    if (!wake_of_program.compare_exchange_strong(nobody, wake_))
        throw std::logic_error("only one run() at a time is possible in a process");
    struct sigaction ours {};
    struct sigaction former_int {};
    struct sigaction former_term {};
    ours.sa_handler = onSignalOfProcess;
    ::sigaction(SIGINT, &ours, &former_int);
    ::sigaction(SIGTERM, &ours, &former_term);
    // Not this thread: after the handler of another signal it may have to wait for the interpreter, and a
    // Ctrl-C stops the robot even then.
    sigset_t all, former;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &former);
    std::thread listener([this, force_exit_after_s] {
        std::uint64_t count = 0;
        while (::read(wake_, &count, sizeof count) < 0 && errno == EINTR) {
        }
        beginShutdown();
        forceExitAfter(force_exit_after_s);
    });
    pthread_sigmask(SIG_SETMASK, &former, nullptr);
    bool raised = false;
    {
        py::gil_scoped_release others;
        const auto over = [this] { return state_->stopped_for_good || state_->finished; };
        while (true) {
            // A condition variable does not return for a signal; so handlers of others wait up to 100 ms.
            {
                std::unique_lock lock(state_->mutex);
                if (state_->changed.wait_for(lock, 100ms, over)) break;
            }
            const py::gil_scoped_acquire interpreter;
            if (PyErr_CheckSignals() == 0) continue;
            raised = true;
            break;
        }
        quit();
        listener.join();
    }
    ::sigaction(SIGINT, &former_int, nullptr);
    ::sigaction(SIGTERM, &former_term, nullptr);
    wake_of_program = -1;
    if (raised) throw py::error_already_set();
}

void Interfacer::quit() {
    const std::uint64_t one = 1;
    (void)!::write(wake_, &one, sizeof one);
}

void Interfacer::beginShutdown() {
    checkProcess();
    const std::lock_guard lock(state_->mutex);
    if (std::exchange(state_->closing, true)) return;
    if (!started_) {
        state_->finished = state_->stopped_for_good = true;
        state_->changed.notify_all();
        endLog();
        return;
    }
    state_->closer = std::thread([this] {
        interfacer_->shutdown();
        if (python_stop_) python_stop_->end();
        {
            const std::lock_guard end(state_->mutex);
            state_->finished = state_->stopped_for_good = true;
        }
        state_->changed.notify_all();
        endLog();
    });
}

void Interfacer::forceExitAfter(double seconds) {
    checkProcess();
    {
        const std::lock_guard lock(state_->mutex);
        if (state_->finished || std::exchange(state_->forced, true)) return;
    }
    sigset_t all, former;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &former);  // signals are for the threads of the program
    std::thread([state = state_, within = nanoseconds(seconds)] {
        std::unique_lock lock(state->mutex);
        if (state->changed.wait_for(lock, within, [&] { return state->finished; })) return;
        constexpr std::string_view kText =
            "axon_entity: a handler or on_stop keeps the interpreter and has not returned in time after the "
            "shutdown; the program is ended (status 1)\n";
        (void)!::write(STDERR_FILENO, kText.data(), kText.size());
        ::_exit(1);
    }).detach();
    pthread_sigmask(SIG_SETMASK, &former, nullptr);
}

void Interfacer::endLog() {
    {
        const std::lock_guard lock(state_->log_mutex);
        state_->log_ended = true;
    }
    state_->log_changed.notify_all();
}

bool Interfacer::finish(double seconds) {
    checkProcess();
    std::thread closed;
    {
        std::unique_lock lock(state_->mutex);
        if (!state_->changed.wait_for(lock, nanoseconds(seconds), [&] { return state_->finished; }))
            return false;
        closed = std::move(state_->closer);
    }
    if (closed.joinable()) closed.join();
    return true;
}

bool Interfacer::logEnded() {
    const std::lock_guard lock(state_->log_mutex);
    return state_->log_ended && state_->log.empty();
}

void Interfacer::log(LogLevel level, const std::string& text) {
    {
        const std::lock_guard lock(state_->log_mutex);
        if (state_->log.size() >= kLogMax) {
            state_->log.pop_front();
            ++state_->log_lost;
        }
        state_->log.emplace_back(static_cast<int>(level), text);
    }
    state_->log_changed.notify_one();
}

std::vector<std::pair<int, std::string>> Interfacer::takeLog(double seconds) {
    std::unique_lock lock(state_->log_mutex);
    state_->log_changed.wait_for(lock, nanoseconds(seconds),
                                 [&] { return !state_->log.empty() || state_->log_ended; });
    std::vector<std::pair<int, std::string>> lines(state_->log.begin(), state_->log.end());
    state_->log.clear();
    if (const auto lost = std::exchange(state_->log_lost, 0); lost > 0)
        lines.emplace_back(static_cast<int>(LogLevel::Warning),
                           std::to_string(lost) + " older log lines were dropped");
    return lines;
}

}  // namespace axon::python
