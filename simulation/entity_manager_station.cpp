// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/entity_manager_station.hpp"

#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <algorithm>

#include "common/watchdog.hpp"
#include "entity_manager/stop_gate.hpp"
#include "simulation/robot_application.hpp"

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;
using entity_manager::EntityManagerCore;
using entity_manager::Inbox;

// As src/entity_manager/entity_communicator.cpp and back_end_interface.cpp have them.
constexpr Duration kFirstBackoff = 100ms;
constexpr Duration kLastBackoff = 2s;
constexpr Duration kLoginTimeout = 3s;
constexpr Duration kLookPeriod = 100ms;
constexpr Duration kLinkBackoff = 50ms;
constexpr Duration kHelloTime = 1s;
constexpr Duration kWatchdogBusy = 100ms;
constexpr Duration kWatchdogIdle = 500ms;
constexpr int kFirstManager = 100;

Refusal noResources() {
    return {RefusalCode::NotSupported, "The simulation has no resources.", {}};
}

}  // namespace

std::optional<std::string> Disk::load(std::string_view key) {
    const auto found = values_.find(key);
    return found == values_.end() ? std::nullopt : std::optional(found->second);
}
void Disk::save(std::string_view key, std::string_view value) {
    values_[std::string(key)] = value;
}
void Disk::forget(std::string_view key) {
    values_.erase(std::string(key));
}
entity_manager::Later<Result<std::uint64_t>> Disk::begin(const proto::ResourceOffer&, const std::string&) {
    return Result<std::uint64_t>(noResources());
}
entity_manager::Later<Result<std::string>> Disk::check(std::string_view) {
    return Result<std::string>(noResources());
}
entity_manager::Later<Result<std::string>> Disk::place(std::string_view) {
    return Result<std::string>(noResources());
}

bool Disk::append(const entity_manager::JournalRecord& record) {
    records_.push_back(record);
    if (noted) noted(record);
    return true;
}
void Disk::replay(const std::function<void(const entity_manager::JournalRecord&)>& each) {
    for (const auto& record : records_) each(record);
}

/// All that is lost when the process dies.
struct EntityManagerStation::Life {
    Life(EntityManagerStation& station, entity_manager::CoreSettings settings)
        : link_watchdog(kWatchdogBusy, kWatchdogIdle, station.process_.now()),
          core(std::move(settings), station.process_, station.random_, station, station, station.disk_,
               station.disk_, gate, &station.disk_) {}

    entity_manager::StopGate gate;
    Inbox inbox;
    bool server_heard = false;

    // The link to the application.
    std::uint64_t link_attempt = 0;
    std::uint64_t link = 0;  ///< the application's number of it; 0 = none
    Connection* link_signal = nullptr;
    Connection* link_data = nullptr;
    Watchdog link_watchdog;
    std::uint32_t announced = 0;

    // The session with the server.
    bool wanted = false;
    bool up = false;
    std::uint64_t attempt = 0;
    Duration backoff = kFirstBackoff;
    Connection* data = nullptr;
    Connection* signal = nullptr;
    ServerStation::EntitySession* session = nullptr;
    bool busy = false;
    Duration busy_period = 50ms;
    Duration idle_period = 2s;

    EntityManagerCore core;  // last: it speaks to all of the above
};

EntityManagerStation::EntityManagerStation(Timeline& timeline, Network& network, Dice& dice,
                                           Observer& observer, ServerStation& server, Process& outside,
                                           RobotApplication& application, std::size_t entity,
                                           std::uint64_t seed)
    : timeline_(timeline),
      network_(network),
      dice_(dice),
      observer_(observer),
      server_(server),
      outside_(outside),
      application_(application),
      entity_(entity),
      process_(timeline, kFirstManager + static_cast<int>(entity), application.process().name() + ".em"),
      random_(seed),
      alarm_(timeline, process_,
             [this] {
                 if (std::exchange(life_->server_heard, false)) life_->core.onServerHeartbeat();
                 life_->core.onTimer();
                 settle();
             }),
      beat_(timeline, process_, [this] { keepAlive(); }) {
    loopback_.fastest = 10us;
    loopback_.slowest = 60us;
    disk_.noted = [this](const entity_manager::JournalRecord& record) { observer_.noted(entity_, record); };
}

EntityManagerStation::~EntityManagerStation() = default;

const EntityManagerCore* EntityManagerStation::core() const {
    return life_ ? &life_->core : nullptr;
}

void EntityManagerStation::start() {
    process_.start();
    alarm_.forget();
    beat_.forget();
    observer_.managerStarts(entity_);
    entity_manager::CoreSettings settings;
    settings.application = application_.process().name();
    life_ = std::make_unique<Life>(*this, std::move(settings));
    life_->core.start();
    lookIn(Duration{});
    settle();
}

void EntityManagerStation::kill() {
    process_.die();
    observer_.managerDies(entity_);
    life_.reset();
}

void EntityManagerStation::settle() {
    observer_.managerIs(entity_, life_->core.status());
    alarm_.set(life_->core.nextDeadline());
}

// -- the strand

void EntityManagerStation::wakeStrand(Inbox::Verdict verdict) {
    if (verdict == Inbox::Verdict::Overflow)
        observer_.violated(Invariant::Bounded, application_.process().name() + ": the inbox has overflowed");
    if (verdict != Inbox::Verdict::Scheduled) return;
    const auto takes = dice_.chance(0.02) ? dice_.between(100us, 8ms) : dice_.between(2us, 60us);
    timeline_.after(takes, process_, [this] { drain(); });
}

void EntityManagerStation::drain() {
    while (const auto event = life_->inbox.take()) {
        event();
        observer_.managerIs(entity_, life_->core.status());
    }
    alarm_.set(life_->core.nextDeadline());
}

void EntityManagerStation::handleClientMsg(const Header& head, const std::string& bytes) {
    if (head.msg_type == kMsgTask) {
        proto::ToEntity message;
        if (message.ParseFromString(bytes))
            observer_.taskArrives(entity_, head, message.task(), process_.now());
    }
    timeline_.tell(process_.name(), [&] {
        return head.msg_type + " of " + head.sender.name + ", lease " + std::to_string(head.held.epoch) +
               '.' + std::to_string(head.held.number) + ", generation " +
               std::to_string(head.stop_generation);
    });
    observer_.inHand(entity_, &head);
    life_->core.onClientMsg(head, bytes);
    observer_.managerIs(entity_, life_->core.status());
    observer_.inHand(entity_, nullptr);
}

// -- from the server

bool EntityManagerStation::hears(std::uint64_t attempt) const {
    return life_ && life_->attempt == attempt;
}

void EntityManagerStation::newClientMsg(std::uint64_t attempt, const Header& head, const std::string& bytes,
                                        bool repeated) {
    if (!hears(attempt)) return;
    wakeStrand(life_->inbox.pushControl([this, head, bytes] { handleClientMsg(head, bytes); }, bytes.size()));
    if (repeated || mischief_.repeats <= 0 || !dice_.chance(mischief_.repeats)) return;
    const auto again = dice_.between(Duration{}, mischief_.repeats_within);
    if (head.msg_type != kMsgCheckOut && head.msg_type != kMsgRearm) {
        // Kept by somebody on the way, so that it may come in another life.
        timeline_.after(again, outside_, [this, head, bytes] {
            if (life_ && life_->up && process_.running()) newClientMsg(life_->attempt, head, bytes, true);
        });
        return;
    }
    timeline_.after(again, process_,
                    [this, attempt, head, bytes] { newClientMsg(attempt, head, bytes, true); });
}

void EntityManagerStation::newClientMsgDataSeq(std::uint64_t attempt, const Header& head,
                                               const std::string& bytes) {
    if (!hears(attempt)) return;
    wakeStrand(life_->inbox.pushData([this, head, bytes] { handleClientMsg(head, bytes); }, bytes.size()));
}

void EntityManagerStation::stopSignal(std::uint64_t attempt, const Header& head, StopCause cause,
                                      bool repeated) {
    if (!hears(attempt)) return;
    auto& life = *life_;
    if (!repeated && mischief_.repeats > 0 && dice_.chance(mischief_.repeats)) {
        timeline_.after(dice_.between(Duration{}, mischief_.repeats_within), process_,
                        [this, attempt, head, cause] { stopSignal(attempt, head, cause, true); });
    }
    // As EntityManager::stopSignal does it.
    if (cause == StopCause::ClientLost && life.gate.sparesClientLoss()) {
        newClientUpdate(attempt, head, ClientChange::Lost);
        return;
    }
    if (cause == StopCause::Drill) {
        if (life.inbox.wouldDrop(senderKey(head.sender.id))) return;
        const auto number = life.gate.drill(head.sender.id, head.sequence);
        if (!number) return;
        stop(*number, cause);
        wakeStrand(life.inbox.pushSignal(
            Inbox::Signal::Passing, [this, head, number = *number] { life_->core.onDrill(head, number); }, senderKey(head.sender.id)));
        return;
    }
    const auto generation = life.gate.raise(head.sender.id, head.sequence);
    if (!generation) {
        if (const auto known = life.gate.raisedBy(head.sender.id, head.sequence))
            wakeStrand(life.inbox.pushSignal(Inbox::Signal::Passing, [this, head, cause, known = *known] {
                life_->core.onStopRepeated(head, cause, known);
            }, senderKey(head.sender.id)));
        return;
    }
    observer_.stopRaises(entity_, head, process_.life());
    signal_thread_ = true;
    stop(*generation, cause);
    signal_thread_ = false;
    wakeStrand(life.inbox.pushSignal(Inbox::Signal::Stop, [this, head, cause, generation = *generation] {
        life_->core.onStopSignal(head, cause, generation);
    }));
}

void EntityManagerStation::resetSignal(std::uint64_t attempt, const Header& head) {
    if (hears(attempt))
        wakeStrand(life_->inbox.pushSignal(Inbox::Signal::Passing,
                                           [this, head] { life_->core.onResetSignal(head); }, senderKey(head.sender.id)));
}
void EntityManagerStation::clearSignal(std::uint64_t attempt, const Header& head) {
    if (hears(attempt))
        wakeStrand(life_->inbox.pushSignal(Inbox::Signal::Passing,
                                           [this, head] { life_->core.onClearSignal(head); }, senderKey(head.sender.id)));
}
void EntityManagerStation::newClientUpdate(std::uint64_t attempt, const Header& head, ClientChange change) {
    if (hears(attempt))
        wakeStrand(life_->inbox.pushSignal(
            Inbox::Signal::Client, [this, head, change] { life_->core.onClientUpdate(head, change); }));
}
void EntityManagerStation::newHeartbeat(std::uint64_t attempt) {
    if (hears(attempt)) life_->core.onServerHeartbeat();
}

// -- the link to the application

void EntityManagerStation::lookIn(Duration time) {
    timeline_.after(time, process_, [this] { look(); });
}

void EntityManagerStation::look() {
    auto& life = *life_;
    if (life.link != 0) return;
    if (!application_.process().alive()) return lookIn(kLookPeriod);
    const auto attempt = ++attempts_;
    life.link_attempt = attempt;
    life.link_signal = &network_.connect(loopback_, process_, application_.process());
    life.link_data = &network_.connect(loopback_, process_, application_.process());
    life.link_signal->send(process_, [this, attempt, signal = life.link_signal, data = life.link_data] {
        application_.hello(attempt, *signal, *data);
    });
    timeline_.after(kHelloTime, process_, [this, attempt] {
        if (life_->link_attempt == attempt && life_->link == 0) linkAnswered(attempt, 0);
    });
}

void EntityManagerStation::linkAnswered(std::uint64_t attempt, std::uint64_t link) {
    auto& life = *life_;
    if (life.link_attempt != attempt || life.link != 0) return;
    if (link == 0) {  // linked with an earlier life of this Entity Manager, or silent
        life.link_attempt = 0;
        life.link_signal->close(process_);
        life.link_data->close(process_);
        return lookIn(kLookPeriod);
    }
    life.link = link;
    for (auto* connection : {life.link_signal, life.link_data})
        connection->onClosed(process_,
                             [this, link] { linkLost(link, "the robot application has closed the link"); });
    if (!life.link_signal->openAt(process_) || !life.link_data->openAt(process_))
        return linkLost(link, "the robot application has closed the link");
    life.link_watchdog.feed(process_.now());
    life.announced = life.gate.generation();
    beat();
    life.core.onLinkUp();
    settle();
    if (application_.process().frozen()) applicationFrozen();
}

void EntityManagerStation::linkLost(std::uint64_t link, const char* reason, entity_manager::LinkEnd end) {
    auto& life = *life_;
    if (life.link != link || link == 0) return;
    life.link = 0;
    life.link_signal->close(process_);
    life.link_data->close(process_);
    lookIn(kLinkBackoff);
    observer_.linkLost(entity_);
    life.core.onLinkDown(reason, end);
    settle();
}

void EntityManagerStation::linkMessage(std::uint64_t link, const std::string& bytes) {
    if (life_->link != link) {
        // It came with the answer of the handshake, and that is still on its way on the other connection.
        if (life_->link == 0 && life_->link_attempt != 0)
            timeline_.after(100us, process_, [this, link, bytes] { linkMessage(link, bytes); });
        return;
    }
    proto::EiToEm message;
    message.ParseFromString(bytes);
    life_->core.onLinkMessage(std::move(message));
    settle();
}

void EntityManagerStation::stopDone(std::uint64_t link, std::uint32_t generation) {
    if (life_->link != link) return;
    proto::EiToEm message;
    message.mutable_stop_done()->set_stop_generation(generation);
    message.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
    life_->core.onLinkMessage(std::move(message));
    settle();
}

void EntityManagerStation::drillDone(std::uint64_t link, std::uint32_t number) {
    if (life_->link != link) return;
    proto::EiToEm message;
    message.mutable_stop_done()->set_drill(number);
    message.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
    life_->core.onLinkMessage(std::move(message));
    settle();
}

void EntityManagerStation::applicationFrozen() {
    if (!life_ || life_->link == 0) return;
    life_->link_watchdog.feed(process_.now());
    judgeSilence();
}

/// A frozen application beats no more; a running one has just been heard.
void EntityManagerStation::judgeSilence() {
    if (!life_ || life_->link == 0) return;
    auto& life = *life_;
    if (!application_.process().frozen()) {
        life.link_watchdog.feed(process_.now());
        return;
    }
    if (life.link_watchdog.expired(process_.now())) {
        linkLost(life.link, "the robot application has been silent", entity_manager::LinkEnd::Silent);
        return;
    }
    timeline_.at(process_.whenItShows(life.link_watchdog.deadline()), process_, [this, link = life.link] {
        if (life_->link == link) judgeSilence();
    });
}

bool EntityManagerStation::send(const proto::EmToEi& message) {
    auto& life = *life_;
    observer_.toApplication(entity_, message, process_.now());
    if (life.link == 0) return true;
    if (message.has_task() && message.task().stop_generation() > life.announced) {
        life.announced = message.task().stop_generation();
        beat();
    }
    life.link_data->send(process_, [this, link = life.link, bytes = message.SerializeAsString()] {
        application_.onData(link, bytes);
    });
    return true;
}

void EntityManagerStation::stop(std::uint32_t generation, StopCause cause) {
    auto& life = *life_;
    if (cause != StopCause::Drill) observer_.stopGoesOut(entity_, generation, cause, signal_thread_);
    if (life.link != 0)
        life.link_signal->send(process_, [this, link = life.link, generation, cause] {
            application_.onStop(link, generation, cause);
        });
    if (cause != StopCause::Drill) life.announced = std::max(life.announced, generation);
}

void EntityManagerStation::setBusy(bool busy) {
    auto& life = *life_;
    if (life.link_watchdog.busy() == busy) return;
    life.link_watchdog.setBusy(busy, process_.now());
    if (life.link == 0) return;
    beat();
    if (application_.process().frozen()) judgeSilence();
}

void EntityManagerStation::beat() {
    auto& life = *life_;
    life.link_signal->send(
        process_, [this, link = life.link, generation = life.announced, busy = life.link_watchdog.busy()] {
            application_.onBeat(link, generation, busy);
        });
}

// -- the session with the server

void EntityManagerStation::wantConnection(bool wanted) {
    auto& life = *life_;
    if (life.wanted == wanted) return;
    life.wanted = wanted;
    if (wanted) {
        life.backoff = kFirstBackoff;
        login();
        return;
    }
    if (life.up)
        life.data->send(process_, [server = &server_, session = life.session] {
            server->entityGone(*session, true, "it ended its session");
        });
    dropServer();
}

void EntityManagerStation::login() {
    auto& life = *life_;
    const auto attempt = ++attempts_;
    life.attempt = attempt;
    auto& data = network_.connect(server_path_, process_, server_.process());
    life.data = &data;
    life.signal = nullptr;
    data.onClosed(process_, [this, attempt] { serverLost(attempt, "the server closed the connection"); });
    data.send(process_, [this, attempt, &data] { server_.entityHello(*this, attempt, data); });
    if (!server_.process().alive()) data.refused(process_);
    timeline_.after(kLoginTimeout, process_, [this, attempt] {
        if (hears(attempt) && !life_->up) serverLost(attempt, "no answer to the login");
    });
}

void EntityManagerStation::welcomed(std::uint64_t attempt, ServerStation::EntitySession& session,
                                    const std::string& token) {
    if (!hears(attempt)) return;
    life_->session = &session;
    auto& signal = network_.connect(server_path_, process_, server_.process());
    life_->signal = &signal;
    signal.onClosed(process_, [this, attempt] { serverLost(attempt, "the server closed the signal lane"); });
    signal.send(process_, [this, &session, &signal, token] { server_.entityAttach(session, signal, token); });
    if (!server_.process().alive()) signal.refused(process_);
}

void EntityManagerStation::attached(std::uint64_t attempt) {
    if (!hears(attempt)) return;
    auto& life = *life_;
    life.up = true;
    life.busy = false;
    life.core.onServerUp();
    keepAlive();
    settle();
}

void EntityManagerStation::registered(std::uint64_t attempt, bool ok) {
    if (!hears(attempt)) return;
    if (ok)
        life_->backoff = kFirstBackoff;
    else
        serverLost(attempt, "the registration was refused");
}

void EntityManagerStation::serverLost(std::uint64_t attempt, const char* reason) {
    if (!hears(attempt)) return;
    auto& life = *life_;
    const bool was_up = life.up;
    dropServer();
    const auto dropped = life.attempt;
    if (was_up) {
        observer_.hurt(process_.name() + " has lost its session: " + reason);
        life.core.onServerDown(reason);
        settle();
    }
    if (!life.wanted) return;
    timeline_.after(life.backoff, process_, [this, dropped] {
        if (life_->wanted && !life_->up && life_->attempt == dropped) login();
    });
    life.backoff = std::min(life.backoff * 2, kLastBackoff);
}

void EntityManagerStation::dropServer() {
    auto& life = *life_;
    life.attempt = ++attempts_;
    life.up = false;
    if (life.data != nullptr) life.data->close(process_);
    if (life.signal != nullptr) life.signal->close(process_);
}

void EntityManagerStation::keepAlive() {
    auto& life = *life_;
    if (!life.up) return;
    life.signal->beat(process_, [server = &server_, session = life.session] { server->keepAlive(*session); });
    beat_.set(process_.now() + (life.busy ? life.busy_period : life.idle_period));
}

void EntityManagerStation::sendBasicPrfl(const Registration& registration,
                                         const proto::BasicProfile& profile) {
    auto& life = *life_;
    if (!life.up) return;
    life.busy_period = std::chrono::milliseconds(registration.heartbeat_busy_ms);
    life.idle_period = std::chrono::milliseconds(registration.heartbeat_idle_ms);
    life.data->send(process_, [server = &server_, session = life.session, registration,
                               bytes = profile.SerializeAsString()] {
        server->sendBasicPrfl(*session, registration, bytes);
    });
}

void EntityManagerStation::sendStatus(const EntityStatus& status) {
    auto& life = *life_;
    if (!life.up) return;
    life.data->send(process_, [server = &server_, session = life.session, status] {
        server->sendStatus(*session, status);
    });
    const bool busy = status.state == EntityState::BUSY;
    if (std::exchange(life.busy, busy) != busy) keepAlive();
}

void EntityManagerStation::sendToClient(Lane lane, const Header& head, const proto::ToClient& message) {
    auto& life = *life_;
    observer_.toClient(entity_, head, message);
    if (!life.up) return;
    auto* connection = lane == Lane::Signal ? life.signal : life.data;
    connection->send(process_, [server = &server_, session = life.session, lane, head,
                                bytes = message.SerializeAsString()] {
        server->sendToClient(*session, lane, head, bytes);
    });
}

void EntityManagerStation::sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) {
    auto& life = *life_;
    if (!life.up) return;
    auto* connection = lane == Lane::Signal ? life.signal : life.data;
    connection->send(process_, [server = &server_, session = life.session, lane, head,
                                bytes = message.SerializeAsString()] {
        server->sendToPeer(*session, lane, head, bytes);
    });
}

void EntityManagerStation::sendToClientDataSeq(const Header& head, const proto::ToClient& message) {
    auto& life = *life_;
    if (!life.up) return;
    life.data->send(process_,
                    [server = &server_, session = life.session, head, bytes = message.SerializeAsString()] {
                        server->sendToClientDataSeq(*session, head, bytes);
                    });
}

}  // namespace axon::simulation
