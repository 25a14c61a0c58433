// SPDX-License-Identifier: MIT
#include "entity_interfacer/communicator.hpp"

#include <arpa/inet.h>
#include <axon/link.pb.h>
#include <fcntl.h>
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
#include <span>
#include <utility>

#include "common/shared_clock.hpp"
#include "common/utf8.hpp"

namespace axon {

thread_local const Communicator* Communicator::this_thread_of = nullptr;

namespace {

using namespace std::chrono_literals;

constexpr auto kLastWords = 300ms;
constexpr auto kSlack = 50ms;  // for a sign of life that has arrived and has not been read yet
constexpr int kStopPriority = 30;
constexpr int kWatchPriority = 29;
constexpr std::size_t kNameMax = 255;
constexpr std::size_t kNotesMax = 32;
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
      reports_standstill_(options_.reports_standstill),
      handshakes_(*clock_, *this, options_.application, options_.instance) {
    if (options_.application.empty() || options_.application.size() > kNameMax ||
        options_.instance.size() > kNameMax || validUtf8(options_.application) != options_.application ||
        validUtf8(options_.instance) != options_.instance)
        misconfigured(
            "Options::application, instance: expected the name with which the Entity Manager is configured, "
            "1 to 255 bytes of UTF-8, and an instance of at most 255; fix: correct them");
    where_.address = options_.address;
    if (options_.ports_file.empty()) {
        const auto range =
            checkPortRange(options_.first_port, options_.last_port, "Options::first_port, last_port");
        if (!range) misconfigured(range.refusal().message);
        where_.ports = range.value();
        auto users = LinkUsers::parse(options_.users, "Options::users");
        if (!users) misconfigured(users.refusal().message);
        where_.users = std::move(users).value();
    } else {
        const auto file = readPorts(options_.ports_file);
        if (!file) misconfigured(file.refusal().message);
        where_ = file.value();
    }
    in_addr parsed{};
    if (inet_pton(AF_INET, where_.address.c_str(), &parsed) != 1)
        misconfigured("address '" + where_.address +
                      "': expected an IPv4 address such as 127.0.0.1; fix: correct it");
    if (!options_.beyond_loopback && !isLoopback(where_.address))
        misconfigured("address " + where_.address +
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

void Communicator::start() {
    const std::lock_guard lock(shutdown_mutex_);
    if (shut_down_)
        throw std::logic_error(
            "axon: start() was called after shutdown(); fix: make another EntityInterfacer");
    if (started_) return;
    port_ = handshakes_.listen(where_);
    started_ = true;
    stop_thread_ = quietThread("axon-stop", [this] { stopThread(); });
    watch_thread_ = quietThread("axon-watch", [this] { watchThread(); });
    data_thread_ = quietThread("axon-data", [this] { dataThread(); });
    log(LogLevel::Info, "'" + options_.application + "' waits for its Entity Manager on " + where_.address +
                            ":" + std::to_string(port_));
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
    tasks_.startNoMore();
    end_stop_thread_ = true;
    stop_wake_.wake();
    stop_thread_.join();

    // Handlers that end at once may still say how; the link does not wait for the others.
    tasks_.waitForAll(kLastWords);
    end_watch_thread_ = true;
    watch_wake_.wake();
    watch_thread_.join();
    end_data_thread_ = true;
    data_wake_.wake();
    data_thread_.join();
    while (!tasks_.waitForAll(1s))
        for (const auto& service : tasks_.services())
            log(LogLevel::Warning, "shutting down waits for the handler of '" + service +
                                       "'; fix: return from it when stopRequested() is true");
    tasks_.reap();
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
    bool ended = false;
    const auto deliver = [&] {
        proto::EmToEi message;
        while (const auto payload = link.signal_reader.nextView()) {
            if (!message.ParseFromArray(payload->data(), static_cast<int>(payload->size())))
                return link.cut("malformed message on the signal connection");
            onSignal(link, message);
        }
        if (link.signal_reader.failed()) link.cut("signal connection: " + link.signal_reader.error());
    };
    while (!ended) {
        const auto room = link.signal_reader.room();
        const auto got = ::recv(link.signalFd(), room.data(), room.size(), MSG_DONTWAIT);
        if (got > 0) {
            link.signal_reader.filled(static_cast<std::size_t>(got));
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
        wait.assign(1, {watch_wake_.fd(), POLLIN, 0});
        auto due = handshakes_.awaitAt(now(), wait);
        if (watched_) due = std::min(due, next_beat_);
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
        if (handshakes_.handle(std::span(wait).subspan(1))) watch_wake_.wake();
        if (watched_ && next_beat_ <= now()) beat();
        if (watched_) checkSilence();
    }
    // The stop thread has ended: what it has settled stays so.
    if (watched_) watched_->cut("the robot application shuts down", level_.settled());
    handshakes_.close();
    this_thread_of = nullptr;
}

std::optional<std::string> Communicator::linkedWith() const {
    if (!watched_ || watched_->lost()) return std::nullopt;
    return watched_->manager;
}

void Communicator::linkWith(Handshakes::Pair pair) {
    watched_ =
        std::make_shared<Link>(std::move(pair.signal), std::move(pair.signal_reader), std::move(pair.data),
                               std::move(pair.data_reader), pair.manager, data_wake_);
    if (auto text = releases_.onPeer("an Entity Manager", pair.release))
        note(LogLevel::Info, std::move(*text));
    manager_.setTimeouts(pair.watchdog_busy, pair.watchdog_idle, now());
    manager_.setBusy(false, now());
    manager_.suspendGaps();  // until the first beat
    next_beat_ = now();
    {
        const std::lock_guard lock(signal_handover_mutex_);
        signal_handover_ = watched_;
    }
    stop_wake_.wake();
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
