// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/entity_manager_station.hpp"

#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <algorithm>

#include "common/backoff.hpp"
#include "common/liveness.hpp"
#include "common/rate_limit.hpp"
#include "direct/always_relayed.hpp"
#include "entity_manager/ports/stop_generations.hpp"
#include "simulation/robot_application.hpp"

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;
using entity_manager::EntityManagerCore;
using entity_manager::Inbox;

// As src/entity_manager/links/server/entity_communicator.cpp and back_end_interface.cpp have them.
constexpr Duration kFirstBackoff = 100ms;
constexpr Duration kLastBackoff = 2s;
constexpr Duration kLoginTimeout = 3s;
constexpr Duration kLookPeriod = 100ms;
constexpr Duration kLinkBackoff = 50ms;
constexpr Duration kHelloTime = 1s;
constexpr Duration kWatchdogBusy = 100ms;
constexpr Duration kWatchdogIdle = 500ms;
constexpr int kFirstManager = 100;
// As src/entity_manager/links/direct/direct_door.cpp and entity_manager.cpp have them.
constexpr std::size_t kChallenges = 64;
constexpr int kOpenings = 8;

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

/// The relayed way, in place of EntityCommunicator.
class EntityManagerStation::Servers final : public entity_manager::RelayedWay {
  public:
    explicit Servers(EntityManagerStation& station) : station_(station) {}
    void wantConnection(bool wanted) override;
    void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) override;
    void sendStatus(const EntityStatus& status) override;
    void sendToClient(Lane lane, const Header& head, const proto::ToClient& message) override {
        toClient(lane, head, message.SerializeAsString());
    }
    void sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) override;
    void sendToClientDataSeq(const Header& head, const proto::ToClient& message) override;
    void sendToClientBytes(Lane lane, const Header& head, const std::string& message) override {
        if (lane == Lane::Data) ++station_.observer_.counts().sent_again;
        toClient(lane, head, message);
    }

  private:
    void toClient(Lane lane, const Header& head, std::string bytes);
    EntityManagerStation& station_;
};

/// One lane of a direct path, as IceLane.
class EntityManagerStation::BackLane final : public entity_manager::DirectLane {
  public:
    BackLane(EntityManagerStation& station, Connection& connection, Lane lane,
             std::weak_ptr<DirectCaller> caller)
        : station_(station), connection_(connection), lane_(lane), caller_(std::move(caller)) {}
    void send(direct::Keeping keeping, const Header& head,
              std::shared_ptr<const std::string> message) override {
        connection_.send(station_.process_,
                         [caller = caller_, lane = lane_, keeping, head, message = std::move(message)] {
                             if (const auto to = caller.lock())
                                 to->newEntityMsg(lane, keeping, head, *message);
                         });
    }
    void beat(std::int64_t passed, bool asks) override {
        connection_.beat(station_.process_, [caller = caller_, passed, asks] {
            if (const auto to = caller.lock()) to->newHeartbeat(passed, asks);
        });
    }
    void close(const std::string& why) override {
        connection_.close(station_.process_);
        const auto caller = caller_.lock();
        if (lane_ == Lane::Signal) station_.pathEnds(why, !caller || caller->honest());
        station_.closed(connection_);
    }
    std::string peer() const override { return "the simulated network"; }

  private:
    EntityManagerStation& station_;
    Connection& connection_;
    const Lane lane_;
    const std::weak_ptr<DirectCaller> caller_;
};

/// All that is lost when the process dies.
struct EntityManagerStation::Life {
    Life(EntityManagerStation& station, entity_manager::EntityManagerCoreSettings settings)
        : liveness(kWatchdogBusy, kWatchdogIdle, station.process_.now()),
          servers(station),
          ways(station.process_, servers,
               [&station](bool, const std::string& line) {
                   station.timeline_.tell(station.process_.name(), [&] { return line; });
               }),
          core(std::move(settings), station.process_, station.random_, station, station, station.disk_,
               station.disk_, stop_generations, &station.disk_) {}

    entity_manager::StopGenerations stop_generations;
    Inbox inbox;
    bool server_heard = false;

    // The link to the application.
    std::uint64_t link_attempt = 0;
    std::uint64_t link = 0;  ///< the application's number of it; 0 = none
    Connection* link_signal = nullptr;
    Connection* link_data = nullptr;
    Liveness liveness;  // of the application
    std::uint32_t announced = 0;

    // The session with the server.
    bool wanted = false;
    bool up = false;
    std::uint64_t attempt = 0;
    Backoff backoff{kFirstBackoff, kLastBackoff};
    Connection* data = nullptr;
    Connection* signal = nullptr;
    ServerStation::EntitySession* session = nullptr;
    bool busy = false;
    Duration busy_period = 50ms;
    Duration idle_period = 2s;

    // The direct path: the product's desk, and what the door has in place of it.
    struct Session {  ///< DirectSession
        Id128 path;
        Lane lane;
        Sender sender;
        std::shared_ptr<entity_manager::DirectSigns> signs;
        std::shared_ptr<entity_manager::DirectLane> back;
        std::shared_ptr<RateLimit> drills;
    };
    std::deque<std::pair<const Connection*, Id128>> challenges;
    std::unordered_map<const Connection*, Session> sessions;  // only looked up
    int openings = 0;
    Servers servers;
    entity_manager::DirectDesk ways;

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
                 life_->ways.onTimer();
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
    entity_manager::EntityManagerCoreSettings settings;
    settings.application = application_.process().name();
    life_ = std::make_unique<Life>(*this, std::move(settings));
    life_->ways.setEntity(life_->core.uuid());
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
    armAlarm();
}

/// As EntityManager::afterEvents.
void EntityManagerStation::armAlarm() {
    life_->ways.hold(life_->core.held());
    alarm_.set(std::min(life_->core.nextDeadline(), life_->ways.nextDeadline()));
}

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
    armAlarm();
}

template <class Use>
void EntityManagerStation::onStrand(Use use) {
    timeline_.after(dice_.between(2us, 60us), process_, [this, use = std::move(use)] {
        use();
        settle();
    });
}

void EntityManagerStation::handleRelayed(direct::Keeping keeping, const Header& head,
                                         const std::string& bytes, bool repeated) {
    const auto deliver = [this](const Header& its_head, const std::string& its) {
        observer_.passes(entity_, its_head, false);
        handleClientMsg(its_head, its);
    };
    if (!life_->ways.relayed(keeping, head, bytes, deliver)) return;
    if (keeping == direct::Keeping::Kept && !direct::alwaysRelayed(head.msg_type))
        observer_.passes(entity_, head, repeated);
    handleClientMsg(head, bytes);
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

bool EntityManagerStation::hears(std::uint64_t attempt) const {
    return life_ && life_->attempt == attempt;
}

void EntityManagerStation::newClientMsg(std::uint64_t attempt, const Header& head, const std::string& bytes,
                                        bool repeated) {
    if (!hears(attempt)) return;
    wakeStrand(life_->inbox.pushControl(
        [this, head, bytes, repeated] { handleRelayed(direct::Keeping::Kept, head, bytes, repeated); },
        bytes.size()));
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
    wakeStrand(life_->inbox.pushData(
        [this, head, bytes] { handleRelayed(direct::Keeping::Droppable, head, bytes, false); },
        bytes.size()));
}

void EntityManagerStation::stopSignal(std::uint64_t attempt, const Header& head, StopCause cause,
                                      bool repeated) {
    if (!hears(attempt)) return;
    if (!repeated && mischief_.repeats > 0 && dice_.chance(mischief_.repeats)) {
        timeline_.after(dice_.between(Duration{}, mischief_.repeats_within), process_,
                        [this, attempt, head, cause] { stopSignal(attempt, head, cause, true); });
    }
    passStop(head, cause);
}

/// As EntityManager::stopSignal does it.
void EntityManagerStation::passStop(const Header& head, StopCause cause) {
    auto& life = *life_;
    if (cause == StopCause::ClientLost && life.stop_generations.sparesClientLoss()) {
        newClientUpdate(life.attempt, head, ClientChange::Lost);
        return;
    }
    if (cause == StopCause::Drill) {
        if (life.inbox.wouldDrop(senderKey(head.sender.id))) return;
        const auto number = life.stop_generations.drill(head.sender.id, head.sequence);
        if (!number) return;
        stop(*number, cause);
        wakeStrand(life.inbox.pushSignal(
            Inbox::Signal::Passing, [this, head, number = *number] { life_->core.onDrill(head, number); },
            senderKey(head.sender.id)));
        return;
    }
    const auto generation = life.stop_generations.raise(head.sender.id, head.sequence);
    if (!generation) {
        if (const auto known = life.stop_generations.raisedBy(head.sender.id, head.sequence))
            wakeStrand(life.inbox.pushSignal(
                Inbox::Signal::Passing,
                [this, head, cause, known = *known] { life_->core.onStopRepeated(head, cause, known); },
                senderKey(head.sender.id)));
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
    if (hears(attempt)) passReset(head);
}
void EntityManagerStation::clearSignal(std::uint64_t attempt, const Header& head) {
    if (hears(attempt)) passClear(head);
}
void EntityManagerStation::passReset(const Header& head) {
    wakeStrand(life_->inbox.pushSignal(
        Inbox::Signal::Passing, [this, head] { life_->core.onResetSignal(head); },
        senderKey(head.sender.id)));
}
void EntityManagerStation::passClear(const Header& head) {
    wakeStrand(life_->inbox.pushSignal(
        Inbox::Signal::Passing, [this, head] { life_->core.onClearSignal(head); },
        senderKey(head.sender.id)));
}
void EntityManagerStation::newClientUpdate(std::uint64_t attempt, const Header& head, ClientChange change) {
    if (hears(attempt))
        wakeStrand(life_->inbox.pushSignal(
            Inbox::Signal::Client, [this, head, change] { life_->core.onClientUpdate(head, change); }));
}
void EntityManagerStation::newHeartbeat(std::uint64_t attempt) {
    if (hears(attempt)) life_->core.onServerHeartbeat();
}

void EntityManagerStation::challenge(Connection& connection, Lane port, std::weak_ptr<DirectCaller> caller) {
    auto& challenges = life_->challenges;
    std::erase_if(challenges, [&](const auto& one) { return one.first == &connection; });
    if (challenges.size() >= kChallenges) challenges.pop_front();
    const auto nonce = Id128::random(random_);
    challenges.emplace_back(&connection, nonce);
    connection.send(process_, [caller = std::move(caller), port, nonce] {
        if (const auto to = caller.lock()) to->challenged(port, nonce);
    });
}

void EntityManagerStation::open(Connection& connection, Lane port, const SaidOpening& said,
                                std::weak_ptr<DirectCaller> caller) {
    const auto refuse = [this, &connection, port, caller](const Refusal& refusal) {
        connection.send(process_, [caller, port, refusal] {
            if (const auto to = caller.lock()) to->refused(port, refusal);
        });
    };
    if (said.claim.path.isZero() || said.claim.lane != port)
        return refuse({RefusalCode::Malformed, "no path, or the other port's lane", {}});
    auto& challenges = life_->challenges;
    const auto found = std::find_if(challenges.begin(), challenges.end(),
                                    [&](const auto& one) { return one.first == &connection; });
    if (found == challenges.end())
        return refuse({RefusalCode::WrongState, "no challenge before it over this connection", {}});
    entity_manager::DirectOpening opening;
    opening.claim = said.claim;
    opening.claim.nonce = found->second;
    opening.proof = said.proof;
    challenges.erase(found);
    if (life_->openings >= kOpenings)
        return refuse({RefusalCode::Overloaded, "others open direct paths at the moment", {}});
    ++life_->openings;
    opening.refuse = refuse;
    opening.admit = [this, &connection, port, path = said.claim.path, claim = opening.claim,
                     its = opening.proof,
                     caller](const Sender& sender, std::shared_ptr<entity_manager::DirectSigns> signs,
                             const std::string& proof) {
        const auto* held = life_->core.held();
        overheard_ = SaidOpening{claim, its};
        observer_.pathOpens(entity_,
                            held != nullptr && held->number == claim.lease &&
                                Id128::parse(uuidOf(held->holder.id)) == claim.client &&
                                its == direct::proofOf(claim, direct::Prover::Client, held->key.bytes()));
        return admit(connection, port, path, sender, signs, proof, caller);
    };
    onStrand([this, opening = std::move(opening)] {
        --life_->openings;
        life_->ways.onOpening(opening, life_->core.held());
    });
}

std::shared_ptr<entity_manager::DirectLane> EntityManagerStation::admit(
    Connection& connection, Lane lane, const Id128& path, const Sender& sender,
    const std::shared_ptr<entity_manager::DirectSigns>& signs, const std::string& proof,
    const std::weak_ptr<DirectCaller>& caller) {
    auto back = std::make_shared<BackLane>(*this, connection, lane, caller);
    life_->sessions[&connection] = {path,  lane, sender,
                                    signs, back, std::make_shared<RateLimit>(kDrillsPerSecond)};
    connection.onClosed(process_, [this, &connection, path] {
        closed(connection);
        onStrand([this, path] { life_->ways.onClosed(path, "its holder's end is closed"); });
    });
    connection.send(process_, [caller, lane, proof] {
        if (const auto to = caller.lock()) to->opened(lane, proof);
    });
    if (lane == Lane::Signal) ++observer_.counts().paths;
    return back;
}

void EntityManagerStation::closed(const Connection& connection) {
    life_->sessions.erase(&connection);
}

void EntityManagerStation::pathEnds(const std::string& why, bool honest) {
    ++observer_.counts().paths_ended;
    if (why == "its holder's end is closed" || why == "the lease has ended") return;
    ++observer_.counts().paths_broken;
    if (honest) observer_.pathHurt(process_.name() + ": a direct path ends: " + why);
}

/// The head of what has come on this lane, as of who has opened it; none where nobody has.
std::optional<Header> EntityManagerStation::properHead(const Connection& connection, Lane lane,
                                                       const Header& said) const {
    const auto session = life_->sessions.find(&connection);
    if (session == life_->sessions.end() || session->second.lane != lane) return std::nullopt;
    auto head = said;
    head.sender = session->second.sender;
    head.entity = life_->core.uuid();
    return head;
}

void EntityManagerStation::sendToEntity(Connection& connection, direct::Keeping keeping, const Header& said,
                                        const std::string& bytes) {
    const auto head = properHead(connection, Lane::Data, said);
    if (!head) return;
    auto event = [this, path = life_->sessions.at(&connection).path, keeping, head = *head, bytes] {
        auto its = head;
        auto message = bytes;
        if (!life_->ways.arrived(path, keeping, its, message)) return;
        if (keeping == direct::Keeping::Kept) observer_.passes(entity_, its, false);
        handleClientMsg(its, message);
    };
    wakeStrand(keeping == direct::Keeping::Droppable
                   ? life_->inbox.pushData(std::move(event), bytes.size())
                   : life_->inbox.pushControl(std::move(event), bytes.size(), Inbox::Share::Half));
}

void EntityManagerStation::sendStopSignal(Connection& connection, const Header& said, StopCause cause) {
    auto head = properHead(connection, Lane::Signal, said);
    if (!head) return;
    if (cause != StopCause::Drill) cause = StopCause::Requested;
    if (head->sequence >= kServerSequences) head->sequence = 0;
    if (cause == StopCause::Drill && !life_->sessions.at(&connection).drills->admit(process_.now())) return;
    passStop(*head, cause);
}
void EntityManagerStation::sendResetSignal(Connection& connection, const Header& said) {
    if (const auto head = properHead(connection, Lane::Signal, said)) passReset(*head);
}
void EntityManagerStation::sendClearSignal(Connection& connection, const Header& said) {
    if (const auto head = properHead(connection, Lane::Signal, said)) passClear(*head);
}

void EntityManagerStation::keepAlive(Connection& connection, std::int64_t received, bool busy) {
    if (!properHead(connection, Lane::Signal, {})) return;
    const auto& session = life_->sessions.at(&connection);
    const bool faster = session.signs->heard(process_.now(), received, busy);
    session.back->beat(session.signs->passed.load(), false);
    if (faster) onStrand([] {});
}

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
    life.liveness.heard(process_.now());
    life.announced = life.stop_generations.generation();
    beat();
    life.core.onLinkUp();
    settle();
    if (application_.process().frozen()) applicationFrozen();
}

void EntityManagerStation::linkLost(std::uint64_t link, const char* reason, entity_manager::LinkEnd end) {
    auto& life = *life_;
    if (life.link != link || link == 0) return;
    life.link = 0;
    life.link_attempt = 0;  // or the end of its hello's time gives up a second search
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
    life_->liveness.heard(process_.now());
    judgeSilence();
}

/// A frozen application beats no more; a running one has just been heard.
void EntityManagerStation::judgeSilence() {
    if (!life_ || life_->link == 0) return;
    auto& life = *life_;
    if (!application_.process().frozen()) {
        life.liveness.heard(process_.now());
        return;
    }
    if (life.liveness.expired(process_.now())) {
        linkLost(life.link, "the robot application has been silent", entity_manager::LinkEnd::Silent);
        return;
    }
    timeline_.at(process_.whenItShows(life.liveness.deadline()), process_, [this, link = life.link] {
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
    if (life.liveness.busy() == busy) return;
    life.liveness.setBusy(busy, process_.now());
    if (life.link == 0) return;
    beat();
    if (application_.process().frozen()) judgeSilence();
}

void EntityManagerStation::beat() {
    auto& life = *life_;
    life.link_signal->send(
        process_, [this, link = life.link, generation = life.announced, busy = life.liveness.busy()] {
            application_.onBeat(link, generation, busy);
        });
}

void EntityManagerStation::wantConnection(bool wanted) {
    life_->ways.wantConnection(wanted);
}
void EntityManagerStation::sendBasicPrfl(const Registration& registration,
                                         const proto::BasicProfile& profile) {
    life_->ways.sendBasicPrfl(registration, profile);
}
void EntityManagerStation::sendStatus(const EntityStatus& status) {
    life_->ways.sendStatus(status);
}
void EntityManagerStation::sendToClient(Lane lane, const Header& head, const proto::ToClient& message) {
    observer_.toClient(entity_, head, message);
    if (lane == Lane::Data && !direct::alwaysRelayed(head.msg_type)) observer_.tells(head);
    life_->ways.sendToClient(lane, head, message);
}
void EntityManagerStation::sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) {
    life_->ways.sendToPeer(lane, head, message);
}
void EntityManagerStation::sendToClientDataSeq(const Header& head, const proto::ToClient& message) {
    life_->ways.sendToClientDataSeq(head, message);
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
    const auto& name = application_.process().name();
    life.core.offerDirect(endpointOf(name, Lane::Data), endpointOf(name, Lane::Signal));
    life.core.onServerUp();
    keepAlive();
    settle();
}

void EntityManagerStation::registered(std::uint64_t attempt, bool ok) {
    if (!hears(attempt)) return;
    if (ok)
        life_->backoff.reset();
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
        life.ways.serverDown();
        life.core.onServerDown(reason);
        settle();
    }
    if (!life.wanted) return;
    timeline_.after(life.backoff.next(), process_, [this, dropped] {
        if (life_->wanted && !life_->up && life_->attempt == dropped) login();
    });
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

void EntityManagerStation::Servers::wantConnection(bool wanted) {
    auto& station = station_;
    auto& life = *station.life_;
    if (life.wanted == wanted) return;
    life.wanted = wanted;
    if (wanted) {
        life.backoff.reset();
        station.login();
        return;
    }
    if (life.up)
        life.data->send(station.process_, [server = &station.server_, session = life.session] {
            server->entityGone(*session, true, "it ended its session");
        });
    station.dropServer();
}

void EntityManagerStation::Servers::sendBasicPrfl(const Registration& registration,
                                                  const proto::BasicProfile& profile) {
    auto& life = *station_.life_;
    if (!life.up) return;
    life.busy_period = std::chrono::milliseconds(registration.heartbeat_busy_ms);
    life.idle_period = std::chrono::milliseconds(registration.heartbeat_idle_ms);
    life.data->send(station_.process_, [server = &station_.server_, session = life.session, registration,
                                        bytes = profile.SerializeAsString()] {
        server->sendBasicPrfl(*session, registration, bytes);
    });
}

void EntityManagerStation::Servers::sendStatus(const EntityStatus& status) {
    auto& life = *station_.life_;
    if (!life.up) return;
    life.data->send(station_.process_, [server = &station_.server_, session = life.session, status] {
        server->sendStatus(*session, status);
    });
    const bool busy = status.state == EntityState::BUSY;
    if (std::exchange(life.busy, busy) != busy) station_.keepAlive();
}

void EntityManagerStation::Servers::toClient(Lane lane, const Header& head, std::string bytes) {
    auto& life = *station_.life_;
    if (!life.up) return;
    auto* connection = lane == Lane::Signal ? life.signal : life.data;
    connection->send(station_.process_,
                     [server = &station_.server_, session = life.session, lane, head,
                      bytes = std::move(bytes)] { server->sendToClient(*session, lane, head, bytes); });
}

void EntityManagerStation::Servers::sendToPeer(Lane lane, const Header& head,
                                               const proto::ToEntity& message) {
    auto& life = *station_.life_;
    if (!life.up) return;
    auto* connection = lane == Lane::Signal ? life.signal : life.data;
    connection->send(station_.process_, [server = &station_.server_, session = life.session, lane, head,
                                         bytes = message.SerializeAsString()] {
        server->sendToPeer(*session, lane, head, bytes);
    });
}

void EntityManagerStation::Servers::sendToClientDataSeq(const Header& head, const proto::ToClient& message) {
    auto& life = *station_.life_;
    if (!life.up) return;
    life.data->send(station_.process_, [server = &station_.server_, session = life.session, head,
                                        bytes = message.SerializeAsString()] {
        server->sendToClientDataSeq(*session, head, bytes);
    });
}

}  // namespace axon::simulation
