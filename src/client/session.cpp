// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/session.hpp"

#include <axon/messages.pb.h>
#include <pwd.h>
#include <spdlog/logger.h>
#include <unistd.h>

#include <algorithm>
#include <stdexcept>

#include "client/base/durations.hpp"
#include "client/base/log.hpp"
#include "client/connection/communicators.hpp"
#include "client/connection/server_connection.hpp"
#include "client/direct/may_open.hpp"
#include "client/direct/network_path.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/tls.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::client {
namespace {

using namespace std::chrono_literals;

constexpr Duration kReleaseTime = 1s;

SessionCoreSettings settingsOf(const Options& options) {
    SessionCoreSettings settings;
    settings.timeout = timeoutOf(options);
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

void closeAll(const DirectLinks::Closing& paths, const std::string& why) {
    for (const auto& path : paths) path->close(why);
}

}  // namespace

Client::Session::Session(Options options, std::shared_ptr<const Clock> clock)
    : options_(settled(std::move(options))),
      clock_(std::move(clock)),
      communicators_(std::make_shared<Communicators>()),
      lane_readers_(std::make_shared<LaneReaders>(*clock_, options_.direct_spin)),
      core_(settingsOf(options_), *clock_, random_, messages_, news_, marks_),
      direct_(*clock_, static_cast<std::size_t>(std::max(options_.direct_paths, 0)),
              [this](const DirectOffer& offer) {
                  const auto connection = connection_.load();
                  return std::make_shared<NetworkPath>(
                      lane_readers_, communicators_->signal(), offer, Id128::random(random_),
                      connection ? connection->backlog() : std::make_shared<Backlog>(), *clock_,
                      weak_from_this(), communicators_);
              }),
      news_(*this,
            [this] {
                give_up_ = true;
                threads_.timer.wake();
            }),
      messages_(
          *clock_, direct_, [this] { threads_.sender.wake(); }, [this] { threads_.heartbeat.wake(); }),
      datagrams_(*clock_,
                 [this](const datagrams::StopRepeater::Acknowledged& stop) {
                     stops_.onDatagramAcknowledged(stop.entity, stop.sender.toString(), stop.sequence,
                                                   stop.generation);
                 }),
      stops_(
          *clock_, marks_, direct_,
          [this](const std::string& entity, std::int64_t sequence, std::int32_t generation) {
              datagrams_.stop(entity, sequence, generation);
          },
          [this] { threads_.stops.wake(); }),
      releases_("this client", transport::ourContract()) {}

Client::Session::~Session() {
    close();
}

Client::Session::Leaving Client::Session::collect(Sends sends) {
    const auto deadline = std::min(core_.nextDeadline(), core_.serverDeadline());
    Leaving leaving{};
    leaving.wake_timer = threads_.timer.turn.mustWakeFor(deadline);
    leaving.wake_heartbeat = threads_.heartbeat.turn.mustWakeFor(core_.nextHeartbeat());
    leaving.messages = messages_.collect(sends == Sends::Here);
    leaving.told = news_.takeTold() && (sends != Sends::Reader || news_.crowded());
    return leaving;
}

void Client::Session::depart(const Leaving& leaving) noexcept {
    if (leaving.told) news_.wake();
    messages_.depart(leaving.messages);
    if (leaving.wake_timer) threads_.timer.wake();
    if (leaving.wake_heartbeat) threads_.heartbeat.wake();
}

template <class Use>
void Client::Session::onCore(std::uint64_t attempt, Use&& use) {
    withCore(
        [&](SessionCore& core) {
            if (attempt == listening_) use(core);
            messages_.breakBurst();
        },
        Sends::Sender);
}

void Client::Session::mayWait() const {
    if (news_.insideCallback()) {
        throw std::logic_error(
            "axon::client: a call that waits was made from a callback, which would wait for itself. Make it "
            "from another thread.");
    }
}

Result<void> Client::Session::connect() {
    if (auto opened = communicators_->open(options_); !opened) return opened;
    threads_.sender.start("axon-sender", Lane::Data, *clock_, [this] {
        messages_.sendAll();
        return clock_->now() + kLongestSleep;
    });
    const auto established = establish();
    if (!established) {
        const bool routed = communicators_->routed();
        auto refusal = established.refusal();
        // A port of TLS waits for the other side to begin, and so does a client of TCP.
        if (refusal.code == RefusalCode::TimedOut && !routed &&
            !transport::parseEndpoint(options_.server).tls)
            refusal.message += "; or is TLS spoken there (ssl://HOST:PORT)?";
        if (refusal.code == RefusalCode::NotConnected || refusal.code == RefusalCode::TimedOut) {
            refusal.code = RefusalCode::Unavailable;
        }
        refusal.message = (routed ? "No session through the router " : "No session with the server at ") +
                          options_.server + ": " + refusal.message;
        return refusal;
    }
    threads_.timer.start("axon-timer", Lane::Signal, *clock_, [this] { return onTimer(); });
    threads_.heartbeat.start("axon-heartbeat", Lane::Signal, *clock_, [this] { return onHeartbeat(); });
    threads_.stops.start("axon-stops", Lane::Signal, *clock_, [this] { return stops_.onTimer(); });

    if (!options_.await_entities) return {};
    // The entities that are there are pushed at once; a client that has just connected should know them.
    std::unique_lock lock(core_mutex_);
    entities_changed_.wait_for(lock, std::chrono::nanoseconds(toDuration(options_.timeout)),
                               [this] { return core_.complete() || !up_; });
    return {};
}

Result<void> Client::Session::establish() {
    Login login;
    if (communicators_->routed()) {
        login.endpoint.tls = transport::isTlsRouter(options_.server);
    } else {
        login.endpoint = transport::parseEndpoint(options_.server);
    }
    login.user = options_.user;
    login.password = options_.password;
    login.display_name = options_.display_name.empty() ? userAtHost() : options_.display_name;
    login.timeout = timeoutOf(options_);
    login.lost_router = last_router_;
    {
        const std::lock_guard lock(core_mutex_);
        login.attempt = ++attempt_;
        listening_ = login.attempt;
    }
    const auto opened = ServerConnection::open(communicators_->data(), communicators_->signal(), login,
                                               shared_from_this(), *clock_);
    Refusal failure;
    if (!opened) {
        failure = opened.refusal();
    } else {
        const auto& connection = opened.value();
        if (communicators_->routed()) last_router_ = connection->endpoint();
        connection_.store(connection);
        messages_.connect(connection);
        stops_.connect(connection);
        stops_.withDesk([&](StopDesk& desk) { desk.onConnected(connection->me()); });
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
    messages_.connect(nullptr);
    stops_.connect(nullptr);
    if (connection) connection->drop();
    withCore(
        [&](SessionCore& core) {
            listening_ = 0;
            core.onDisconnected(failure.message);  // forgets the profiles that came before the failure
        },
        Sends::Sender);
    stops_.withDesk([](StopDesk& desk) { desk.onDisconnected(); });
    return failure;
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
            messages_.forget();
            core.onDisconnected(reason);
            closing = direct_.clear();
        },
        Sends::Sender);
    closeAll(closing, "the session with the server is lost");
    if (!counts) return;
    stops_.withDesk([](StopDesk& desk) { desk.onDisconnected(); });
    const auto connection = connection_.load();
    connection_.store(nullptr);
    messages_.connect(nullptr);
    stops_.connect(nullptr);
    if (connection) connection->drop();
    entities_changed_.notify_all();
    news_.tellConnection(false, reason);
    if (options_.reconnect && !closing_) {
        reconnection_.ask();
        threads_.timer.wake();
    }
}

void Client::Session::close() {
    std::call_once(closed_once_, [this] {
        mayWait();
        closing_ = true;
        // Orderly: each entity held stops and is free before the session ends.
        std::vector<std::future<Result<void>>> released;
        withCore([&](SessionCore& core) {
            for (const auto& held : core.leases().held()) {
                auto promise = std::make_shared<std::promise<Result<void>>>();
                released.push_back(promise->get_future());
                news_.remove(held);
                core.leases().release(
                    held, [promise](Result<void> answer) { promise->set_value(std::move(answer)); });
            }
        });
        const auto until = std::chrono::steady_clock::now() + kReleaseTime;
        for (auto& answer : released) answer.wait_until(until);
        messages_.flush();  // what was left to the sender: the end of a check-out that was refused, for one

        const auto connection = connection_.load();
        bool was_up = false;
        DirectLinks::Closing closing;
        withCore([&](SessionCore& core) {
            listening_ = 0;
            was_up = std::exchange(up_, false);
            core.onDisconnected("this client was closed", true);
            closing = direct_.clear();
        });
        closeAll(closing, "this client was closed");
        stops_.withDesk([](StopDesk& desk) {
            desk.onDisconnected();
            desk.endOrders();
        });
        connection_.store(nullptr);
        messages_.connect(nullptr);
        stops_.connect(nullptr);
        entities_changed_.notify_all();
        if (connection && was_up) connection->leave();
        news_.close();
        lane_readers_->end();
        // Joins Ice's threads, and ends a login that the timer thread may be waiting for.
        communicators_->destroy();
        for (auto* thread : {&threads_.sender, &threads_.timer, &threads_.heartbeat, &threads_.stops})
            thread->end();
        datagrams_.close();
    });
}

TimePoint Client::Session::onTimer() {
    std::uint64_t silent = 0;
    withCore(
        [&](SessionCore& core) {
            threads_.timer.turn.begin();
            core.onTimer();
            if (core.serverSilent()) silent = listening_;
        },
        Sends::Sender);
    if (silent != 0) lost(silent, "the server has been silent for too long");
    const auto direct_at = directTurn();
    if (give_up_.exchange(false)) lost(listening_, "this program does not return from its callbacks");

    if (reconnection_.isDue(clock_->now()) && !closing_) {
        const auto established = establish();
        if (established) {
            reconnection_.succeeded();
            news_.tellConnection(true, "connected again");
        } else {
            reconnection_.failed(clock_->now());
        }
    }
    const std::lock_guard lock(core_mutex_);
    return threads_.timer.turn.end(std::min({core_.nextDeadline(), core_.serverDeadline(), reconnection_.at(),
                                             direct_at, clock_->now() + kLongestSleep}));
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
                head.sent_at_us = toMicroseconds(clock_->now());
                messages_.sendMark(head, mark.SerializeAsString(), link, path);
            }
        },
        Sends::Sender);
    for (const auto& [matters, text] : turn.news)
        log().log(matters ? spdlog::level::info : spdlog::level::debug, "client: {}", text);
    if (turn.ended) threads_.sender.wake();
    for (const auto& path : turn.begun) path.second->beat();
    for (const auto& path : turn.open) path->open(timeoutOf(options_));
    if (turn.close.empty()) return turn.next;
    for (const auto& [path, why] : turn.close) path->close(why);
    return clock_->now();  // another turn, in which they have ended
}

TimePoint Client::Session::onHeartbeat() {
    std::optional<MessageSender::Beat> beat;
    std::vector<std::pair<std::shared_ptr<DirectPath>, bool>> paths;  // and whether the entity moves
    withCore(
        [&](SessionCore& core) {
            threads_.heartbeat.turn.begin();
            core.onHeartbeatTimer();
            beat = messages_.takeBeat();
            if (!core.busy()) may_beat_ = true;  // nobody asks the program then
            for (const auto& [entity, path] : *direct_.paths())
                paths.emplace_back(path, core.entities().moving(entity));
        },
        Sends::Sender);
    if (beat) {
        may_beat_ = true;
        if (beat->busy && options_.keep_running) {
            try {
                may_beat_ = options_.keep_running();
            } catch (const std::exception& error) {
                log().warn("client: keep_running threw, which counts as no: {}", error.what());
                may_beat_ = false;
            }
        }
        const auto connection = connection_.load();
        if (may_beat_ && connection) connection->keepAlive(beat->sequence);
    }
    auto path_beats_at = TimePoint::max();
    bool faster = false;
    for (const auto& [path, moving] : paths) {
        const auto [next, its_faster] = path->beatIfDue(moving, may_beat_);
        path_beats_at = std::min(path_beats_at, next);
        faster = faster || its_faster;
    }
    if (faster) threads_.timer.wake();  // which watches for silence
    const std::lock_guard lock(core_mutex_);
    return threads_.heartbeat.turn.end(
        std::min({core_.nextHeartbeat(), path_beats_at, clock_->now() + kLongestSleep}));
}

void Client::Session::newProfile(std::uint64_t attempt, Presence presence, const Registration& registration,
                                 std::string_view profile) {
    stops_.withDesk([&](StopDesk& desk) {
        if (attempt == listening_)
            desk.onEntity(presence, registration.entity, registration.name, !profile.empty());
    });
    DirectLinks::Closing closing;
    onCore(attempt, [&](SessionCore& core) {
        core.onProfile(presence, registration, profile);
        if (presence == Presence::Left) closing = direct_.leave(registration.entity);
    });
    closeAll(closing, "the entity has left");
    entities_changed_.notify_all();
}

void Client::Session::newStatus(std::uint64_t attempt, const EntityStatus& status) {
    onCore(attempt, [&](SessionCore& core) { core.onStatus(status); });
    entities_changed_.notify_all();
}

void Client::Session::newEntityMsg(std::uint64_t attempt, Lane lane, direct::Keeping keeping,
                                   const Header& head, std::string_view message) {
    if (stops_.onReceipt(head, message)) return;
    if (lane == Lane::Signal && head.msg_type == kMsgReply) stops_.onReply(head, message);
    onCore(attempt, [&](SessionCore& core) {
        const auto deliver = [&](const Header& its_head, std::string_view its) {
            core.onEntityMsg(its_head, its, false);
        };
        if (lane == Lane::Signal || direct_.relayed(keeping, head, message, deliver))
            core.onEntityMsg(head, message);
    });
}

void Client::Session::newDirectMsg(const DirectPath& path, direct::Keeping keeping, Header head,
                                   std::string_view message) {
    DirectLinks::Arrival arrival;
    withCore(
        [&](SessionCore& core) {
            messages_.breakBurst();  // as in onCore
            head.sender = core.self();
            arrival = direct_.arrived(path, keeping, head, message);
            if (arrival.pass) core.onEntityMsg(head, message, false);
        },
        Sends::Reader);
    if (arrival.close) arrival.close->close(arrival.why);
    if (arrival.acknowledge) path.beat();
}

void Client::Session::directRead() {
    news_.runHere();
}

void Client::Session::newDirectReceipt(const DirectPath&, const Header& head, std::string_view message) {
    stops_.onReceipt(head, message);
}

void Client::Session::directChanged() {
    threads_.timer.wake();
    threads_.sender.wake();
}

bool Client::Session::direct(const Held& held) const {
    const std::lock_guard lock(core_mutex_);
    return core_.leases().holds(held) && direct_.direct(held.entity);
}

void Client::Session::newRefusal(std::uint64_t attempt, const Header& head, const Refusal& refusal) {
    if (head.msg_type == kMsgWay) {
        DirectLinks::Closing closing;
        onCore(attempt, [&](SessionCore&) { closing = direct_.markRefused(head.entity); });
        return closeAll(closing, "the servers refuse its beginning: " + refusal.message);
    }
    if (head.msg_type == kMsgReset || head.msg_type == kMsgClear)
        stops_.withDesk([&](StopDesk& desk) { desk.onRefusal(head.sequence, head.entity, refusal); });
    if (head.msg_type == kMsgStop) {
        stops_.withDesk([&](StopDesk& desk) { desk.onRefusal(head.sequence, head.entity, refusal); });
        return;
    }
    onCore(attempt, [&](SessionCore& core) { core.onRefusal(head, refusal); });
}

void Client::Session::newStopAccepted(std::uint64_t, const Header& head, int entities) {
    stops_.withDesk([&](StopDesk& desk) { desk.onStopAccepted(head.sequence, head.entity, entities); });
}

void Client::Session::newServerText(std::uint64_t attempt, int code, const std::string& text) {
    onCore(attempt, [&](SessionCore& core) { core.onServerText(code, text); });
}

void Client::Session::newServerHeartbeat(std::uint64_t attempt) {
    onCore(attempt, [&](SessionCore& core) { core.onServerHeartbeat(); });
}

void Client::Session::newServerRelease(const std::string& release) {
    if (const auto note = releases_.onPeer("a server", release)) log().info("client: {}", *note);
}

void Client::Session::onDatagrams(const Held& held, const std::string& endpoint, const std::string& key) {
    datagrams_.admit(held.entity, held.lease, endpoint, key, core_.self().id);
}

void Client::Session::onDirect(const Held& held, const std::string& data_endpoint,
                               const std::string& signal_endpoint, const std::string& key) {
    const auto connection = connection_.load();
    const auto* const facts = core_.entities().facts(held.entity);
    const DirectSurroundings around{
        .wanted = options_.direct,
        .routed = communicators_->routed(),
        .server_tls = !communicators_->routed() && transport::parseEndpoint(options_.server).tls,
        .has_trust = communicators_->tls() != nullptr,
        .known = facts != nullptr,
        .server = connection ? connection->peer() : std::string()};
    if (!mayOpen(data_endpoint, signal_endpoint, around)) {
        if (direct_.withdraw(held)) threads_.timer.wake();
        return;
    }
    direct_.offer({held.entity, held.lease, key, core_.self().id, data_endpoint, signal_endpoint,
                   facts != nullptr ? facts->name : std::string()});
    threads_.timer.wake();
}

Result<Entity> Client::Session::waitFor(std::string_view name, Seconds time) const {
    mayWait();
    const auto until = clock_->now() + toDuration(time);
    std::unique_lock lock(core_mutex_);
    while (true) {
        const auto left = clock_->realTimeUntil(until);
        auto found = core_.entities().find(name);
        if (found && found->ready && availability(found->state) != Availability::Away) return found;
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

}  // namespace axon::client
