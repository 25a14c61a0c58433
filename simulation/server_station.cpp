// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/server_station.hpp"

#include <algorithm>

#include "simulation/client_station.hpp"
#include "simulation/entity_manager_station.hpp"

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;
using entity_server::EntityServerCore;
using front_end_server::Ending;
using front_end_server::FrontEndCore;

constexpr Duration kSetUp = 10s;  // a session without both lanes is closed (docs/reference/sessions.md)
constexpr int kProcess = 1;
constexpr Duration kDrillPeriod = 7s;

entity_server::EntityServerCoreSettings settings() {
    entity_server::EntityServerCoreSettings settings;
    settings.drill_period = kDrillPeriod;
    return settings;
}

/// One lane to one client, behind the product's OutboxCore: who reads slowly fills it, as in
/// transport/outbox/outbox.hpp.
class ToClientOutbox final : public front_end_server::ClientOutbox,
                             public std::enable_shared_from_this<ToClientOutbox> {
  public:
    /// `give_up`: it does not read, and is to be disconnected.
    ToClientOutbox(Process& server, Connection& connection, ClientStation& to, std::uint64_t attempt,
                   transport::OutboxLimits limits, Counts& counts, std::function<void()> give_up)
        : server_(server),
          connection_(connection),
          to_(to),
          attempt_(attempt),
          counts_(counts),
          give_up_(std::move(give_up)),
          core_(limits) {}
    void newBasicPrflMsg(Presence presence, const Registration& registration,
                         std::string_view profile) override {
        send(
            Traffic::Control, profile.size(),
            [presence, registration, bytes = std::string(profile)](ClientStation& to, std::uint64_t attempt) {
                to.newBasicPrflMsg(attempt, presence, registration, bytes);
            });
    }
    void newStatusMsg(const EntityStatus& status) override {
        send(Traffic::Control, 0,
             [status](ClientStation& to, std::uint64_t attempt) { to.newStatusMsg(attempt, status); });
    }
    bool newEntityMsg(Lane lane, const Header& head, std::string_view message, QueueShare share) override {
        return entityMsg(lane, direct::Keeping::Kept, head, message, senderKey(head.entity, share));
    }
    void newEntityMsgDataSeq(const Header& head, std::string_view data) override {
        entityMsg(Lane::Data, direct::Keeping::Droppable, head, data, senderKey(head.entity));
    }
    void newRefusalMsg(const Header& head, const Refusal& refusal) override {
        send(Traffic::Control, 0, [head, refusal](ClientStation& to, std::uint64_t attempt) {
            to.newRefusalMsg(attempt, head, refusal);
        });
    }
    void newStopAccepted(const Header& head, std::int32_t entities) override {
        send(Traffic::Signal, 0,
             [sequence = head.sequence, entity = head.entity, entities](ClientStation& to,
                                                                        std::uint64_t attempt) {
                 to.newStopAccepted(attempt, sequence, entity, entities);
             });
    }
    void newUpdateMsg(RefusalCode, const std::string&) override {}
    void newHeartbeat(std::int64_t) override {
        if (core_.offer(Traffic::Heartbeat, 0, [] { return Parcel{}; }) != Core::Verdict::Send) return;
        connection_.beat(server_, [to = &to_, attempt = attempt_] { to->newHeartbeat(attempt); });
        core_.sent(Traffic::Heartbeat, 0);
    }
    void disconnect(bool, const std::string&) override {
        core_.close();
        connection_.close(server_);
    }

  private:
    using Traffic = transport::Traffic;
    using Parcel = std::function<void(ClientStation& to, std::uint64_t attempt)>;
    using Core = transport::OutboxCore<Parcel>;
    static constexpr std::size_t kOverhead = 256;  // as in transport/outbox/proxy_sender.hpp

    bool entityMsg(Lane lane, direct::Keeping keeping, const Header& head, std::string_view message,
                   SenderKey from) {
        return send(
            lane == Lane::Signal                    ? Traffic::Signal
            : keeping == direct::Keeping::Droppable ? Traffic::Data
                                                    : Traffic::Control,
            message.size(),
            [lane, keeping, head, bytes = std::string(message)](ClientStation& to, std::uint64_t attempt) {
                to.newEntityMsg(attempt, lane, keeping, head, bytes);
            },
            from);
    }
    template <class Deliver>
    bool send(Traffic traffic, std::size_t bytes, Deliver deliver, SenderKey from = kServersOwn) {
        const auto dropped = core_.counts().dropped;
        const auto verdict = core_.offer(
            traffic, kOverhead + bytes, [&] { return Parcel(deliver); }, from);
        counts_.slow_dropped += core_.counts().dropped - dropped;
        if (verdict == Core::Verdict::Send) {
            launch(traffic, kOverhead + bytes, from, std::move(deliver));
        } else if (verdict == Core::Verdict::Overflow) {
            ++counts_.slow_lost;
            give_up_();
        }
        return verdict != Core::Verdict::Refused;
    }
    template <class Deliver>
    void launch(Traffic traffic, std::size_t bytes, SenderKey from, Deliver deliver) {
        if (connection_.send(server_, [to = &to_, attempt = attempt_, deliver = std::move(deliver)] {
                deliver(*to, attempt);
            })) {
            core_.sent(traffic, bytes, from);
            return;
        }
        if (unwritten_.empty())
            connection_.onWritten(server_, [weak = weak_from_this()] {
                if (const auto self = weak.lock()) self->onWritten();
            });
        unwritten_.push_back({traffic, bytes, from});
    }
    void onWritten() {
        if (unwritten_.empty()) return;
        const auto [traffic, bytes, from] = unwritten_.front();
        unwritten_.pop_front();
        core_.sent(traffic, bytes, from);
        if (!core_.startPump()) return;
        while (auto item = core_.next())
            launch(item->traffic, item->bytes, item->from, std::move(item->parcel));
    }

    Process& server_;
    Connection& connection_;
    ClientStation& to_;
    const std::uint64_t attempt_;
    Counts& counts_;
    const std::function<void()> give_up_;
    Core core_;
    struct Unwritten {
        Traffic traffic;
        std::size_t bytes;
        SenderKey from;
    };
    std::deque<Unwritten> unwritten_;  ///< sent, and the sockets have no room yet
};

/// One lane to one Entity Manager.
class ToEntityOutbox final : public entity_server::EntityOutbox {
  public:
    ToEntityOutbox(Process& server, Connection& connection, EntityManagerStation& to, std::uint64_t attempt)
        : server_(server), connection_(connection), to_(to), attempt_(attempt) {}
    bool newClientMsg(const Header& head, std::string_view message, QueueShare) override {
        return send([head, bytes = std::string(message)](EntityManagerStation& to, std::uint64_t attempt) {
            to.newClientMsg(attempt, head, bytes);
        });
    }
    void newClientMsgDataSeq(const Header& head, std::string_view data) override {
        send([head, bytes = std::string(data)](EntityManagerStation& to, std::uint64_t attempt) {
            to.newClientMsgDataSeq(attempt, head, bytes);
        });
    }
    bool stopSignal(const Header& head, StopCause cause) override {
        return send([head, cause](EntityManagerStation& to, std::uint64_t attempt) {
            to.stopSignal(attempt, head, cause);
        });
    }
    bool resetSignal(const Header& head) override {
        return send(
            [head](EntityManagerStation& to, std::uint64_t attempt) { to.resetSignal(attempt, head); });
    }
    bool clearSignal(const Header& head) override {
        return send(
            [head](EntityManagerStation& to, std::uint64_t attempt) { to.clearSignal(attempt, head); });
    }
    void newClientUpdate(const Header& head, ClientChange change) override {
        send([head, change](EntityManagerStation& to, std::uint64_t attempt) {
            to.newClientUpdate(attempt, head, change);
        });
    }
    void newRefusalMsg(const Header&, const Refusal&) override {}
    void newHeartbeat(std::int64_t) override {
        connection_.beat(server_, [to = &to_, attempt = attempt_] { to->newHeartbeat(attempt); });
    }
    void disconnect(bool, const std::string&) override { connection_.close(server_); }

  private:
    template <class Deliver>
    bool send(Deliver deliver) {
        connection_.send(server_, [to = &to_, attempt = attempt_, deliver = std::move(deliver)] {
            deliver(*to, attempt);
        });
        return true;
    }
    Process& server_;
    Connection& connection_;
    EntityManagerStation& to_;
    const std::uint64_t attempt_;
};

}  // namespace

/// All that is lost when the process dies.
struct ServerStation::Life final : public front_end_server::EntityTopic, public entity_server::FrontEndTopic {
    explicit Life(ServerStation& station)
        : front_end(
              {}, station.process_, station.random_, *this, [](const std::string&) {},
              [&station](auto) { station.wake(); }),
          entities(
              settings(), station.process_, station.random_, *this, [](const std::string&) {},
              [&station] { station.wake(); },
              [&station] {
                  station.timeline_.after(std::chrono::microseconds{20}, station.process_,
                                          [&station] { station.life_->entities.publishPending(); });
              }) {}

    // To the entity server.
    Result<void> clientMsg(const std::string&, const Header& head, std::string_view message) override {
        entities.clientMsg(head, message);
        return {};
    }
    void clientMsgDataSeq(const std::string&, const Header& head, std::string_view data) override {
        entities.clientMsgDataSeq(head, data);
    }
    void clientRequest(const Header& head) override { entities.clientRequest(head); }
    void clientUpdate(const Header& head, ClientChange change) override {
        entities.clientUpdate(head, change);
    }
    void stopSignal(const Header& head, StopCause cause) override { entities.stopSignal(head, cause); }
    void stopSignals(const Header& head, const std::vector<std::string>& names, StopCause cause) override {
        entities.stopSignals(head, names, cause);
    }
    void resetSignal(const Header& head) override { entities.resetSignal(head); }
    void clearSignal(const Header& head) override { entities.clearSignal(head); }

    // To the front-end server.
    void entityBasicPrflUpdate(Presence presence, const Registration& registration,
                               std::string_view profile) override {
        front_end.entityBasicPrflUpdate(presence, registration, profile);
    }
    void entityUpdate(const EntityStatus& status, std::int64_t) override { front_end.entityUpdate(status); }
    void entityMsg(Lane lane, const Header& head, std::string_view message) override {
        front_end.entityMsg(lane, head, message);
    }
    void entityMsgDataSeq(const Header& head, std::string_view data) override {
        front_end.entityMsgDataSeq(head, data);
    }
    void entityRefusal(Lane lane, const Header& head, const Refusal& refusal) override {
        front_end.entityRefusal(lane, head, refusal);
    }

    front_end_server::FrontEndCore front_end;
    entity_server::EntityServerCore entities;
};

ServerStation::ServerStation(Timeline& timeline, Dice& dice, Observer& observer, std::uint64_t seed)
    : timeline_(timeline),
      dice_(dice),
      observer_(observer),
      process_(timeline, kProcess, "server"),
      random_(seed),
      alarm_(timeline, process_, [this] { onTimer(); }) {}

ServerStation::~ServerStation() = default;

void ServerStation::start() {
    process_.start();
    alarm_.forget();
    life_ = std::make_unique<Life>(*this);
    wake();
}

void ServerStation::kill() {
    process_.die();
    const auto die = [](auto& session) {
        session.ended = true;
        session.ref = {};
    };
    std::for_each(client_sessions_.begin(), client_sessions_.end(), die);
    std::for_each(entity_sessions_.begin(), entity_sessions_.end(), die);
    life_.reset();
}

void ServerStation::wake() {
    // Posted, because a core may ask for it in the middle of something. Often many at once.
    if (!process_.running() || !life_) return;
    alarm_.set(process_.now());
}

void ServerStation::onTimer() {
    const auto next =
        std::min({life_->front_end.onTimer(), life_->front_end.tellHeld(), life_->entities.onTimer()});
    alarm_.set(next);
}

front_end_server::FrontEndCore* ServerStation::frontEnd() {
    return life_ ? &life_->front_end : nullptr;
}
entity_server::EntityServerCore* ServerStation::entityServer() {
    return life_ ? &life_->entities : nullptr;
}

std::size_t ServerStation::clients() const {
    return life_ ? life_->front_end.clients() : 0;
}
std::size_t ServerStation::entities() const {
    return life_ ? life_->entities.entities() : 0;
}

void ServerStation::clientHello(ClientStation& who, std::uint64_t attempt, Connection& data, Role role) {
    auto& session = client_sessions_.emplace_back();
    session.who = &who;
    session.attempt = attempt;
    session.data = &data;
    data.onClosed(process_, [this, &session] { clientGone(session, Ending::Lost, "its connection closed"); });
    auto joined = life_->front_end.setCallback(who.process().name(), role, outboxTo(session, data));
    if (!joined) {
        data.close(process_);
        return;
    }
    session.ref = joined.value();
    const auto& me = FrontEndCore::me(*session.ref);
    SessionHealth health;
    health.id = me.id;
    health.process = &who.process();
    health.life = who.process().life();
    health.path = &who.path();
    observer_.addSession(health);
    data.send(process_, [&who, attempt, to = &session, me, token = FrontEndCore::token(*session.ref),
                         told = FrontEndCore::told(*session.ref)] {
        who.welcomed(attempt, *to, me, token, static_cast<int>(told));
    });
    timeline_.after(kSetUp, process_, [this, &session] {
        if (session.signal == nullptr && !session.ended)
            clientGone(session, Ending::Lost, "it has no signal lane");
    });
}

/// A second connection becomes the signal lane of a session of either kind.
template <class Core, class Session, class Outbox, class Gone>
void ServerStation::attachLane(Core& core, Session& session, Connection& signal, const std::string& token,
                               std::shared_ptr<Outbox> outbox, Gone gone) {
    if (session.ended) {
        signal.close(process_);
        return;
    }
    signal.onClosed(process_, std::move(gone));
    if (!core.attach(token, std::move(outbox))) {
        signal.close(process_);
        return;
    }
    session.signal = &signal;
    signal.send(process_, [who = session.who, attempt = session.attempt] { who->attached(attempt); });
}

void ServerStation::clientAttach(ClientSession& session, Connection& signal, const std::string& token) {
    attachLane(life_->front_end, session, signal, token, outboxTo(session, signal),
               [this, &session] { clientGone(session, Ending::Lost, "its signal lane closed"); });
}

std::shared_ptr<front_end_server::ClientOutbox> ServerStation::outboxTo(ClientSession& session,
                                                                        Connection& connection) {
    return std::make_shared<ToClientOutbox>(
        process_, connection, *session.who, session.attempt, outbox_limits, observer_.counts(),
        // Posted, because the core is in the middle of sending.
        [this, &session] {
            timeline_.after(Duration{}, process_, [this, &session] {
                clientGone(session, Ending::Improper, "it does not read its messages");
            });
        });
}

void ServerStation::clientGone(ClientSession& session, Ending ending, const char* why) {
    if (!session.ref || std::exchange(session.ended, true)) return;
    timeline_.tell(process_.name(), [&] { return session.who->process().name() + " is gone: " + why; });
    observer_.sessionEnded(FrontEndCore::me(*session.ref).id);
    life_->front_end.leave(session.ref, ending, why);
    session.data->close(process_);
    if (session.signal != nullptr) session.signal->close(process_);
}

void ServerStation::sendToEntity(ClientSession& session, const Header& head, const std::string& bytes) {
    if (!session.ended) life_->front_end.sendToEntity(session.ref, head, bytes);
}
void ServerStation::sendToEntityDataSeq(ClientSession& session, const Header& head,
                                        const std::string& bytes) {
    if (!session.ended) life_->front_end.sendToEntityDataSeq(session.ref, head, bytes);
}
void ServerStation::sendRequest(ClientSession& session, const Header& head) {
    if (!session.ended) life_->front_end.sendRequest(session.ref, head, {});
}
void ServerStation::sendStopSignal(ClientSession& session, const Header& head, StopCause cause) {
    if (!session.ended) life_->front_end.sendStopSignal(session.ref, head, cause);
}
void ServerStation::sendStopSignals(ClientSession& session, const Header& head,
                                    const std::vector<std::string>& entities, StopCause cause) {
    if (!session.ended) life_->front_end.sendStopSignals(session.ref, head, entities, cause);
}
void ServerStation::sendReset(ClientSession& session, const Header& head) {
    if (!session.ended) life_->front_end.sendResetSignal(session.ref, head);
}
void ServerStation::sendClear(ClientSession& session, const Header& head) {
    if (!session.ended) life_->front_end.sendClearSignal(session.ref, head);
}
void ServerStation::keepAlive(ClientSession& session) {
    if (!session.ended) life_->front_end.keepAlive(session.ref);
}

void ServerStation::entityHello(EntityManagerStation& who, std::uint64_t attempt, Connection& data) {
    auto& session = entity_sessions_.emplace_back();
    session.who = &who;
    session.attempt = attempt;
    session.data = &data;
    data.onClosed(process_, [this, &session] { entityGone(session, false, "its connection closed"); });
    session.ref = life_->entities.open(std::make_shared<ToEntityOutbox>(process_, data, who, attempt));
    data.send(process_, [&who, attempt, to = &session, token = EntityServerCore::token(*session.ref)] {
        who.welcomed(attempt, *to, token);
    });
    timeline_.after(kSetUp, process_, [this, &session] {
        if (session.signal == nullptr && !session.ended) entityGone(session, false, "it has no signal lane");
    });
}

void ServerStation::entityAttach(EntitySession& session, Connection& signal, const std::string& token) {
    attachLane(life_->entities, session, signal, token,
               std::make_shared<ToEntityOutbox>(process_, signal, *session.who, session.attempt),
               [this, &session] { entityGone(session, false, "its signal lane closed"); });
}

void ServerStation::entityGone(EntitySession& session, bool orderly, const char* why) {
    if (std::exchange(session.ended, true)) return;
    life_->entities.leave(session.ref, orderly, why);
    session.data->close(process_);
    if (session.signal != nullptr) session.signal->close(process_);
}

void ServerStation::sendBasicPrfl(EntitySession& session, const Registration& registration,
                                  const std::string& profile) {
    if (session.ended) return;
    const auto result = life_->entities.sendBasicPrfl(session.ref, registration, profile);
    session.data->send(process_, [who = session.who, attempt = session.attempt, ok = result.ok()] {
        who->registered(attempt, ok);
    });
}
void ServerStation::sendStatus(EntitySession& session, const EntityStatus& status) {
    if (!session.ended) life_->entities.sendStatus(session.ref, status);
}
void ServerStation::sendToClient(EntitySession& session, Lane lane, const Header& head,
                                 const std::string& bytes) {
    if (!session.ended) life_->entities.sendToClient(session.ref, lane, head, bytes);
}
void ServerStation::sendToPeer(EntitySession& session, Lane lane, const Header& head,
                               const std::string& bytes) {
    if (!session.ended) life_->entities.sendToPeer(session.ref, lane, head, bytes);
}
void ServerStation::sendToClientDataSeq(EntitySession& session, const Header& head,
                                        const std::string& bytes) {
    if (!session.ended) life_->entities.sendToClientDataSeq(session.ref, head, bytes);
}
void ServerStation::keepAlive(EntitySession& session) {
    if (!session.ended) life_->entities.keepAlive(session.ref);
}

}  // namespace axon::simulation
