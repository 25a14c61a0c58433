// SPDX-License-Identifier: MIT
#include "entity_interfacer/communicator.hpp"

#include <arpa/inet.h>
#include <axon/link.pb.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <iostream>
#include <utility>

#include "common/shared_clock.hpp"
#include "common/utf8.hpp"

namespace axon {

thread_local const Communicator* Communicator::this_thread_of = nullptr;

namespace {

using namespace std::chrono_literals;

constexpr std::uint32_t kProtocol = 1;
constexpr std::size_t kPendingMax = 32;
constexpr auto kHelloTime = 1s;
constexpr auto kLastWords = 300ms;
constexpr auto kSlack = 50ms;  // for a sign of life that has arrived and has not been read yet
constexpr int kStopPriority = 30;
constexpr int kWatchPriority = 29;
constexpr std::size_t kNameMax = 255;
constexpr std::size_t kNotesMax = 32;
constexpr auto kOutOfDescriptors = 100ms;
constexpr auto kStopAgain = 200ms;  // a stop callback that threw

/// Threads of the library leave signals to the application's own.
template <class Body>
std::thread quietThread(const char* name, Body body) {
    sigset_t all, former;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &former);
    std::thread thread(std::move(body));
    pthread_sigmask(SIG_SETMASK, &former, nullptr);
    pthread_setname_np(thread.native_handle(), name);
    return thread;
}

/// Tasks and whatever else a callback starts do not inherit it.
bool becomeRealTime(int priority) {
    sched_param param{};
    param.sched_priority = priority;
    return sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &param) == 0;
}

std::atomic<const WakeUp*> running_program{nullptr};  // run() of this process, for its signal handler
static_assert(std::atomic<const WakeUp*>::is_always_lock_free);

void onSignalOfProcess(int) {
    const int saved = errno;
    if (const auto* wake = running_program.load()) wake->wake();
    errno = saved;
}

std::chrono::milliseconds watchdogFrom(std::uint32_t ms, std::chrono::milliseconds usual) {
    if (ms == 0) return usual;
    return std::clamp(std::chrono::milliseconds{ms}, 20ms, 10000ms);
}

[[noreturn]] void misconfigured(const std::string& what) {
    throw Misconfiguration("axon: " + what);
}

std::shared_ptr<const Clock> clockOfProcess() {
    try {
        return clockFromEnvironment();
    } catch (const std::exception& error) {
        misconfigured(error.what());
    }
}

}  // namespace

Communicator::Communicator(EntityInterfacer::Options options)
    : options_(std::move(options)),
      clock_(options_.clock ? options_.clock : clockOfProcess()),
      reports_standstill_(options_.reports_standstill) {
    if (options_.application.empty() || options_.application.size() > kNameMax ||
        options_.instance.size() > kNameMax || validUtf8(options_.application) != options_.application ||
        validUtf8(options_.instance) != options_.instance)
        misconfigured(
            "Options::application, instance: expected the name with which the Entity Manager is configured, "
            "1 to 255 bytes of UTF-8, and an instance of at most 255; fix: correct them");
    address_ = options_.address;
    if (options_.ports_file.empty()) {
        const auto range =
            checkPortRange(options_.first_port, options_.last_port, "Options::first_port, last_port");
        if (!range) misconfigured(range.refusal().message);
        ports_ = range.value();
        auto users = LinkUsers::parse(options_.users, "Options::users");
        if (!users) misconfigured(users.refusal().message);
        users_ = std::move(users).value();
    } else {
        const auto file = readPorts(options_.ports_file);
        if (!file) misconfigured(file.refusal().message);
        ports_ = file->ports;
        users_ = file->users;
        address_ = file->address;
    }
    in_addr parsed{};
    if (inet_pton(AF_INET, address_.c_str(), &parsed) != 1)
        misconfigured("address '" + address_ +
                      "': expected an IPv4 address such as 127.0.0.1; fix: correct it");
    if (!options_.beyond_loopback && !isLoopback(address_))
        misconfigured("address " + address_ +
                      ": expected a loopback address (127.x.y.z), because the link has no authentication; "
                      "fix: use one, or set Options::beyond_loopback on a network that you trust");
}

Communicator::~Communicator() {
    shutdown();
}

Communicator::Callbacks& Communicator::settableCallbacks() {
    if (started_)
        throw std::logic_error(
            "axon: a callback or handler was set after start(); fix: set all of them before start() or "
            "run()");
    return callbacks_;
}

void Communicator::log(LogLevel level, const std::string& text) const {
    if (options_.logger) {
        try {
            options_.logger(level, text);
        } catch (...) {
            std::cerr << "axon: the logger threw while logging: " + text + "\n";
        }
        return;
    }
    static constexpr std::array names{"", "warning: ", "error: "};
    std::cerr << "axon: " + std::string(names.at(static_cast<std::size_t>(level))) + text + "\n";
}

void Communicator::note(LogLevel level, std::string text) {
    {
        const std::lock_guard lock(notes_mutex_);
        if (notes_.size() < kNotesMax) notes_.emplace_back(level, std::move(text));
    }
    data_wake_.wake();
}

void Communicator::logNotes() {
    std::vector<std::pair<LogLevel, std::string>> notes;
    {
        const std::lock_guard lock(notes_mutex_);
        notes.swap(notes_);
    }
    for (const auto& [level, text] : notes) log(level, text);
}

void Communicator::listen() {
    for (unsigned port = ports_.first; port <= ports_.last; ++port) {
        Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
        const int on = 1;
        ::setsockopt(socket.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);  // TIME_WAIT of a former run
        sockaddr_in where{};
        where.sin_family = AF_INET;
        where.sin_port = htons(static_cast<std::uint16_t>(port));
        inet_pton(AF_INET, address_.c_str(), &where.sin_addr);
        if (::bind(socket.get(), reinterpret_cast<const sockaddr*>(&where), sizeof where) == 0 &&
            ::listen(socket.get(), 128) == 0) {
            listener_ = std::move(socket);
            port_ = static_cast<std::uint16_t>(port);
            return;
        }
        if (errno != EADDRINUSE)
            misconfigured(
                "cannot listen on " + address_ + ":" + std::to_string(port) + ": " + std::strerror(errno) +
                "; expected an address of this machine; fix: correct Axon.Address or Options::address");
    }
    misconfigured("every port of " + std::to_string(ports_.first) + "-" + std::to_string(ports_.last) +
                  " on " + address_ +
                  " is in use; expected a free one; fix: widen the range in ports.cfg of both the "
                  "application and its Entity Manager");
}

void Communicator::start() {
    const std::lock_guard lock(shutdown_mutex_);
    if (shut_down_)
        throw std::logic_error(
            "axon: start() was called after shutdown(); fix: make another EntityInterfacer");
    if (started_) return;
    listen();
    started_ = true;
    stop_thread_ = quietThread("axon-stop", [this] { stopThread(); });
    watch_thread_ = quietThread("axon-watch", [this] { watchThread(); });
    data_thread_ = quietThread("axon-data", [this] { dataThread(); });
    log(LogLevel::Info, "'" + options_.application + "' waits for its Entity Manager on " + address_ + ":" +
                            std::to_string(port_));
}

void Communicator::run() {
    const WakeUp* none = nullptr;
    if (!running_program.compare_exchange_strong(none, &run_wake_))
        throw std::logic_error(
            "axon: run() was called while another run() of this process has not returned; fix: use start() "
            "for the second EntityInterfacer");
    struct sigaction action {
    }, former_int{}, former_term{};
    action.sa_handler = onSignalOfProcess;
    sigaction(SIGINT, &action, &former_int);
    sigaction(SIGTERM, &action, &former_term);
    const auto restore = [&] {
        sigaction(SIGINT, &former_int, nullptr);
        sigaction(SIGTERM, &former_term, nullptr);
        running_program = nullptr;
    };
    try {
        start();
    } catch (...) {
        restore();
        throw;
    }
    while (!quit_) {
        pollfd wait{run_wake_.fd(), POLLIN, 0};
        ::poll(&wait, 1, -1);
        if ((wait.revents & POLLIN) != 0) quit_ = true;
    }
    shutdown();
    restore();
}

void Communicator::quit() {
    quit_ = true;
    run_wake_.wake();
}

bool Communicator::onOwnThread() const {
    return this_thread_of == this;
}

void Communicator::shutdown() {
    if (onOwnThread()) return quit();
    const std::lock_guard lock(shutdown_mutex_);
    if (shut_down_.exchange(true) || !started_) return;
    ending_ = true;
    end_stop_thread_ = true;
    stop_wake_.wake();
    stop_thread_.join();

    const auto wait_for_handlers = [this](Duration time) {
        std::unique_lock tasks(tasks_mutex_);
        return task_ended_.wait_for(tasks, time, [this] {
            return std::all_of(tasks_.begin(), tasks_.end(),
                               [](const TaskThread& t) { return t.done->load(); });
        });
    };
    // Handlers that end at once may still say how; the link does not wait for the others.
    wait_for_handlers(kLastWords);
    end_watch_thread_ = true;
    watch_wake_.wake();
    watch_thread_.join();
    end_data_thread_ = true;
    data_wake_.wake();
    data_thread_.join();
    while (!wait_for_handlers(1s)) {
        const std::lock_guard tasks(tasks_mutex_);
        for (const auto& running : tasks_)
            if (!running.done->load())
                log(LogLevel::Warning, "shutting down waits for the handler of '" + running.task->service +
                                           "'; fix: return from it when stopRequested() is true");
    }
    reapTasks();
}

std::shared_ptr<Link> Communicator::currentLink() const {
    const std::lock_guard lock(link_mutex_);
    return link_;
}

void Communicator::publish(std::shared_ptr<Link> link) {
    const std::lock_guard lock(link_mutex_);
    link_.swap(link);
}

bool Communicator::linked() const {
    const auto link = currentLink();
    return link && !link->lost();
}

// The stop thread: reads the signal connection, calls onStop, nothing else.

void Communicator::stopThread() {
    this_thread_of = this;
    if (!becomeRealTime(kStopPriority))
        note(LogLevel::Info,
             "the stop thread runs with ordinary priority, because real-time scheduling is not permitted; "
             "fix: CAP_SYS_NICE or an rtprio limit allows it");
    unsigned faults_seen = 0;
    while (true) {
        std::array<pollfd, 2> wait{pollfd{stop_wake_.fd(), POLLIN, 0},
                                   pollfd{signal_link_ ? signal_link_->signalFd() : -1, POLLIN, 0}};
        int wait_ms = -1;
        if (owed_ && stop_failed_ && !level_.inside())  // whoever is inside wakes us
            wait_ms =
                static_cast<int>(std::max<std::int64_t>(clock_->realTimeUntil(call_again_) / 1ms + 1, 0));
        ::poll(wait.data(), wait.size(), wait_ms);
        if (signal_link_ && (wait[1].revents != 0 || signal_link_->lost())) readSignals(*signal_link_);
        if ((wait[0].revents & POLLIN) != 0) stop_wake_.drain();
        // What was running when the stop came has returned, and may have moved the robot last; or the
        // callback threw.
        if (owed_ && !level_.inside() && now() >= call_again_) callStop(*owed_);
        const auto faults = faults_.load();
        const bool fault = std::exchange(faults_seen, faults) != faults;
        // An Entity Manager that knew nothing of the fault would start the next task.
        if (fault && signal_link_) signal_link_->cut("the robot application has stopped itself");
        const bool lost = signal_link_ && signal_link_->lost();
        if (fault || lost) dispatchStop(fault ? StopSignal::Cause::Fault : StopSignal::Cause::LinkLost);
        if (lost) {
            signal_link_.reset();
            watch_wake_.wake();
            data_wake_.wake();
        }
        if (end_stop_thread_) {
            dispatchStop(StopSignal::Cause::Shutdown);
            // Really: a laboratory's time may stand.
            const SteadyClock real{};
            level_.waitUntil(real, real.now() + kLastWords, [this] { return !level_.inside(); });
            if (owed_) callStop(*owed_);
            this_thread_of = nullptr;
            return;
        }
        if (!signal_link_) {
            const std::lock_guard lock(signal_handover_mutex_);
            signal_link_ = std::move(signal_handover_);
            if (signal_link_) {
                baseline_known_ = false;
                level_.adopt(0);
                manager_.suspendGaps();  // no gap reaches from one link into the next
                signal_link_->epoch = level_.epoch();
                {
                    // Only now: data of this link is judged by this level.
                    const std::lock_guard data_lock(data_handover_mutex_);
                    data_handover_ = signal_link_;
                }
                data_wake_.wake();
            }
        }
    }
}

void Communicator::readSignals(Link& link) {
    std::array<char, 4096> buffer;
    std::string payload;
    bool ended = false;
    const auto deliver = [&] {
        proto::EmToEi message;
        while (link.signal_reader.next(payload)) {
            if (!message.ParseFromString(payload))
                return link.cut("malformed message on the signal connection");
            onSignal(link, message);
        }
        if (link.signal_reader.failed()) link.cut("signal connection: " + link.signal_reader.error());
    };
    while (!ended) {
        const auto got = ::recv(link.signalFd(), buffer.data(), buffer.size(), MSG_DONTWAIT);
        if (got > 0) {
            link.signal_reader.feed({buffer.data(), static_cast<std::size_t>(got)});
        } else if (got == 0) {
            link.cut("the Entity Manager has closed the link");
            ended = true;
        } else if (errno == EAGAIN) {
            ended = true;
        } else if (errno != EINTR) {
            link.cut(std::string("signal connection: ") + std::strerror(errno));
            ended = true;
        }
        deliver();
        if (link.lost()) ended = true;
    }
}

void Communicator::onSignal(Link& link, const proto::EmToEi& message) {
    if (message.has_stop()) {
        const auto& stop = message.stop();
        manager_.renew(now());
        if (stop.cause() == proto::STOP_DRILL) {
            proto::EiToEm done;
            done.mutable_stop_done()->set_drill(stop.drill());
            done.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
            link.sendSignal(done);
            return;
        }
        if (baseline_known_ && stop.stop_generation() <= level_.stopped())
            return owed_ ? void() : acknowledge(link, level_.stopped());
        baseline_known_ = true;
        level_.raise(stop.stop_generation(), stop.cause());
        return callStop({static_cast<StopSignal::Cause>(stop.cause()), stop.stop_generation()});
    }
    if (!message.has_beat())
        return link.cut("unexpected message on the signal connection: only beats and stops belong there");
    const auto& beat = message.beat();
    const bool other_pace = manager_.busy() != beat.busy();
    const auto time = now();
    manager_.setBusy(beat.busy(), time);
    manager_.resumeGaps(time);
    manager_.heard(time);
    if (other_pace) watch_wake_.wake();
    if (!baseline_known_) {
        baseline_known_ = true;
        level_.adopt(beat.stop_generation());
    } else if (beat.stop_generation() > level_.stopped()) {
        // The level says that a stop was given which has not arrived as such.
        level_.raise(beat.stop_generation(), proto::STOP_REQUESTED);
        callStop({StopSignal::Cause::Requested, beat.stop_generation()});
    }
}

void Communicator::dispatchStop(StopSignal::Cause cause) {
    level_.raiseEpoch(static_cast<int>(cause));
    callStop({cause, level_.stopped()});
}

void Communicator::callStop(const StopSignal& called) {
    const auto signal = called;  // it may be what is owed
    in_callback_ = true;
    level_.carryOut();
    std::string thrown;
    if (callbacks_.stop) {
        try {
            callbacks_.stop(signal);
        } catch (const std::exception& error) {
            thrown = "it threw: " + validUtf8(error.what());
        } catch (...) {
            thrown = "it threw something that is no std::exception";
        }
    }
    const bool over = thrown.empty() && !level_.inside();
    owed_ = over ? std::nullopt : std::optional(signal);
    call_again_ = thrown.empty() ? TimePoint{} : now() + kStopAgain;
    const bool failed_before = stop_failed_.exchange(!thrown.empty());
    if (over) level_.settle();
    manager_.renew(now());
    manager_.suspendGaps();  // nobody listened while the callback ran
    in_callback_ = false;
    if (!thrown.empty() && !failed_before)
        note(LogLevel::Error, "the stop callback has not stopped the robot (" + thrown +
                                  "); it is called again until it returns, and no task starts before that; "
                                  "fix: catch exceptions inside onStop");
    if (thrown.empty() && failed_before) note(LogLevel::Info, "the stop callback that threw has returned");
    const bool linked = signal_link_ && !signal_link_->lost();
    if (over) {
        if (linked) acknowledge(*signal_link_, level_.stopped());
        if (level_.acknowledged() && linked) tellStandstill(*signal_link_, level_.stopped());
        return;
    }
    if (!linked || thrown.empty()) return;
    proto::EiToEm message;
    message.mutable_stop_done()->set_stop_generation(level_.stopped());
    message.mutable_stop_done()->set_fault(thrown);
    signal_link_->sendSignal(message);
}

void Communicator::acknowledge(Link& link, std::uint32_t generation) {
    proto::EiToEm message;
    message.mutable_stop_done()->set_stop_generation(generation);
    message.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
    message.mutable_stop_done()->set_standstill_follows(reports_standstill_);
    link.sendSignal(message);
}

void Communicator::standstill() {
    reports_standstill_ = true;
    const auto generation = level_.rest();
    if (!generation) return;
    if (const auto link = currentLink()) tellStandstill(*link, *generation);
}

void Communicator::tellStandstill(Link& link, std::uint32_t generation) {
    proto::EiToEm message;
    message.mutable_stop_done()->set_stop_generation(generation);
    message.mutable_stop_done()->set_stage(proto::StopReceipt::STANDSTILL);
    link.sendSignal(message);
}

void Communicator::fault(const std::string& what, const std::function<void()>& last_words) {
    const auto link = currentLink();
    // Before the last words: what the Entity Manager sends when it hears them must not begin.
    if (link) link->condemn(what);
    if (last_words) last_words();
    faults_.fetch_add(1);
    if (link) link->cut(what);
    stop_wake_.wake();
    log(LogLevel::Error, what + ": stop");
}

// The watch thread: accepts, beats, watches for silence.

void Communicator::watchThread() {
    this_thread_of = this;
    becomeRealTime(kWatchPriority);
    std::vector<pollfd> wait;
    while (!end_watch_thread_) {
        if (watched_ && watched_->lost()) watched_.reset();
        const bool listening = accept_again_ <= now();
        wait.assign({{watch_wake_.fd(), POLLIN, 0}, {listening ? listener_.get() : -1, POLLIN, 0}});
        auto due = listening ? TimePoint::max() : accept_again_;
        if (watched_) due = std::min(due, next_beat_);
        for (const auto& pending : pending_) {
            wait.push_back({pending.socket.get(), POLLIN, 0});
            due = std::min(due, pending.deadline);
        }
        timespec timeout{};
        if (due != TimePoint::max()) {
            const auto left = std::max<Duration>(clock_->realTimeUntil(due), Duration::zero());
            timeout.tv_sec = left / 1s;
            timeout.tv_nsec = (left % 1s).count();
        }
        ::ppoll(wait.data(), wait.size(), due == TimePoint::max() ? nullptr : &timeout, nullptr);
        if (wait[0].revents != 0) {
            watch_wake_.drain();
            next_beat_ = std::min(next_beat_, now());  // the period may have become shorter
        }
        const auto polled = pending_.size();
        std::vector<bool> forget(polled, false);
        for (std::size_t i = 0; i < polled; ++i) {
            if (wait[i + 2].revents != 0) forget[i] = readHello(pending_[i]);
            if (pending_[i].deadline <= now()) forget[i] = true;
        }
        for (std::size_t i = polled; i-- > 0;)
            if (forget[i]) pending_.erase(pending_.begin() + static_cast<std::ptrdiff_t>(i));
        if (wait[1].revents != 0) accept();
        if (watched_ && next_beat_ <= now()) beat();
        if (watched_) checkSilence();
    }
    // The stop thread has ended: what it has settled stays so.
    if (watched_) watched_->cut("the robot application shuts down", level_.settled());
    pending_.clear();
    listener_.reset();
    this_thread_of = nullptr;
}

void Communicator::accept() {
    for (int burst = 0; burst < 64; ++burst) {
        Descriptor socket(::accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
        if (!socket.open()) {
            // The connection stays in the backlog, so that polling at once would spin.
            if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM)
                accept_again_ = now() + kOutOfDescriptors;
            return;
        }
        const int on = 1;
        ::setsockopt(socket.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
        if (pending_.size() >= kPendingMax) {
            // A half-linked Entity Manager is worth more than a stranger that has said nothing yet.
            auto oldest = std::find_if(pending_.begin(), pending_.end(),
                                       [](const Pending& p) { return p.nonce.empty(); });
            if (oldest == pending_.end()) return;
            pending_.erase(oldest);
        }
        pending_.emplace_back();
        pending_.back().socket = std::move(socket);
        pending_.back().deadline = now() + kHelloTime;
        if (readHello(pending_.back())) pending_.pop_back();  // its Hello is usually here already
    }
    watch_wake_.wake();
}

bool Communicator::readHello(Pending& pending) {
    std::array<char, kHelloMax> buffer;
    const auto got = ::recv(pending.socket.get(), buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (got == 0) return true;
    if (got < 0) return errno != EAGAIN && errno != EINTR;
    if (!pending.nonce.empty()) return true;  // nothing may be sent before both lanes are welcome
    pending.reader.feed({buffer.data(), static_cast<std::size_t>(got)});
    std::string payload;
    if (!pending.reader.next(payload)) {
        if (!pending.reader.failed()) return false;
        refuse(pending, RefusalCode::Malformed, "first frame: " + pending.reader.error());
        return true;
    }
    proto::EmToEi message;
    if (!message.ParseFromString(payload) || !message.has_hello()) {
        refuse(pending, RefusalCode::Malformed,
               "expected Hello as the first frame; fix: see docs/reference/ei-link.md");
        return true;
    }
    return onHello(pending, message.hello());
}

bool Communicator::onHello(Pending& pending, const proto::Hello& hello) {
    const auto no = [&](RefusalCode code, const std::string& message) {
        refuse(pending, code, message);
        return true;
    };
    if (hello.protocol() != kProtocol)
        return no(RefusalCode::NotSupported, "protocol " + std::to_string(hello.protocol()) +
                                                 ": expected 1; fix: use an Entity Manager of this version");
    if (hello.application() != options_.application)
        return no(RefusalCode::UnknownEntity,
                  "this is the robot application '" + options_.application +
                      "'; fix: correct the application's name in the Entity Manager's configuration, unless "
                      "its application listens on another port");
    if (!hello.instance().empty() && hello.instance() != options_.instance)
        return no(RefusalCode::UnknownEntity,
                  "this is instance '" + options_.instance + "' of '" + options_.application + "'");
    if (const auto stranger = users_.check(pending.socket.get()))
        return no(stranger->code, stranger->message);
    // Who links with us takes it that we have stopped.
    if (stop_failed_)
        return no(RefusalCode::WrongState, "the stop callback of '" + options_.application +
                                               "' throws and is called again until it returns; fix: repair "
                                               "what it stops, or restart the application");
    if (hello.nonce().size() < 8 || hello.nonce().size() > 64)
        return no(RefusalCode::Malformed, "nonce: expected 8 to 64 bytes, the same on both connections");
    if (watched_ && !watched_->lost())
        return no(RefusalCode::AlreadyHeld, "'" + options_.application +
                                                "' is linked with another Entity Manager (" +
                                                watched_->manager + "); fix: end that one first");
    const auto half =
        std::find_if(pending_.begin(), pending_.end(), [](const Pending& p) { return !p.nonce.empty(); });
    if (hello.lane() == proto::LANE_SIGNAL) {
        if (half != pending_.end())
            return no(RefusalCode::AlreadyHeld, "another Entity Manager (" + half->manager +
                                                    ") is linking with '" + options_.application + "'");
        pending.nonce = hello.nonce();
        pending.manager = hello.manager();
        pending.busy = watchdogFrom(hello.watchdog_busy_ms(), 250ms);
        pending.idle = watchdogFrom(hello.watchdog_idle_ms(), 500ms);
        welcome(pending, hello, nullptr);
        return false;
    }
    if (hello.lane() != proto::LANE_DATA)
        return no(RefusalCode::Malformed, "lane: expected LANE_SIGNAL or LANE_DATA");
    if (half == pending_.end()) return no(RefusalCode::WrongState, "expected the signal connection first");
    if (half->nonce != hello.nonce())
        return no(RefusalCode::AlreadyHeld, "another Entity Manager (" + half->manager +
                                                ") is linking with '" + options_.application + "'");
    welcome(pending, hello, nullptr);
    watched_ =
        std::make_shared<Link>(std::move(half->socket), std::move(half->reader), std::move(pending.socket),
                               std::move(pending.reader), half->manager, data_wake_);
    // The half itself goes at its deadline; without a nonce it reserves nothing, without a socket it reads
    // nothing.
    half->nonce.clear();
    half->deadline = now();
    manager_.setTimeouts(half->busy, half->idle, now());
    manager_.setBusy(false, now());
    manager_.suspendGaps();  // until the first beat
    next_beat_ = now();
    {
        const std::lock_guard lock(signal_handover_mutex_);
        signal_handover_ = watched_;
    }
    stop_wake_.wake();
    return true;
}

void Communicator::refuse(Pending& pending, RefusalCode code, const std::string& message) {
    proto::Refusal refusal;
    refusal.set_code(static_cast<proto::RefusalCode>(code));
    refusal.set_message(message);
    welcome(pending, proto::Hello{}, &refusal);
}

void Communicator::welcome(Pending& pending, const proto::Hello& hello, const proto::Refusal* refusal) {
    proto::EiToEm message;
    auto& welcome = *message.mutable_welcome();
    welcome.set_protocol(kProtocol);
    welcome.set_application(options_.application);
    welcome.set_instance(options_.instance);
    welcome.set_lane(hello.lane());
    welcome.set_nonce(hello.nonce());
    if (refusal != nullptr) *welcome.mutable_refusal() = *refusal;
    std::string frame;
    appendFrame(frame, message.SerializeAsString());
    [[maybe_unused]] const auto sent =
        ::send(pending.socket.get(), frame.data(), frame.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
}

void Communicator::beat() {
    const bool busy = manager_.busy();
    next_beat_ = now() + manager_.timeout() / 5;
    proto::EiToEm message;
    auto& beat = *message.mutable_beat();
    beat.set_sequence(++beat_sequence_);
    beat.set_busy(busy);
    beat.set_stop_generation(level_.stopped());
    beat.set_stopped(level_.settled());
    const auto gap = manager_.longest(now());
    beat.set_longest_gap_ms(
        static_cast<std::uint32_t>(std::chrono::ceil<std::chrono::milliseconds>(gap.length).count()));
    beat.set_allowed_ms(
        static_cast<std::uint32_t>(std::chrono::ceil<std::chrono::milliseconds>(gap.allowed).count()));
    watched_->sendSignal(message);
}

void Communicator::checkSilence() {
    if (in_callback_) return;  // the stop thread cannot listen while the application's callback has it
    const auto time = now();
    const auto deadline = manager_.deadline();
    const auto timeout = std::chrono::duration_cast<std::chrono::milliseconds>(manager_.timeout());
    if (time < deadline) {
        if (time >= manager_.lateFrom() && time >= slow_warn_again_) {
            slow_warn_again_ = time + Liveness::kWarnAgain;
            note(LogLevel::Warning,
                 "heartbeats of the Entity Manager come late (after more than half of the watchdog's " +
                     std::to_string(timeout.count()) + " ms); this machine is overloaded");
        }
        next_beat_ = std::min(next_beat_, deadline);
        return;
    }
    int unread = 0;
    if (time < deadline + kSlack && ::ioctl(watched_->signalFd(), FIONREAD, &unread) == 0 && unread > 0) {
        next_beat_ = std::min(next_beat_, time + 2ms);
        return;
    }
    watched_->cut("the Entity Manager has been silent for " + std::to_string(timeout.count()) +
                  " ms; it hangs, or this machine is overloaded");
    stop_wake_.wake();
}

}  // namespace axon
