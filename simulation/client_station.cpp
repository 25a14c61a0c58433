// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/client_station.hpp"

#include <axon/messages.pb.h>

#include <algorithm>

#include "direct/always_relayed.hpp"

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;

constexpr Duration kLoginTimeout = 5s;  // as src/client/axon/client.hpp has it
constexpr int kFirstClient = 10;

}  // namespace

ClientStation::ClientStation(Timeline& timeline, Network& network, Observer& observer, ServerStation& server,
                             int number, Role role, std::uint64_t seed)
    : timeline_(timeline),
      network_(network),
      observer_(observer),
      server_(server),
      process_(timeline, kFirstClient + number, "client" + std::to_string(number + 1)),
      role_(role),
      random_(seed),
      alarm_(timeline, process_, [this] { onAlarm(); }),
      beat_(timeline, process_, [this] { onBeat(); }) {}

ClientStation::~ClientStation() = default;

void ClientStation::start() {
    process_.start();
    alarm_.forget();
    beat_.forget();
    life_ = std::make_unique<Life>(*this, random_);
    establish();
    settle();
    if (on_start) on_start();
}

void ClientStation::kill() {
    if (on_kill) on_kill();
    if (life_ && life_->up) observer_.sessionEnded(life_->me.id);
    process_.die();
    life_.reset();
}

void ClientStation::settle() {
    if (!life_) return;
    alarm_.set(std::min({life_->core.nextDeadline(), life_->core.serverDeadline(), life_->desk.nextDeadline(),
                         life_->retry_at, life_->direct_at}));
    beat_.set(std::min(life_->core.nextHeartbeat(), life_->path_beats_at));
}

void ClientStation::onAlarm() {
    auto& life = *life_;
    life.core.onTimer();
    if (life.core.serverSilent()) lost(life.listening, "the server has been silent for too long");
    life.desk.onTimer();
    directTurn();
    if (process_.now() >= life.retry_at) {
        life.retry_at = TimePoint::max();
        establish();
    }
    settle();
}

void ClientStation::onBeat() {
    auto& life = *life_;
    life.core.onHeartbeatTimer();
    life.path_beats_at = TimePoint::max();
    bool faster = false;
    for (const auto& [entity, path] : *life.links.paths()) {
        const auto [next, its_faster] = path->beatIfDue(life.core.entities().moving(entity), true);
        life.path_beats_at = std::min(life.path_beats_at, next);
        faster = faster || its_faster;
    }
    if (faster) directChanged();
    settle();
}

void ClientStation::readSlowly(Duration each) {
    reading_ = each;
    if (!life_) return;
    if (life_->data != nullptr) life_->data->readSlowly(process_, each);
    for (const auto& [entity, path] : *life_->links.paths())
        static_cast<SimulatedPath&>(*path).readSlowly(each);
}

void ClientStation::establish() {
    const auto attempt = ++attempts_;
    life_->listening = attempt;
    auto& data = network_.connect(path_, process_, server_.process());
    data.readSlowly(process_, reading_);
    life_->data = &data;
    life_->signal = nullptr;
    life_->session = nullptr;
    data.onClosed(process_, [this, attempt] { lost(attempt, "the server closed the connection"); });
    data.send(process_, [this, attempt, &data] { server_.clientHello(*this, attempt, data, role_); });
    // A process that is dead refuses, if its host is there to do it; a timeout is for all else.
    if (!server_.process().alive()) data.refused(process_);
    timeline_.after(kLoginTimeout, process_, [this, attempt] {
        if (hears(attempt) && !life_->up) lost(attempt, "no answer to the login");
    });
}

void ClientStation::welcomed(std::uint64_t attempt, ServerStation::ClientSession& session, const Sender& me,
                             const std::string& token, int told) {
    if (!hears(attempt)) return;
    life_->session = &session;
    life_->me = me;
    life_->told = told;
    auto& signal = network_.connect(path_, process_, server_.process());
    life_->signal = &signal;
    signal.onClosed(process_, [this, attempt] { lost(attempt, "the server closed the signal lane"); });
    signal.send(process_, [this, &session, &signal, token] { server_.clientAttach(session, signal, token); });
    if (!server_.process().alive()) signal.refused(process_);
}

void ClientStation::attached(std::uint64_t attempt) {
    if (!hears(attempt)) return;
    auto& life = *life_;
    life.up = true;
    life.backoff.reset();
    life.desk.onConnected(life.me);
    life.core.onConnected(life.me, life.told);
    timeline_.tell(process_.name(), [&] { return "is connected as " + life.me.id.substr(0, 8); });
    settle();
}

void ClientStation::lost(std::uint64_t attempt, const char* reason) {
    if (!hears(attempt)) return;
    auto& life = *life_;
    life.listening = 0;
    timeline_.tell(process_.name(), [&] { return std::string("has lost the server: ") + reason; });
    if (life.up) {
        observer_.sessionEnded(life.me.id);
        observer_.hurt(process_.name() + " has lost its session: " + reason);
    }
    life.up = false;
    life.core.onDisconnected(reason);
    close(life.links.clear(), "the session with the server is lost");
    life.desk.onDisconnected();
    life.data->close(process_);
    if (life.signal != nullptr) life.signal->close(process_);
    life.retry_at = process_.now() + life.backoff.next();
    settle();
}

void ClientStation::newBasicPrflMsg(std::uint64_t attempt, Presence presence,
                                    const Registration& registration, const std::string& profile) {
    if (!hears(attempt)) return;
    life_->desk.onEntity(presence, registration.entity, registration.name, !profile.empty());
    life_->core.onProfile(presence, registration, profile);
    if (presence == Presence::Left) close(life_->links.leave(registration.entity), "the entity has left");
    settle();
}
void ClientStation::newStatusMsg(std::uint64_t attempt, const EntityStatus& status) {
    if (!hears(attempt)) return;
    life_->core.onStatus(status);
    settle();
}
void ClientStation::newEntityMsg(std::uint64_t attempt, Lane lane, direct::Keeping keeping,
                                 const Header& head, const std::string& bytes) {
    if (!hears(attempt)) return;
    if (head.msg_type == kMsgReceipt) {
        proto::ToClient message;
        if (message.ParseFromString(bytes) && message.has_receipt())
            life_->desk.onReceipt(head.entity, message.receipt());
    } else if (lane == Lane::Signal) {
        life_->core.onEntityMsg(head, bytes);
    } else {
        const auto deliver = [this](const Header& its_head, std::string_view its) {
            observer_.hears(its_head);
            life_->core.onEntityMsg(its_head, its, false);
        };
        if (life_->links.relayed(keeping, head, bytes, deliver)) {
            if (keeping == direct::Keeping::Kept && !direct::alwaysRelayed(head.msg_type))
                observer_.hears(head);
            life_->core.onEntityMsg(head, bytes);
        }
    }
    settle();
}
void ClientStation::newRefusalMsg(std::uint64_t attempt, const Header& head, const Refusal& refusal) {
    if (!hears(attempt)) return;
    if (head.msg_type == kMsgWay)
        close(life_->links.markRefused(head.entity), "the servers refuse its beginning");
    else if (head.msg_type == client::kMsgStop)
        life_->desk.onRefusal(head.sequence, head.entity, refusal);
    else
        life_->core.onRefusal(head, refusal);
    settle();
}
void ClientStation::newStopAccepted(std::uint64_t attempt, std::int64_t sequence, const std::string& entity,
                                    int entities) {
    if (!hears(attempt)) return;
    life_->desk.onStopAccepted(sequence, entity, entities);
    settle();
}
void ClientStation::newHeartbeat(std::uint64_t attempt) {
    if (hears(attempt)) life_->core.onServerHeartbeat();
}

void ClientStation::onLost(const client::Held&, const Refusal& why) {
    timeline_.tell(process_.name(), [&] { return "loses a lease: " + why.message; });
}

void ClientStation::onOrphaned(const client::Held& held, const std::string& /*reason*/) {
    timeline_.tell(process_.name(),
                   [&] { return "keeps the key of lease " + std::to_string(held.lease.number); });
}
void ClientStation::onResumed(const client::Held& held) {
    timeline_.tell(process_.name(),
                   [&] { return "has lease " + std::to_string(held.lease.number) + " again"; });
}
void ClientStation::onHandOver(const client::Held& held, const client::HandOverRequest& request) {
    timeline_.tell(process_.name(), [&] {
        return request.withdrawn ? "is asked no longer" : "is asked by " + request.by + " to hand over";
    });
    if (!request.withdrawn && on_hand_over) on_hand_over(held);
}

std::shared_ptr<client::DirectPath> ClientStation::makePath(const client::DirectOffer& offer) {
    return std::make_shared<SimulatedPath>(
        SimulatedPath::Place{timeline_, network_, process_, *this,
                             [this](const std::string& endpoint) -> Road* {
                                 for (auto& road : roads_)
                                     if (endpoint == endpointOf(road.to, Lane::Data) ||
                                         endpoint == endpointOf(road.to, Lane::Signal))
                                         return &road;
                                 return nullptr;
                             },
                             [this] { return reading_; },
                             [this](const SimulatedPath& path, const std::string& why) {
                                 if (path.toHonest()) pathEnds(path.entity(), why);
                             }},
        offer, Id128::random(random_));
}

void ClientStation::onDirect(const client::Held& held, const std::string& data_endpoint,
                             const std::string& signal_endpoint, const std::string& key) {
    if (data_endpoint.empty() || signal_endpoint.empty()) {
        if (life_->links.withdraw(held)) directChanged();
        return;
    }
    life_->links.offer({held.entity, held.lease, key, life_->core.self().id, data_endpoint, signal_endpoint});
    directChanged();
}

/// Two threads look after it, that of times and the sender's, in either order.
void ClientStation::directChanged() {
    const auto soon = [this] { return std::chrono::microseconds{10 + random_.next() % 90}; };
    timeline_.after(soon(), process_, [this] {
        directTurn();
        settle();
    });
    timeline_.after(soon(), process_, [this] { life_->ways.fallBackFromEnded(); });
}

void ClientStation::wakeBeat() {
    timeline_.after(std::chrono::microseconds{10 + random_.next() % 90}, process_, [this] { onBeat(); });
}

/// As Client::Session::directTurn.
void ClientStation::directTurn() {
    auto& life = *life_;
    auto turn = life.links.turn();
    for (const auto& [matters, text] : turn.news)
        timeline_.tell(process_.name(), [&said = text] { return said; });
    for (const auto& [link, path] : turn.begun) {
        proto::ToEntity mark;
        mark.mutable_way()->set_path(path->number().bytes());
        Header head;
        head.sender = life.core.self();
        head.entity = path->entity();
        head.msg_type = kMsgWay;
        head.sequence = life.marks.nextSequence();
        head.sent_at_us = toMicroseconds(process_.now());
        client::Outgoing message{
            client::Operation::ToEntity, head, mark.SerializeAsString(), link, servers_, path};
        if (!life.ways.takes(message)) relay(message.kind, message.head, std::move(message.bytes));
        path->beat();
    }
    if (turn.ended) directChanged();
    for (const auto& path : turn.open) path->open(kLoginTimeout);
    life.direct_at = turn.next;
    for (const auto& [path, why] : turn.close) path->close(why);
    if (!turn.begun.empty()) wakeBeat();
}

void ClientStation::close(const client::DirectLinks::Closing& closing, const char* why) {
    for (const auto& path : closing) path->close(why);
}

void ClientStation::pathEnds(const std::string& entity, const std::string& why) {
    for (const char* its_own :
         {"the entity is released", "its lease has ended", "another lease or path takes its place",
          "the Entity Manager's end is closed"})
        if (why == its_own) return;
    observer_.pathHurt(process_.name() + ": the direct path to " + entity.substr(0, 8) + " ends: " + why);
}

void ClientStation::newDirectMsg(const client::DirectPath& path, direct::Keeping keeping, Header head,
                                 std::string_view message) {
    head.sender = life_->core.self();
    const auto arrival = life_->links.arrived(path, keeping, head, message);
    if (arrival.pass) {
        if (keeping == direct::Keeping::Kept) observer_.hears(head);
        life_->core.onEntityMsg(head, message, false);
    }
    if (arrival.close) arrival.close->close(arrival.why);
    if (arrival.acknowledge) path.beat();
    settle();
}

void ClientStation::newDirectReceipt(const client::DirectPath&, const Header& head,
                                     std::string_view message) {
    proto::ToClient body;
    if (body.ParseFromArray(message.data(), static_cast<int>(message.size())) && body.has_receipt())
        life_->desk.onReceipt(head.entity, body.receipt());
    settle();
}

template <class Deliver>
void ClientStation::toServer(Connection* connection, Deliver deliver) {
    if (!life_ || !life_->up || connection == nullptr) return;
    connection->send(process_, [server = &server_, session = life_->session, deliver = std::move(deliver)] {
        deliver(*server, *session);
    });
}

void ClientStation::put(client::Operation kind, const Header& head, std::string bytes) {
    if (kind == client::Operation::ToEntity && connected() && !direct::alwaysRelayed(head.msg_type))
        observer_.sends(head);
    client::Outgoing message{kind, head, std::move(bytes), life_->links.linkOf(head.entity), servers_};
    if (!life_->ways.takes(message)) relay(message.kind, message.head, std::move(message.bytes));
}
void ClientStation::relay(client::Operation kind, const Header& head, std::string bytes) {
    using client::Operation;
    const bool signal = kind == Operation::Reset || kind == Operation::Clear;
    toServer(
        signal ? life_->signal : life_->data,
        [kind, head, bytes = std::move(bytes)](ServerStation& server, ServerStation::ClientSession& session) {
            switch (kind) {
                case Operation::ToEntity:
                    return server.sendToEntity(session, head, bytes);
                case Operation::ToEntityDataSeq:
                    return server.sendToEntityDataSeq(session, head, bytes);
                case Operation::Request:
                    return server.sendRequest(session, head);
                case Operation::Reset:
                    return server.sendReset(session, head);
                case Operation::Clear:
                    return server.sendClear(session, head);
            }
        });
}
void ClientStation::relayForPaths(client::Operation kind, const Header& head, std::string bytes) {
    if (connected() && head.msg_type != kMsgWay) ++observer_.counts().sent_again;
    relay(kind, head, std::move(bytes));
}
void ClientStation::sendToEntity(const Header& head, std::string bytes) {
    put(client::Operation::ToEntity, head, std::move(bytes));
}
void ClientStation::sendToEntityDataSeq(const Header& head, std::string bytes) {
    put(client::Operation::ToEntityDataSeq, head, std::move(bytes));
}
void ClientStation::sendRequest(const Header& head, std::string bytes) {
    put(client::Operation::Request, head, std::move(bytes));
}
void ClientStation::sendReset(const Header& head) {
    put(client::Operation::Reset, head, {});
}
void ClientStation::sendClear(const Header& head) {
    put(client::Operation::Clear, head, {});
}
void ClientStation::keepAlive(std::int64_t, bool) {
    if (!life_->up) return;
    life_->signal->beat(process_,
                        [server = &server_, session = life_->session] { server->keepAlive(*session); });
}
void ClientStation::sendStopSignal(Lane lane, const Header& head, StopCause cause) {
    if (lane == Lane::Signal) client::DirectLinks::stop(*life_->links.paths(), head, {}, cause);
    toServer(lane == Lane::Signal ? life_->signal : life_->data,
             [head, cause](ServerStation& server, ServerStation::ClientSession& session) {
                 server.sendStopSignal(session, head, cause);
             });
}

void ClientStation::sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                                    StopCause cause) {
    if (lane == Lane::Signal) client::DirectLinks::stop(*life_->links.paths(), head, entities, cause);
    toServer(lane == Lane::Signal ? life_->signal : life_->data,
             [head, entities = std::move(entities), cause](ServerStation& server,
                                                           ServerStation::ClientSession& session) {
                 server.sendStopSignals(session, head, entities, cause);
             });
}

}  // namespace axon::simulation
