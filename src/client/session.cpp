// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/session.hpp"

#include <axon/messages.pb.h>
#include <pwd.h>
#include <spdlog/logger.h>
#include <unistd.h>

#include <algorithm>
#include <stdexcept>

#include "client/content.hpp"
#include "client/log.hpp"
#include "common/shared_clock.hpp"
#include "common/waiting.hpp"
#include "messages/values.hpp"
#include "transport/communicator.hpp"
#include "transport/routed_session.hpp"
#include "transport/tls.hpp"

namespace axon::client {
namespace {

using namespace std::chrono_literals;

/// Of the session whose core's lock this thread holds by withCore().
thread_local const void* in_core = nullptr;

constexpr Duration kFirstBackoff = 100ms;
constexpr Duration kLastBackoff = 2s;
/// No thread sleeps longer than this; a time far away is a wait_until that may overflow.
constexpr Duration kLongestSleep = 1h;
constexpr std::size_t kChunkBytes = 64 * 1024;
/// Larger messages gain nothing by a common system call. With the overhead that admission counts.
constexpr std::size_t kTogetherBytes = 4 * 1024 + kMessageOverhead;
/// Messages that follow each other sooner than this are a burst: sending one takes 10 to 20 us.
constexpr Duration kFast = 100us;
/// About thirty small messages.
constexpr std::size_t kLeftToSender = 32 * 1024;
constexpr std::size_t kMessageBytesMax = (transport::kMessageSizeMaxKib - 64) * 1024ULL;
constexpr Duration kReleaseTime = 1s;
/// A drill that has not come back by then never arrived.
constexpr Duration kDrillTime = 1s;

Duration toDuration(Seconds seconds) {
    // Up to a day: what is longer would overflow sums with the clock.
    return std::chrono::duration_cast<Duration>(std::clamp(seconds, Seconds{0}, Seconds{86400}));
}

CoreSettings settingsOf(const Options& options) {
    CoreSettings settings;
    settings.timeout = std::max<Duration>(toDuration(options.timeout), 1ms);
    settings.resume = options.resume && options.reconnect;
    return settings;
}

/// Of a router's endpoints, those that the credentials fit.
Options settled(Options options) {
    if (transport::isRouter(options.server))
        options.server = transport::wayToRouter(options.server, transport::speaksTls(options.properties));
    return options;
}

/// What others see as the holder when the program does not say: user@host.
std::string userAtHost() {
    const passwd* user = ::getpwuid(::geteuid());
    char host[256] = "";
    ::gethostname(host, sizeof host - 1);
    return std::string(user != nullptr ? user->pw_name : std::to_string(::geteuid())) + '@' + host;
}

}  // namespace

Client::Session::Session(Options options, std::shared_ptr<const Clock> clock)
    : options_(settled(std::move(options))),
      time_(std::move(clock)),
      core_(settingsOf(options_), clock_, random_, *this, *this, marks_),
      direct_(clock_, static_cast<std::size_t>(std::max(options_.direct_paths, 0)),
              [this](const DirectOffer& offer) {
                  const auto connection = connection_.load();
                  return std::make_shared<IceDirectPath>(
                      data_, signal_, offer, Id128::random(random_),
                      connection ? connection->backlog() : std::make_shared<Backlog>(), clock_,
                      weak_from_this());
              }),
      desk_(clock_, *this, marks_),
      ways_(
          [this](Operation kind, const Header& head, std::string bytes) {
              if (const auto connection = connection_.load()) connection->send(kind, head, std::move(bytes));
          },
          [this] { heartbeat_.wake(); }) {}

Client::Session::~Session() {
    close();
}

// ---- locks, and what leaves them

template <class Use>
auto Client::Session::withCore(Use&& use, Sends sends) {
    struct Leave {
        Session& session;
        std::unique_lock<std::mutex> lock;
        const Sends sends;
        const std::uint64_t before = session.outgoing_.last();
        ~Leave() {
            const auto last = session.outgoing_.last();
            const auto deadline = std::min(session.core_.nextDeadline(), session.core_.serverDeadline());
            const auto heartbeat = session.core_.nextHeartbeat();
            const bool wake_timer = deadline < session.timer_at_;
            const bool wake_heartbeat = heartbeat < session.heartbeat_at_;
            if (wake_timer) session.timer_at_ = deadline;
            if (wake_heartbeat) session.heartbeat_at_ = heartbeat;
            const bool here = last != before && sends == Sends::Here && !session.leavesToSender();
            const bool posted = std::exchange(session.posted_, false);
            in_core = nullptr;
            lock.unlock();
            if (posted) session.callbacks_.wake();
            if (last != before) {
                if (here) {
                    session.flush(last);
                } else {
                    session.sender_.wake();
                }
            }
            if (wake_timer) session.timer_.wake();
            if (wake_heartbeat) session.heartbeat_.wake();
        }
    };
    const Leave leave{*this, std::unique_lock(core_mutex_), sends};
    in_core = this;
    return use(core_);
}

template <class Use>
void Client::Session::onCore(std::uint64_t attempt, Use&& use) {
    withCore(
        [&](SessionCore& core) {
            if (attempt == listening_) use(core);
            sent_at_ = {};
        },
        Sends::Sender);
}

template <class Use>
auto Client::Session::withDesk(Use&& use) {
    struct Leave {
        Session& session;
        std::unique_lock<std::mutex> lock;
        ~Leave() {
            const auto deadline = session.desk_.nextDeadline();
            const bool wake = deadline < session.stops_at_;
            if (wake) session.stops_at_ = deadline;
            const auto stops = std::exchange(session.stops_, {});
            lock.unlock();
            if (!stops.empty()) {
                const auto paths = session.direct_.paths();
                const auto connection = session.signal_connection_.load();
                for (const auto& stop : stops) {
                    // One message to the servers reaches many sooner than one to each.
                    const bool one = stop.entities.empty() ? !stop.head.entity.empty() : stop.entities.size() == 1;
                    const auto directly = [&] {
                        if (stop.lane == Lane::Signal)
                            DirectLinks::stop(*paths, stop.head, stop.entities, stop.cause);
                    };
                    if (one) directly();
                    if (connection && stop.entities.empty()) connection->sendStopSignal(stop.lane, stop.head, stop.cause);
                    if (connection && !stop.entities.empty()) connection->sendStopSignals(stop.lane, stop.head, stop.entities, stop.cause);
                    if (!one) directly();
                }
                for (const auto& stop : stops) {
                    // A datagram is a stop: a drill is none.
                    if (stop.lane != Lane::Signal || stop.cause == StopCause::Drill) continue;
                    if (stop.entities.empty()) {
                        session.datagrams_.stop(stop.head.entity, stop.head.sequence,
                                                stop.head.stop_generation);
                    }
                    for (const auto& entity : stop.entities)
                        session.datagrams_.stop(entity, stop.head.sequence, session.marks_.of(entity));
                }
            }
            if (wake) session.stop_timer_.wake();
        }
    };
    const Leave leave{*this, std::unique_lock(desk_mutex_)};
    return use(desk_);
}

template <class Answer, class Ask>
Answer Client::Session::ask(Ask&& ask) {
    mayWait();
    auto promise = std::make_shared<std::promise<Answer>>();
    auto future = promise->get_future();
    withCore([&](SessionCore& core) {
        ask(core, [promise](Answer answer) { promise->set_value(std::move(answer)); });
        sent_at_ = {};
    });
    return future.get();
}

/// Who sends fast, without waiting for answers, leaves little messages to the sender's thread, which writes those together
/// that came while it wrote. When that one does not keep up, the caller writes them all.
bool Client::Session::leavesToSender() {
    const auto now = clock_.now();
    const bool fast = now - std::exchange(sent_at_, now) < kFast;
    return fast && last_bytes_ <= kTogetherBytes && outgoing_.waiting().bytes < kLeftToSender;
}

/// Up to the message `ticket`; one thread at a time, so the order of the core is the order on the wire.
void Client::Session::flush(std::uint64_t ticket) {
    const std::lock_guard sending(send_mutex_);
    std::optional<ServerConnection::Part> part;
    for (auto item = outgoing_.take(ticket); item;) {
        auto next = outgoing_.take(ticket);
        auto& message = item->message;
        if (ways_.concerns(message))
            part.reset();  // what may go by the servers now comes behind what was added
        if (ways_.takes(message)) {
            outgoing_.sent(item->bytes);
            item = std::move(next);
            continue;
        }
        const auto connection = connection_.load();
        const bool joins = item->bytes <= kTogetherBytes && message.kind != Operation::Reset &&
                           message.kind != Operation::Clear;
        if (part && (!joins || part->of() != connection.get())) part.reset();
        if (connection && joins && (part || next)) {
            if (!part) part.emplace(connection);
            part->add(message.kind, message.head, std::move(message.bytes));
        } else if (connection) {
            connection->send(message.kind, message.head, std::move(message.bytes));
        }
        outgoing_.sent(item->bytes);
        item = std::move(next);
    }
}

void Client::Session::put(Operation kind, const Header& head, std::string bytes) {
    const auto size = bytes.size() + kMessageOverhead;
    outgoing_.put({kind, head, std::move(bytes), direct_.linkOf(head.entity)}, size);
    last_bytes_ = size;
    if (kind == Operation::Reset || kind == Operation::Clear) sent_at_ = {};  // signals are left to nobody
}
void Client::Session::sendToEntity(const Header& head, std::string bytes) {
    put(Operation::ToEntity, head, std::move(bytes));
}
void Client::Session::sendToEntityDataSeq(const Header& head, std::string bytes) {
    put(Operation::ToEntityDataSeq, head, std::move(bytes));
}
void Client::Session::sendRequest(const Header& head, std::string bytes) {
    put(Operation::Request, head, std::move(bytes));
}
void Client::Session::sendReset(const Header& head) {
    put(Operation::Reset, head, {});
}
void Client::Session::sendClear(const Header& head) {
    put(Operation::Clear, head, {});
}
void Client::Session::keepAlive(std::int64_t sequence, bool busy) {
    beat_ = {sequence, busy};
}

void Client::Session::sendStopSignal(Lane lane, const Header& head, StopCause cause) {
    stops_.push_back({lane, head, {}, cause});
}

void Client::Session::sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                                      StopCause cause) {
    stops_.push_back({lane, head, std::move(entities), cause});
}

void Client::Session::mayWait() const {
    if (callbacks_.isThisThread()) {
        throw std::logic_error(
            "axon::client: a call that waits was made from a callback, which would wait for itself. Make it "
            "from "
            "another thread.");
    }
}

Refusal Client::Session::admit(std::size_t bytes) const {
    if (bytes > kMessageBytesMax) {
        return {RefusalCode::TooLarge,
                "A message holds at most " + std::to_string(kMessageBytesMax) +
                    " bytes. Send it in pieces, or upload it as a resource.",
                {}};
    }
    auto waiting = outgoing_.waiting();
    if (const auto connection = connection_.load()) {
        waiting.messages += connection->waiting();
        waiting.bytes += connection->waitingBytes();
    }
    return admission(waiting.messages, waiting.bytes, bytes);
}

void Client::Session::awaitRoom(Seconds wait) const {
    if (const auto connection = connection_.load()) connection->awaitRoom(toDuration(wait));
}

void Client::Session::Alarm::start(const char* name, Lane lane, const Clock& clock,
                                   std::function<TimePoint()> tick) {
    const std::lock_guard lock(mutex_);
    thread_ = std::make_unique<transport::TimerThread>(name, lane, Duration{}, clock, std::move(tick));
}

void Client::Session::Alarm::wake() {
    const std::lock_guard lock(mutex_);
    if (thread_) thread_->wake();
}

void Client::Session::Alarm::end() {
    std::unique_ptr<transport::TimerThread> ended;
    {
        const std::lock_guard lock(mutex_);
        ended = std::move(thread_);
    }
}

// ---- connection

Result<void> Client::Session::connect() {
    try {
        const auto milliseconds = std::max<long long>(
            1, std::chrono::duration_cast<std::chrono::milliseconds>(toDuration(options_.timeout)).count());
        auto properties = options_.properties;
        properties["Ice.Override.ConnectTimeout"] = std::to_string(milliseconds);
        const auto& server = options_.server;
        const bool tls = transport::isRouter(server) ? transport::isTlsRouter(server)
                                                     : transport::parseEndpoint(server).tls;
        if (tls && !transport::speaksTls(properties))
            return Refusal{RefusalCode::Malformed, transport::certificateMissing(server, "client"), {}};
        data_communicator_ = transport::makeCommunicator({"axon-client", Lane::Data, 1, 1, properties});
        signal_communicator_ = transport::makeCommunicator(
            {"axon-signal", Lane::Signal, 1, 1, properties, transport::kReceiptPriority});
        for (auto [home, holder] :
             {std::pair{&data_, &data_communicator_}, {&signal_, &signal_communicator_}}) {
            home->communicator = holder->communicator();
            home->adapter = home->communicator->createObjectAdapter("");
            home->adapter->activate();
            if (transport::isRouter(server))
                home->router = transport::routerProxy(*home->communicator, server);
        }
    } catch (const std::invalid_argument& error) {
        return Refusal{RefusalCode::Malformed, error.what(), {}};
    } catch (const std::exception& error) {
        return Refusal{RefusalCode::Internal, error.what(), {}};
    }
    sender_.start("axon-sender", Lane::Data, clock_, [this] {
        {
            const std::lock_guard sending(send_mutex_);
            ways_.fallBackFromEnded();
        }
        flush(outgoing_.last());
        return clock_.now() + kLongestSleep;
    });
    const auto established = establish();
    if (!established) {
        auto refusal = established.refusal();
        // A port of TLS waits for the other side to begin, and so does a client of TCP.
        if (refusal.code == RefusalCode::TimedOut && !data_.router &&
            !transport::parseEndpoint(options_.server).tls)
            refusal.message += " Or is TLS spoken there (ssl://HOST:PORT)?";
        if (refusal.code == RefusalCode::NotConnected || refusal.code == RefusalCode::TimedOut) {
            refusal.code = RefusalCode::Unavailable;
        }
        refusal.message =
            (data_.router ? "No session through the router " : "No session with the server at ") +
            options_.server + ": " + refusal.message;
        return refusal;
    }
    timer_.start("axon-timer", Lane::Signal, clock_, [this] { return onTimer(); });
    heartbeat_.start("axon-heartbeat", Lane::Signal, clock_, [this] { return onHeartbeat(); });
    stop_timer_.start("axon-stops", Lane::Signal, clock_, [this] { return onStopTimer(); });

    if (!options_.await_entities) return {};
    // The entities that are there are pushed at once; a client that has just connected should know them.
    std::unique_lock lock(core_mutex_);
    entities_changed_.wait_for(lock, std::chrono::nanoseconds(toDuration(options_.timeout)),
                               [this] { return core_.complete() || !up_; });
    return {};
}

Result<void> Client::Session::establish() {
    Login login;
    if (data_.router) {
        login.endpoint.tls = transport::isTlsRouter(options_.server);
    } else {
        login.endpoint = transport::parseEndpoint(options_.server);
    }
    login.user = options_.user;
    login.password = options_.password;
    login.display_name = options_.display_name.empty() ? userAtHost() : options_.display_name;
    login.timeout = settingsOf(options_).timeout;
    {
        const std::lock_guard lock(core_mutex_);
        login.attempt = ++attempt_;
        listening_ = login.attempt;
    }
    const auto opened = ServerConnection::open(data_, signal_, login, shared_from_this());
    Refusal failure;
    if (!opened) {
        failure = opened.refusal();
    } else {
        const auto& connection = opened.value();
        connection_.store(connection);
        signal_connection_.store(connection);
        withDesk([&](StopDesk& desk) { desk.onConnected(connection->me()); });
        withCore(
            [&](SessionCore& core) {
                if (listening_ != login.attempt || closing_) {
                    failure = {RefusalCode::NotConnected, "the connection ended during the login", {}};
                    return;
                }
                up_ = true;
                core.onConnected(connection->me(), connection->entities(), connection->watchdogs());
            },
            Sends::Sender);
    }
    if (failure.ok()) return {};
    const auto connection = connection_.load();
    connection_.store(nullptr);
    signal_connection_.store(nullptr);
    if (connection) connection->drop();
    withCore(
        [&](SessionCore& core) {
            listening_ = 0;
            core.onDisconnected(failure.message);  // forgets the profiles that came before the failure
        },
        Sends::Sender);
    withDesk([](StopDesk& desk) { desk.onDisconnected(); });
    return failure;
}

void Client::Session::closed(std::uint64_t attempt, const std::string& reason) {
    lost(attempt, reason);
}

void Client::Session::lost(std::uint64_t attempt, const std::string& reason) {
    bool counts = false;
    DirectLinks::Closing closing;
    withCore(
        [&](SessionCore& core) {
            if (attempt != listening_) return;
            listening_ = 0;  // nothing of this connection counts any more
            counts = up_;
            if (!up_) return;
            up_ = false;
            outgoing_.clear();
            core.onDisconnected(reason);
            closing = direct_.clear();
        },
        Sends::Sender);
    close(closing, "the session with the server is lost");
    if (!counts) return;
    withDesk([](StopDesk& desk) { desk.onDisconnected(); });
    const auto connection = connection_.load();
    connection_.store(nullptr);
    signal_connection_.store(nullptr);
    if (connection) connection->drop();
    entities_changed_.notify_all();
    tellConnection(false, reason);
    if (options_.reconnect && !closing_) {
        retry_ = true;
        timer_.wake();
    }
}

/// The Entity Manager has the stop: its stage, by another way.
void Client::Session::acknowledgedByDatagram(const radio::StopRepeater::Acknowledged& acknowledged) {
    proto::StopReceipt receipt;
    receipt.set_stop_id(acknowledged.sender.toString() + ':' + std::to_string(acknowledged.sequence));
    receipt.set_stage(proto::StopReceipt::MANAGER);
    receipt.set_stop_generation(acknowledged.generation);
    withDesk([&](StopDesk& desk) { desk.onReceipt(acknowledged.entity, receipt); });
}

void Client::Session::tellConnection(bool connected, const std::string& reason) {
    std::function<void(bool, const std::string&)> tell;
    {
        const std::lock_guard lock(callbacks_mutex_);
        tell = on_connection_;
    }
    if (tell) post([tell, connected, reason] { tell(connected, reason); }, false);
}

void Client::Session::close() {
    std::call_once(closed_once_, [this] {
        mayWait();
        closing_ = true;
        // Orderly: each entity held stops and is free before the session ends.
        std::vector<std::future<Result<void>>> released;
        withCore([&](SessionCore& core) {
            for (const auto& held : core.held()) {
                auto promise = std::make_shared<std::promise<Result<void>>>();
                released.push_back(promise->get_future());
                check_outs_.erase(held);
                core.release(held, [promise](Result<void> answer) { promise->set_value(std::move(answer)); });
            }
        });
        const auto until = std::chrono::steady_clock::now() + kReleaseTime;
        for (auto& answer : released) answer.wait_until(until);
        flush(outgoing_.last());  // what was left to the sender: the end of a check-out that was refused, for one

        const auto connection = connection_.load();
        bool was_up = false;
        DirectLinks::Closing closing;
        withCore([&](SessionCore& core) {
            listening_ = 0;
            was_up = std::exchange(up_, false);
            core.onDisconnected("this client was closed", true);
            closing = direct_.clear();
        });
        close(closing, "this client was closed");
        withDesk([](StopDesk& desk) {
            desk.onDisconnected();
            desk.endOrders();
        });
        connection_.store(nullptr);
        signal_connection_.store(nullptr);
        entities_changed_.notify_all();
        if (connection && was_up) connection->leave();
        callbacks_.close();
        // Joins Ice's threads, and ends a login that the timer thread may be waiting for.
        for (auto* holder : {&data_communicator_, &signal_communicator_}) {
            if (holder->communicator()) holder->communicator()->destroy();
        }
        sender_.end();
        timer_.end();
        heartbeat_.end();
        stop_timer_.end();
        datagrams_.close();
    });
}

// ---- time

TimePoint Client::Session::onTimer() {
    std::uint64_t silent = 0;
    withCore(
        [&](SessionCore& core) {
            timer_at_ = TimePoint::min();  // this thread is awake: no need to wake it
            core.onTimer();
            if (core.serverSilent()) silent = listening_;
        },
        Sends::Sender);
    if (silent != 0) lost(silent, "the server has been silent for too long");
    const auto direct_at = directTurn();
    if (give_up_.exchange(false)) lost(listening_, "this program does not return from its callbacks");

    if (retry_.exchange(false)) {
        backoff_ = kFirstBackoff;
        retry_at_ = clock_.now() + backoff_;
    }
    if (clock_.now() >= retry_at_ && !closing_) {
        const auto established = establish();
        if (established) {
            retry_at_ = TimePoint::max();
            tellConnection(true, "connected again");
        } else {
            backoff_ = std::min(backoff_ * 2, kLastBackoff);
            retry_at_ = clock_.now() + backoff_;
        }
    }
    const std::lock_guard lock(core_mutex_);
    timer_at_ =
        std::min({core_.nextDeadline(), core_.serverDeadline(), retry_at_, direct_at, clock_.now() + kLongestSleep});
    return timer_at_;
}

TimePoint Client::Session::directTurn() {
    DirectLinks::Turn turn;
    withCore(
        [&](SessionCore& core) {
            turn = direct_.turn();
            for (const auto& [link, path] : turn.begun) {
                proto::ToEntity mark;
                mark.mutable_way()->set_path(path->number().bytes());
                Header head;
                head.sender = core.self();
                head.entity = path->entity();
                head.msg_type = kMsgWay;
                head.sequence = marks_.nextSequence();
                head.sent_at_us = toMicroseconds(clock_.now());
                auto bytes = mark.SerializeAsString();
                const auto size = bytes.size() + kMessageOverhead;
                outgoing_.put({Operation::ToEntity, head, std::move(bytes), link, path}, size);
            }
        },
        Sends::Sender);
    for (const auto& [matters, text] : turn.news)
        log().log(matters ? spdlog::level::info : spdlog::level::debug, "client: {}", text);
    if (turn.ended) sender_.wake();
    for (const auto& path : turn.begun) path.second->beat();
    for (const auto& path : turn.open) path->open(settingsOf(options_).timeout);
    if (turn.close.empty()) return turn.next;
    for (const auto& [path, why] : turn.close) path->close(why);
    return clock_.now();  // another turn, in which they have ended
}

void Client::Session::close(const DirectLinks::Closing& closing, const std::string& why) {
    for (const auto& path : closing) path->close(why);
}

TimePoint Client::Session::onHeartbeat() {
    std::optional<std::pair<std::int64_t, bool>> beat;
    std::vector<std::pair<std::shared_ptr<DirectPath>, bool>> paths;  // and whether the entity moves
    withCore(
        [&](SessionCore& core) {
            heartbeat_at_ = TimePoint::min();
            core.onHeartbeatTimer();
            beat = std::exchange(beat_, std::nullopt);
            if (!core.busy()) may_beat_ = true;  // nobody asks the program then
            for (const auto& [entity, path] : *direct_.paths()) paths.emplace_back(path, core.moving(entity));
        },
        Sends::Sender);
    if (beat) {
        may_beat_ = true;
        if (beat->second && options_.keep_running) {
            try {
                may_beat_ = options_.keep_running();
            } catch (const std::exception& error) {
                log().warn("client: keep_running threw, which counts as no: {}", error.what());
                may_beat_ = false;
            }
        }
        const auto connection = signal_connection_.load();
        if (may_beat_ && connection) connection->keepAlive(beat->first);
    }
    auto path_beats_at = TimePoint::max();
    bool faster = false;
    for (const auto& [path, moving] : paths) {
        const auto [next, its_faster] = path->beatIfDue(moving, may_beat_);
        path_beats_at = std::min(path_beats_at, next);
        faster = faster || its_faster;
    }
    if (faster) timer_.wake();  // which watches for silence
    const std::lock_guard lock(core_mutex_);
    heartbeat_at_ = std::min({core_.nextHeartbeat(), path_beats_at, clock_.now() + kLongestSleep});
    return heartbeat_at_;
}

TimePoint Client::Session::onStopTimer() {
    withDesk([&](StopDesk& desk) {
        stops_at_ = TimePoint::min();
        desk.onTimer();
    });
    const std::lock_guard lock(desk_mutex_);
    stops_at_ = std::min(desk_.nextDeadline(), clock_.now() + kLongestSleep);
    return stops_at_;
}

// ---- what the server pushes

void Client::Session::newProfile(std::uint64_t attempt, Presence presence, const Registration& registration,
                                 std::string_view profile) {
    withDesk([&](StopDesk& desk) {
        if (attempt == listening_)
            desk.onEntity(presence, registration.entity, registration.name, !profile.empty());
    });
    DirectLinks::Closing closing;
    onCore(attempt, [&](SessionCore& core) {
        core.onProfile(presence, registration, profile);
        if (presence == Presence::Left) closing = direct_.leave(registration.entity);
    });
    close(closing, "the entity has left");
    entities_changed_.notify_all();
}

void Client::Session::newStatus(std::uint64_t attempt, const EntityStatus& status) {
    onCore(attempt, [&](SessionCore& core) { core.onStatus(status); });
    entities_changed_.notify_all();
}

void Client::Session::newServiceRecord(std::uint64_t attempt, const Header& head, std::string_view record) {
    onCore(attempt, [&](SessionCore& core) { core.onServiceRecord(head, record); });
}

bool Client::Session::receipt(const Header& head, std::string_view message) {
    if (head.msg_type != kMsgReceipt) return false;
    proto::ToClient body;
    if (!body.ParseFromArray(message.data(), static_cast<int>(message.size())) || !body.has_receipt()) return false;
    withDesk([&](StopDesk& desk) { desk.onReceipt(head.entity, body.receipt()); });
    return true;
}

/// Of the signal lane: a reset or clear is refused. The core hears of it too.
void Client::Session::signalReply(const Header& head, std::string_view message) {
    proto::ToClient body;
    if (!body.ParseFromArray(message.data(), static_cast<int>(message.size())) || !body.has_reply()) return;
    withDesk([&](StopDesk& desk) {
        desk.onReply(head.entity, body.reply().request_id(), toRefusal(body.reply().refusal()));
    });
}

void Client::Session::newEntityMsg(std::uint64_t attempt, Lane lane, direct::Keeping keeping, const Header& head,
                                   std::string_view message) {
    if (receipt(head, message)) return;
    if (lane == Lane::Signal && head.msg_type == kMsgReply) signalReply(head, message);
    onCore(attempt, [&](SessionCore& core) {
        const auto deliver = [&](const Header& its_head, std::string_view its) { core.onEntityMsg(its_head, its, false); };
        if (lane == Lane::Signal || direct_.relayed(keeping, head, message, deliver)) core.onEntityMsg(head, message);
    });
}

void Client::Session::newDirectMsg(const DirectPath& path, direct::Keeping keeping, Header head, std::string_view message) {
    DirectLinks::Arrival arrival;
    withCore(
        [&](SessionCore& core) {
            sent_at_ = {};  // as in onCore
            head.sender = core.self();
            arrival = direct_.arrived(path, keeping, head, message);
            if (arrival.pass) core.onEntityMsg(head, message, false);
        },
        Sends::Sender);
    if (arrival.close) arrival.close->close(arrival.why);
    if (arrival.acknowledge) path.beat();
}

void Client::Session::newDirectReceipt(const DirectPath&, const Header& head, std::string_view message) {
    receipt(head, message);
}

void Client::Session::directChanged() {
    timer_.wake();
    sender_.wake();
}

bool Client::Session::direct(const Held& held) const {
    const std::lock_guard lock(core_mutex_);
    return core_.holds(held) && direct_.direct(held.entity);
}

void Client::Session::newRefusal(std::uint64_t attempt, const Header& head, const Refusal& refusal) {
    if (head.msg_type == kMsgWay) {
        DirectLinks::Closing closing;
        onCore(attempt, [&](SessionCore&) { closing = direct_.markRefused(head.entity); });
        return close(closing, "the servers refuse its beginning: " + refusal.message);
    }
    if (head.msg_type == kMsgReset || head.msg_type == kMsgClear)
        withDesk([&](StopDesk& desk) { desk.onRefusal(head.sequence, head.entity, refusal); });
    if (head.msg_type == kMsgStop) {
        withDesk([&](StopDesk& desk) { desk.onRefusal(head.sequence, head.entity, refusal); });
        return;
    }
    onCore(attempt, [&](SessionCore& core) { core.onRefusal(head, refusal); });
}

void Client::Session::newStopAccepted(std::uint64_t, const Header& head, int entities) {
    withDesk([&](StopDesk& desk) { desk.onStopAccepted(head.sequence, head.entity, entities); });
}

void Client::Session::newServerText(std::uint64_t attempt, int code, const std::string& text) {
    onCore(attempt, [&](SessionCore& core) { core.onServerText(code, text); });
}

void Client::Session::newServerHeartbeat(std::uint64_t attempt) {
    onCore(attempt, [&](SessionCore& core) { core.onServerHeartbeat(); });
}

// ---- what the core says

void Client::Session::post(std::function<void()> callback, bool may_be_left_out) {
    if (callbacks_.post(std::move(callback), may_be_left_out)) {
        // The user's callback may use the core, and would only wait for its lock.
        if (in_core == this) {
            posted_ = true;
        } else {
            callbacks_.wake();
        }
        return;
    }
    // The program does not return from its callbacks: it does not know any more what its robots do.
    log().error("client: {} callbacks wait for the program to return from one; the connection is given up",
                CallbackQueue::kMost);
    give_up_ = true;
    timer_.wake();
}

void Client::Session::onEntity(Presence presence, const Entity& entity) {
    std::function<void(Presence, const Entity&)> tell;
    {
        const std::lock_guard lock(callbacks_mutex_);
        tell = on_entity_;
    }
    if (tell) post([tell, presence, entity] { tell(presence, entity); }, presence == Presence::Changed);
}

namespace {

/// A new report of a task or a run, to whoever waits for it and to its callbacks.
template <class Shared, class Report, class Post>
void tell(std::unordered_map<std::string, std::weak_ptr<Shared>>& handles, const Report& report, Post post) {
    const auto found = handles.find(report.id);
    if (found == handles.end()) return;
    const auto handle = found->second.lock();
    if (isFinal(report.state)) handles.erase(found);
    if (!handle) return;
    bool tell = false;
    {
        const std::lock_guard lock(handle->mutex);
        handle->report = report;
        tell = !handle->callbacks.empty();
    }
    handle->changed.notify_all();
    if (!tell) return;
    post(
        [handle, report] {
            std::vector<std::function<void(const Report&)>> callbacks;
            {
                const std::lock_guard lock(handle->mutex);
                callbacks = handle->callbacks;
            }
            for (const auto& callback : callbacks) callback(report);
        },
        !isFinal(report.state));
}

}  // namespace

void Client::Session::onTask(const TaskReport& report) {
    tell(tasks_, report, [this](auto callback, bool may_be_left_out) { post(callback, may_be_left_out); });
}

void Client::Session::onRun(const RunReport& report) {
    tell(runs_, report, [this](auto callback, bool may_be_left_out) { post(callback, may_be_left_out); });
}

std::shared_ptr<CheckOut::Shared> Client::Session::shared(const Held& held) const {
    const auto found = check_outs_.find(held);
    return found == check_outs_.end() ? nullptr : found->second;
}

void Client::Session::onText(const Held& held, const std::string& text) {
    const auto check_out = shared(held);
    if (!check_out) return;
    const std::lock_guard lock(check_out->mutex);
    if (check_out->text) post([tell = check_out->text, text] { tell(text); }, true);
}

void Client::Session::onRaw(const Held& held, const std::string& bytes) {
    const auto check_out = shared(held);
    if (!check_out) return;
    const std::lock_guard lock(check_out->mutex);
    if (check_out->raw) post([tell = check_out->raw, bytes] { tell(bytes); }, true);
}

void Client::Session::onService(const Held& held, const Service& service) {
    const auto check_out = shared(held);
    if (!check_out) return;
    const std::lock_guard lock(check_out->mutex);
    if (check_out->service) post([tell = check_out->service, service] { tell(service); }, true);
}

void Client::Session::onLost(const Held& held, const Refusal& why) {
    const auto check_out = shared(held);
    if (!check_out) return;
    check_outs_.erase(held);
    const std::lock_guard lock(check_out->mutex);
    check_out->lost_why = why;
    if (check_out->lost) post([tell = check_out->lost, why] { tell(why); }, false);
}

void Client::Session::onDatagrams(const Held& held, const std::string& endpoint, const std::string& key) {
    datagrams_.admit(held.entity, held.lease, endpoint, key, core_.self().id);
}

void Client::Session::onDirect(const Held& held, const std::string& data_endpoint, const std::string& signal_endpoint,
                               const std::string& key) {
    // Nothing plain where the way to the server is TLS, and no way to an endpoint behind a router.
    if (data_endpoint.empty() || signal_endpoint.empty() || !options_.direct || data_.router ||
        transport::parseEndpoint(options_.server).tls)
        return withdrawDirect(held);
    // An Entity Manager beside the server names its own machine; elsewhere that is another one.
    const auto connection = connection_.load();
    const auto local = [](const std::string& endpoint) { return endpoint.starts_with("127."); };
    if (local(data_endpoint) && connection && !local(connection->peer())) return withdrawDirect(held);
    direct_.offer({held.entity, held.lease, key, core_.self().id, data_endpoint, signal_endpoint});
    timer_.wake();
}

void Client::Session::withdrawDirect(const Held& held) {
    if (direct_.withdraw(held)) timer_.wake();
}

void Client::Session::onOrphaned(const Held& held, const std::string& reason) {
    const auto check_out = shared(held);
    if (!check_out) return;
    const std::lock_guard lock(check_out->mutex);
    if (check_out->orphaned) post([tell = check_out->orphaned, reason] { tell(reason); }, false);
}

void Client::Session::onResumed(const Held& held) {
    const auto check_out = shared(held);
    if (!check_out) return;
    const std::lock_guard lock(check_out->mutex);
    if (check_out->resumed) post(check_out->resumed, false);
}

void Client::Session::onHandOver(const Held& held, const HandOverRequest& request) {
    const auto check_out = shared(held);
    if (!check_out) return;
    const std::lock_guard lock(check_out->mutex);
    if (check_out->hand_over) post([tell = check_out->hand_over, request] { tell(request); }, false);
}

void Client::Session::onSample(const Sample& sample) {
    for (const auto& [id, watching] : watches_) {
        if (watching.entity != sample.entity) continue;
        const auto& streams = watching.streams;
        if (!streams.empty() && std::find(streams.begin(), streams.end(), sample.stream) == streams.end())
            continue;
        post(
            [callback = watching.callback, wanted = watching.wanted, sample = Sample(sample)]() mutable {
                if (!*wanted) return;
                sample.json = sampleToJson(sample.raw);
                (*callback)(sample);
            },
            true);
    }
}

void Client::Session::onTransferCredit(const Id128& transfer, std::uint64_t offset, std::uint64_t limit) {
    const auto found = uploads_.find(transfer);
    if (found != uploads_.end()) found->second->credit(offset, limit);
}

void Client::Session::onServerText(int code, const std::string& text) {
    log().info("server: {} ({})", text, code);
}

void Client::Session::setOnEntity(std::function<void(Presence, const Entity&)> callback) {
    const std::lock_guard lock(callbacks_mutex_);
    on_entity_ = std::move(callback);
}

void Client::Session::setOnConnection(std::function<void(bool, const std::string&)> callback) {
    const std::lock_guard lock(callbacks_mutex_);
    on_connection_ = std::move(callback);
}

// ---- what the user wants

Result<std::vector<CheckOut>> Client::Session::checkOut(const CheckOutOptions& options,
                                                        const BeginCheckOut& begin) {
    mayWait();
    // The handles are made under the core's lock, so that nothing the entities say from now on is missed.
    using Shared = std::vector<std::shared_ptr<CheckOut::Shared>>;
    auto promise = std::make_shared<std::promise<Result<Shared>>>();
    auto future = promise->get_future();
    auto for_core = options;
    if (options.on_waiting) {
        for_core.on_waiting = [this, tell = options.on_waiting](const Waiting& waiting) {
            post([tell, waiting] { tell(waiting); }, true);
        };
    }
    const auto order = withCore([&](SessionCore& core) {
        return begin(core, for_core, [this, &core, promise](Result<std::vector<Held>> granted) {
            if (!granted) return promise->set_value(granted.refusal());
            Shared made;
            for (const auto& held : granted.value()) {
                const auto entity = core.entity(held.entity);
                auto& check_out = check_outs_[held];
                check_out = std::make_shared<CheckOut::Shared>(held, weak_from_this(),
                                                               entity ? entity.value() : Entity{held.entity});
                made.push_back(check_out);
            }
            promise->set_value(std::move(made));
        });
    });
    const std::stop_callback cancel(
        options.give_up, [this, order] { withCore([order](SessionCore& core) { core.giveUp(order); }); });
    auto answer = future.get();
    if (!answer) return answer.refusal();
    std::vector<CheckOut> all;
    for (auto& made : answer.value()) all.emplace_back(std::move(made));
    return all;
}

std::vector<CheckOut> Client::Session::held() const {
    const std::lock_guard lock(core_mutex_);
    std::vector<CheckOut> all;
    for (const auto& [held, check_out] : check_outs_) {
        if (core_.holds(held)) all.emplace_back(check_out);
    }
    return all;
}

Task Client::Session::run(const Held& held, std::string_view service, const std::vector<Argument>& arguments,
                          Seconds not_after) {
    return withCore([&](SessionCore& core) {
        const auto overloaded = admit(0);
        if (!overloaded.ok()) {
            TaskReport report{Id128::uuid(random_).toString(), held.entity, std::string(service)};
            report.state = TaskState::Refused;
            report.reason = overloaded;
            return Task(std::make_shared<Task::Shared>(*Id128::parse(report.id), weak_from_this(), report));
        }
        const auto id = core.run(held, service, arguments, toDuration(not_after));
        auto task = std::make_shared<Task::Shared>(id, weak_from_this(), *core.task(id));
        if (!isFinal(task->report.state)) tasks_[task->text] = task;
        return Task(task);
    });
}

Result<Run> Client::Session::runGlobal(const GlobalService& service, const Bindings& bindings,
                                       std::string_view master, bool check_only) {
    return withCore([&](SessionCore& core) -> Result<Run> {
        if (auto overloaded = admit(0); !overloaded.ok()) return overloaded;
        RunOrder order{service, {}, {}, check_only, 0};
        for (const auto& [role, name] : bindings) {
            const auto entity = core.find(name);
            if (!entity) return entity.refusal();
            order.players[role] = entity->id;
        }
        const auto entity = core.find(master);
        if (!entity) return entity.refusal();
        order.master = entity->id;
        order.asked_at_ms = std::chrono::duration_cast<std::chrono::milliseconds>(
                                std::chrono::system_clock::now().time_since_epoch())
                                .count();
        const auto id = core.runGlobal(order);
        if (!id) return id.refusal();
        auto run = std::make_shared<Run::Shared>(id.value(), weak_from_this(), *core.runReport(id.value()));
        if (!isFinal(run->report.state)) runs_[run->text] = run;
        return Run(run);
    });
}

namespace {

/// The answers of several entities to one question. Filled under the core's lock.
template <class Answer>
struct Survey {
    explicit Survey(std::size_t asked) : answers(asked, Refusal{RefusalCode::TimedOut, "No answer.", {}}), open(asked) {
        if (asked == 0) all.set_value();
    }
    void put(std::size_t place, Answer answer) {
        answers[place] = std::move(answer);
        if (--open == 0) all.set_value();
    }
    std::vector<Answer> answers;
    std::size_t open;
    std::promise<void> all;
};

}  // namespace

Result<collaboration::Proposal> Client::Session::propose(const GlobalService& service,
                                                         const Bindings& chosen) {
    mayWait();
    using Answers = Survey<Result<Details>>;
    std::shared_ptr<Answers> survey;
    std::vector<collaboration::Candidate> candidates;
    std::map<int, std::string> choices;
    const auto asked = withCore([&](SessionCore& core) -> Result<void> {
        if (!core.connected()) return core.find("").refusal();
        for (const auto& [role, name] : chosen) {
            const auto entity = core.find(name);
            if (!entity) return entity.refusal();
            choices[role] = entity->id;
        }
        const auto mine = core.held();
        for (const auto& entity : core.entities()) {
            auto& candidate = candidates.emplace_back();
            candidate.entity = entity.id;
            candidate.name = core.callName(entity.id);
            candidate.category = entity.category;
            candidate.type = entity.type;
            candidate.state = entity.state;
            candidate.latched = entity.latched;
            candidate.holder = entity.holder.name;
            candidate.held_here = std::any_of(mine.begin(), mine.end(),
                                              [&](const Held& held) { return held.entity == entity.id; });
        }
        survey = std::make_shared<Answers>(candidates.size());
        for (std::size_t i = 0; i < candidates.size(); ++i) {
            core.fetchDetails(candidates[i].entity, [survey, i](Result<Details> details) {
                survey->put(i, std::move(details));
            });
        }
        return {};
    });
    if (!asked) return asked.refusal();
    survey->all.get_future().wait();
    for (std::size_t i = 0; i < candidates.size(); ++i) {
        const auto& details = survey->answers[i];
        if (!details) {
            candidates[i].silent = details.refusal().message;
            continue;
        }
        for (const auto& one : details->services)
            candidates[i].offers.push_back({one.name, one.global_id, one.active, one.missing});
    }
    return collaboration::propose(rolesOf(service), std::move(candidates), choices);
}

Result<RunHistory> Client::Session::runHistory(const std::vector<std::string>& names, int most) {
    mayWait();
    using Answers = Survey<Result<std::vector<RunRecord>>>;
    std::shared_ptr<Answers> survey;
    std::vector<std::string> called;
    const auto asked = withCore([&](SessionCore& core) -> Result<void> {
        if (!core.connected()) return core.find("").refusal();
        std::vector<std::string> entities;
        for (const auto& name : names) {
            const auto entity = core.find(name);
            if (!entity) return entity.refusal();
            if (std::find(entities.begin(), entities.end(), entity->id) == entities.end())
                entities.push_back(entity->id);
        }
        if (names.empty()) {
            for (const auto& entity : core.entities()) entities.push_back(entity.id);
        }
        survey = std::make_shared<Answers>(entities.size());
        for (std::size_t i = 0; i < entities.size(); ++i) {
            called.push_back(core.callName(entities[i]));
            core.fetchRuns(entities[i], most, [survey, i](Result<std::vector<RunRecord>> runs) {
                survey->put(i, std::move(runs));
            });
        }
        return {};
    });
    if (!asked) return asked.refusal();
    survey->all.get_future().wait();
    RunHistory history;
    for (std::size_t i = 0; i < called.size(); ++i) {
        auto& answer = survey->answers[i];
        if (!answer) {
            history.silent.emplace_back(called[i], answer.refusal());
            continue;
        }
        for (auto& record : answer.value()) history.runs.push_back(std::move(record));
    }
    std::stable_sort(history.runs.begin(), history.runs.end(), [](const RunRecord& a, const RunRecord& b) {
        return a.asked_at > b.asked_at;
    });
    return history;
}

Result<void> Client::Session::upload(const Held& held, std::string_view service, std::string_view resource,
                                     const std::filesystem::path& path,
                                     const std::function<void(std::uint64_t, std::uint64_t)>& progress,
                                     const std::stop_token& give_up) {
    mayWait();
    auto opened =
        ResourceFile::open(path, withCore([&](SessionCore& core) { return core.resourceBytesMax(held); }));
    if (!opened) return opened.refusal();
    ResourceFile file = std::move(opened).value();
    const auto window = std::make_shared<UploadWindow>();
    const auto id = withCore([&](SessionCore& core) {
        const auto transfer =
            core.offer(held, service, resource, path.filename().string(), file.size(), file.sha256(),
                       [window](const Result<void>& answer) { window->finish(answer.refusal()); });
        uploads_[transfer] = window;
        return transfer;
    });
    const std::stop_callback cancel(give_up, [&window] {
        window->finish(
            {RefusalCode::Cancelled, "The upload was cancelled; it goes on when it is begun again.", {}});
    });
    std::optional<std::uint64_t> sent;
    Refusal failure;
    while (true) {
        const auto turn = window->next(sent, file.size());
        if (turn.ended) {
            failure = *turn.ended;
            break;
        }
        std::uint64_t at = turn.from;
        if (progress && !sent) progress(at, file.size());
        while (at < turn.to && failure.ok() && !give_up.stop_requested()) {
            auto content = file.read(at, std::min<std::uint64_t>(kChunkBytes, turn.to - at));
            if (!content) {
                failure = content.refusal();
                break;
            }
            const auto refused =
                withCore([&](SessionCore& core) { return core.sendChunk(id, at, content.value()); });
            if (!refused) break;  // it has ended; the next turn says why
            at += content->size();
            if (progress) progress(at, file.size());
        }
        sent = at;
        if (!failure.ok()) break;
    }
    if (!failure.ok()) {
        // An empty chunk makes the Entity Manager put away what it has, to be gone on with; refused here when
        // the transfer has ended there already.
        withCore(
            [&](SessionCore& core) { static_cast<void>(core.sendChunk(id, sent.value_or(0), {}).ok()); });
    }
    const std::lock_guard lock(core_mutex_);
    uploads_.erase(id);
    return failure;
}

Result<void> Client::Session::release(const Held& held) {
    return ask<Result<void>>([&](SessionCore& core, auto done) {
        check_outs_.erase(held);
        core.release(held, done);
    });
}

Result<Receipt> Client::Session::command(const Held& held,
                                         Result<void> (SessionCore::*give)(const Held&, std::int64_t)) {
    using Answer = Result<std::vector<Receipt>>;
    const auto promise = std::make_shared<std::promise<Answer>>();
    auto future = promise->get_future();
    const auto sequence = marks_.nextSequence();
    withDesk([&](StopDesk& desk) {
        desk.await(held.entity, sequence, settingsOf(options_).timeout,
                   [promise](Answer answer) { promise->set_value(std::move(answer)); });
    });
    const auto sent = withCore([&](SessionCore& core) { return (core.*give)(held, sequence); });
    if (!sent) {
        withDesk([&](StopDesk& desk) { desk.withdraw(sequence); });
        return sent.refusal();
    }
    mayWait();  // after it has left, as a stop does
    auto receipts = future.get();
    if (!receipts) return receipts.refusal();
    if (receipts->empty() || !receipts->front().manager)
        return Refusal{
            RefusalCode::TimedOut,
            "The entity has not answered in time; it is not known whether its task has ended. Look at it.",
            {}};
    return std::move(receipts->front());
}

Result<std::vector<Receipt>> Client::Session::stop(const std::vector<std::string>& names, Seconds deadline,
                                                   Seconds standstill) {
    using Answer = Result<std::vector<Receipt>>;
    const auto promise = std::make_shared<std::promise<Answer>>();
    auto future = promise->get_future();
    withDesk([&](StopDesk& desk) {
        desk.stop(
            names, toDuration(deadline), [promise](Answer answer) { promise->set_value(std::move(answer)); },
            toDuration(standstill));
    });
    mayWait();  // after the stop has left: misuse is no reason not to stop
    auto answer = future.get();
    if (answer && dynamic_cast<const SharedClock*>(&clock_) != nullptr)
        for (auto& receipt : answer.value()) receipt.precision = SharedClockPage::kStep;
    return answer;
}

Result<std::vector<DrillReport>> Client::Session::drill(const std::vector<std::string>& names, int count,
                                                        Seconds period, const std::stop_token& give_up) {
    mayWait();
    std::map<std::string, DrillReport> reports;
    std::mutex mutex;
    std::condition_variable_any pause;
    for (int i = 0; i < count && !give_up.stop_requested(); ++i) {
        const auto next = std::chrono::steady_clock::now() + toDuration(period);
        using Answer = Result<std::vector<Receipt>>;
        const auto promise = std::make_shared<std::promise<Answer>>();
        auto future = promise->get_future();
        withDesk([&](StopDesk& desk) {
            desk.drill(names, kDrillTime,
                       [promise](Answer answer) { promise->set_value(std::move(answer)); });
        });
        const auto receipts = future.get();
        if (!receipts) return receipts.refusal();
        for (const auto& receipt : receipts.value()) {
            auto& report = reports[receipt.entity];
            report.entity = receipt.entity;
            report.name = receipt.name;
            report.no_application = receipt.no_application;
            report.manager.push_back(receipt.manager);
            report.callback.push_back(receipt.callback_returned);
        }
        if (i + 1 == count) break;
        std::unique_lock lock(mutex);
        pause.wait_until(lock, give_up, next, [] { return false; });
    }
    std::vector<DrillReport> all;
    for (auto& [entity, report] : reports) all.push_back(std::move(report));
    return all;
}

Result<Entity> Client::Session::waitFor(std::string_view name, Seconds time) const {
    mayWait();
    const auto until = clock_.now() + toDuration(time);
    std::unique_lock lock(core_mutex_);
    while (true) {
        const auto left = clock_.realTimeUntil(until);
        auto found = core_.find(name);
        if (found && found->ready && found->state != EntityState::UNAV && found->state != EntityState::INIT &&
            found->state != EntityState::ENVCONN && found->state != EntityState::ERR) {
            return found;
        }
        if (!found && found.refusal().code == RefusalCode::AmbiguousEntity) return found;
        if (closing_ || left <= Duration::zero()) {
            if (!found) return found;
            return Refusal{RefusalCode::TimedOut,
                           found->name + " is still " + toString(found->state) +
                               (found->reason.empty() ? std::string(".") : ": " + found->reason),
                           {}};
        }
        entities_changed_.wait_for(lock, left);
    }
}

Result<std::shared_ptr<void>> Client::Session::watch(std::string_view name,
                                                     const std::vector<std::string>& streams,
                                                     std::function<void(const Sample&)> callback) {
    auto begun = withCore([&](SessionCore& core) -> Result<std::uint64_t> {
        const auto entity = core.find(name);
        if (!entity) return entity.refusal();
        const auto watching = core.watch(entity->id, streams);
        if (!watching) return watching.refusal();
        const auto id = ++next_watch_;
        watches_[id] = {entity->id, streams,
                        std::make_shared<const std::function<void(const Sample&)>>(std::move(callback)),
                        std::make_shared<std::atomic<bool>>(true)};
        return id;
    });
    if (!begun) return begun.refusal();
    return std::shared_ptr<void>(static_cast<void*>(this),
                                 [session = weak_from_this(), id = begun.value()](void*) {
                                     if (const auto alive = session.lock()) alive->unwatch(id);
                                 });
}

void Client::Session::unwatch(std::uint64_t id) {
    withCore([&](SessionCore& core) {
        const auto found = watches_.find(id);
        if (found == watches_.end()) return;
        *found->second.wanted = false;
        core.unwatch(found->second.entity, found->second.streams);
        watches_.erase(found);
    });
}

// ---- the public header

Client::Client(std::shared_ptr<Session> session) : session_(std::move(session)) {}

Client::~Client() {
    session_->close();
}

Result<std::unique_ptr<Client>> Client::connect(Options options) {
    std::shared_ptr<const Clock> clock;
    try {
        clock = clockFromEnvironment();
    } catch (const std::exception& error) {
        return Refusal{RefusalCode::Malformed, error.what(), {}};
    }
    auto session = std::make_shared<Session>(std::move(options), std::move(clock));
    const auto connected = session->connect();
    if (!connected) {
        session->close();
        return connected.refusal();
    }
    return std::unique_ptr<Client>(new Client(std::move(session)));
}

void Client::close() {
    session_->close();
}

bool Client::connected() const {
    return session_->look([](const SessionCore& core) { return core.connected(); });
}

Sender Client::self() const {
    return session_->look([](const SessionCore& core) { return core.self(); });
}

std::string Client::server() const {
    return session_->options().server;
}

std::vector<Entity> Client::entities(Listed listed) const {
    return session_->look([&](const SessionCore& core) { return core.entities(listed); });
}

Result<Entity> Client::find(std::string_view name) const {
    return session_->look([&](const SessionCore& core) { return core.find(name); });
}

Result<Entity> Client::waitFor(std::string_view name, Seconds time) const {
    return session_->waitFor(name, time);
}

void Client::onEntity(std::function<void(Presence, const Entity&)> callback) {
    session_->setOnEntity(std::move(callback));
}

void Client::onConnection(std::function<void(bool, const std::string&)> callback) {
    session_->setOnConnection(std::move(callback));
}

Result<std::vector<CheckOut>> Client::checkOut(const std::vector<std::string>& names,
                                               const CheckOutOptions& options) {
    return session_->checkOut(
        options, [&](SessionCore& core, const CheckOutOptions& with, SessionCore::CheckOutDone done) {
            return core.checkOut(names, with, std::move(done));
        });
}

Result<CheckOut> Client::checkOut(std::string_view name, const CheckOutOptions& options) {
    auto all = checkOut(std::vector{std::string(name)}, options);
    if (!all) return all.refusal();
    return all->front();
}

Result<std::vector<CheckOut>> Client::checkOutQuery(std::string_view query, const CheckOutOptions& options) {
    const auto parsed = parseQuery(query);
    if (!parsed) return parsed.refusal();
    return session_->checkOut(
        options, [&](SessionCore& core, const CheckOutOptions& with, SessionCore::CheckOutDone done) {
            return core.checkOut(parsed.value(), with, std::move(done));
        });
}

Result<CheckOut> Client::resume(std::string_view ticket) {
    const auto parsed = LeaseTicket::parse(ticket);
    if (!parsed) return parsed.refusal();
    auto all = session_->checkOut(
        {}, [&](SessionCore& core, const CheckOutOptions&, SessionCore::CheckOutDone done) {
            core.resume(parsed.value(), std::move(done));
            return Id128{};
        });
    if (!all) return all.refusal();
    return all->front();
}

std::vector<CheckOut> Client::held() const {
    return session_->held();
}

Result<std::vector<Receipt>> Client::stop(const std::vector<std::string>& names, Seconds deadline,
                                          Seconds standstill) {
    return session_->stop(names, deadline, standstill);
}

Result<void> Client::rearm(std::string_view name) {
    return session_->ask<Result<void>>([&](SessionCore& core, auto done) {
        const auto entity = core.find(name);
        if (!entity) return done(entity.refusal());
        core.rearm(entity->id, done);
    });
}

Result<std::vector<Service>> Client::services(std::string_view name) const {
    return session_->ask<Result<std::vector<Service>>>([&](SessionCore& core, auto done) {
        const auto entity = core.find(name);
        if (!entity) return done(entity.refusal());
        core.fetchServices(entity->id, done);
    });
}

Result<Details> Client::details(std::string_view name) const {
    return session_->ask<Result<Details>>([&](SessionCore& core, auto done) {
        const auto entity = core.find(name);
        if (!entity) return done(entity.refusal());
        core.fetchDetails(entity->id, done);
    });
}

Result<GlobalServices> Client::globalServices() const {
    return session_->ask<Result<GlobalServices>>(
        [](SessionCore& core, auto done) { core.fetchGlobalServices(done); });
}

Result<collaboration::Proposal> Client::propose(const GlobalService& service, const Bindings& chosen) const {
    return session_->propose(service, chosen);
}

Result<Run> Client::runGlobal(const GlobalService& service, const Bindings& bindings,
                              std::string_view master) {
    return session_->runGlobal(service, bindings, master, false);
}

Result<Run> Client::checkGlobal(const GlobalService& service, const Bindings& bindings,
                                std::string_view master) {
    return session_->runGlobal(service, bindings, master, true);
}

Result<RunHistory> Client::runHistory(const std::vector<std::string>& names, int most) const {
    return session_->runHistory(names, most);
}

Result<std::vector<DrillReport>> Client::drill(const std::vector<std::string>& names, int count,
                                               Seconds period, std::stop_token give_up) {
    return session_->drill(names, count, period, give_up);
}

Result<std::shared_ptr<void>> Client::watch(std::string_view name, const std::vector<std::string>& streams,
                                            std::function<void(const Sample&)> callback) {
    return session_->watch(name, streams, std::move(callback));
}

namespace {

Refusal gone() {
    return {RefusalCode::NotConnected, "The client of this handle has been closed.", {}};
}

}  // namespace

namespace {

// What handles of tasks and of runs have in common.

template <class Shared>
auto newest(Shared& shared) {
    const std::lock_guard lock(shared.mutex);
    return shared.report;
}

template <class Shared>
auto awaitEnd(Shared& shared, std::optional<Seconds> time) {
    std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>();
    if (const auto session = shared.session.lock()) {
        session->mayWait();
        clock = session->clock();
    }
    std::unique_lock lock(shared.mutex);
    const auto over = [&] { return isFinal(shared.report.state); };
    if (time) {
        waitUntil(shared.changed, lock, *clock, clock->now() + toDuration(*time), over);
    } else {
        shared.changed.wait(lock, over);
    }
    return shared.report;
}

template <class Shared, class Callback>
void listen(Shared& shared, Callback callback) {
    const auto session = shared.session.lock();
    if (!session) return;
    // Under the handle's lock, so that no change comes between the first call and the next.
    const std::lock_guard lock(shared.mutex);
    session->post([callback, report = shared.report] { callback(report); }, false);
    shared.callbacks.push_back(std::move(callback));
}

Result<void> control(const Task::Shared& task, proto::TaskAction action) {
    const auto session = task.session.lock();
    if (!session) return gone();
    return session->ask<Result<void>>(
        [&](SessionCore& core, auto done) { core.control(task.id, action, done); });
}

Result<void> control(const Run::Shared& run, proto::TaskAction action) {
    const auto session = run.session.lock();
    if (!session) return gone();
    return session->ask<Result<void>>(
        [&](SessionCore& core, auto done) { core.controlRun(run.id, action, done); });
}

}  // namespace

const std::string& Task::id() const {
    return shared_->text;
}
TaskReport Task::report() const {
    return newest(*shared_);
}
TaskReport Task::wait(std::optional<Seconds> time) const {
    return awaitEnd(*shared_, time);
}
void Task::onUpdate(std::function<void(const TaskReport&)> callback) const {
    listen(*shared_, std::move(callback));
}
Result<void> Task::pause() const {
    return control(*shared_, proto::PAUSE);
}
Result<void> Task::resume() const {
    return control(*shared_, proto::RESUME);
}
Result<void> Task::cancel() const {
    return control(*shared_, proto::CANCEL);
}

const std::string& Run::id() const {
    return shared_->text;
}
RunReport Run::report() const {
    return newest(*shared_);
}
RunReport Run::wait(std::optional<Seconds> time) const {
    return awaitEnd(*shared_, time);
}
void Run::onUpdate(std::function<void(const RunReport&)> callback) const {
    listen(*shared_, std::move(callback));
}
Result<void> Run::pause() const {
    return control(*shared_, proto::PAUSE);
}
Result<void> Run::resume() const {
    return control(*shared_, proto::RESUME);
}
Result<void> Run::cancel() const {
    return control(*shared_, proto::CANCEL);
}

Entity CheckOut::entity() const {
    if (const auto session = shared_->session.lock()) {
        auto now =
            session->look([this](const SessionCore& core) { return core.entity(shared_->held.entity); });
        if (now) {
            const std::lock_guard lock(shared_->mutex);
            shared_->last = now.value();
            return now.value();
        }
    }
    const std::lock_guard lock(shared_->mutex);
    return shared_->last;
}

std::vector<Service> CheckOut::services() const {
    const auto session = shared_->session.lock();
    if (!session) return {};
    auto all = session->look([this](const SessionCore& core) { return core.services(shared_->held); });
    return all ? std::move(all).value() : std::vector<Service>{};
}

Result<Service> CheckOut::service(std::string_view name_or_global_id) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->look(
        [&](const SessionCore& core) { return core.service(shared_->held, name_or_global_id); });
}

Result<void> CheckOut::set(std::string_view service, const Argument& argument) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->ask<Result<void>>(
        [&](SessionCore& core, auto done) { core.set(shared_->held, service, argument, done); });
}

Result<void> CheckOut::upload(std::string_view service, std::string_view resource,
                              const std::filesystem::path& file,
                              std::function<void(std::uint64_t, std::uint64_t)> progress,
                              std::stop_token give_up) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->upload(shared_->held, service, resource, file, progress, give_up);
}

Task CheckOut::run(std::string_view service, const std::vector<Argument>& arguments,
                   Seconds not_after) const {
    if (const auto session = shared_->session.lock()) {
        return session->run(shared_->held, service, arguments, not_after);
    }
    TaskReport report;
    report.entity = shared_->held.entity;
    report.service = std::string(service);
    report.state = TaskState::Refused;
    report.reason = gone();
    return Task(std::make_shared<Task::Shared>(Id128{}, shared_->session, report));
}

Result<void> CheckOut::sendText(std::string_view text) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    // Asked once before the lock, so that who tries again and again does not wear it out.
    if (auto refusal = session->admit(text.size()); !refusal.ok()) return refusal;
    return session->withCore([&](SessionCore& core) -> Result<void> {
        if (auto refusal = session->admit(text.size()); !refusal.ok()) return refusal;
        return core.sendText(shared_->held, text);
    });
}

Result<void> CheckOut::sendRaw(std::string_view bytes, Seconds wait) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    // Asked once before the lock, so that who tries again and again does not wear it out.
    if (wait > Seconds{0}) session->awaitRoom(wait);
    if (auto refusal = session->admit(bytes.size()); !refusal.ok()) return refusal;
    return session->withCore([&](SessionCore& core) -> Result<void> {
        if (auto refusal = session->admit(bytes.size()); !refusal.ok()) return refusal;
        return core.sendRaw(shared_->held, bytes);
    });
}

void CheckOut::onText(std::function<void(const std::string&)> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->text = std::move(callback);
}

void CheckOut::onRaw(std::function<void(const std::string&)> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->raw = std::move(callback);
}

void CheckOut::onServiceChanged(std::function<void(const Service&)> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->service = std::move(callback);
}

void CheckOut::onLost(std::function<void(const Refusal&)> callback) const {
    const auto session = shared_->session.lock();
    const std::lock_guard lock(shared_->mutex);
    if (shared_->lost_why && session && callback) {
        session->post([callback, why = *shared_->lost_why] { callback(why); }, false);
    }
    shared_->lost = std::move(callback);
}

void CheckOut::onOrphaned(std::function<void(const std::string&)> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->orphaned = std::move(callback);
}

void CheckOut::onResumed(std::function<void()> callback) const {
    const std::lock_guard lock(shared_->mutex);
    shared_->resumed = std::move(callback);
}

bool CheckOut::orphaned() const {
    const auto session = shared_->session.lock();
    return session && session->look([this](const SessionCore& core) { return core.orphaned(shared_->held); });
}

void CheckOut::onHandOverRequest(std::function<void(const HandOverRequest&)> callback) const {
    const auto session = shared_->session.lock();
    if (!session) return;
    // Under the core's lock, so that no request comes between the look and the callback's being there.
    session->look([&](const SessionCore& core) {
        const auto open = core.question(shared_->held);
        const std::lock_guard lock(shared_->mutex);
        if (open && callback) session->post([callback, open] { callback(*open); }, false);
        shared_->hand_over = std::move(callback);
    });
}

std::optional<HandOverRequest> CheckOut::handOverRequest() const {
    const auto session = shared_->session.lock();
    if (!session) return std::nullopt;
    return session->look([this](const SessionCore& core) { return core.question(shared_->held); });
}

Result<void> CheckOut::answerHandOver(bool accept, std::string_view reason) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->withCore(
        [&](SessionCore& core) { return core.answerHandOver(shared_->held, accept, reason); });
}

Result<void> CheckOut::setHandOverPolicy(const HandOverPolicy& policy) const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->withCore(
        [&](SessionCore& core) { return core.setHandOverPolicy(shared_->held, policy); });
}

bool CheckOut::direct() const {
    const auto session = shared_->session.lock();
    return session && session->direct(shared_->held);
}

std::string CheckOut::ticket() const {
    const auto session = shared_->session.lock();
    if (!session) return {};
    const auto ticket = session->look([this](const SessionCore& core) { return core.ticket(shared_->held); });
    return ticket ? ticket->toText() : std::string();
}

Result<Receipt> CheckOut::reset() const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->command(shared_->held, &SessionCore::reset);
}

Result<Receipt> CheckOut::clear() const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->command(shared_->held, &SessionCore::clear);
}

Result<void> CheckOut::release() const {
    const auto session = shared_->session.lock();
    if (!session) return gone();
    return session->release(shared_->held);
}

}  // namespace axon::client
