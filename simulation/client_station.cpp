// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/client_station.hpp"

#include <axon/messages.pb.h>

#include <algorithm>

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;

// As src/client/session.cpp has them.
constexpr Duration kFirstBackoff = 100ms;
constexpr Duration kLastBackoff = 2s;
constexpr Duration kLoginTimeout = 5s;
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
    life_->backoff = kFirstBackoff;
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
                         life_->retry_at}));
    beat_.set(life_->core.nextHeartbeat());
}

void ClientStation::onAlarm() {
    auto& life = *life_;
    life.core.onTimer();
    if (life.core.serverSilent()) lost(life.listening, "the server has been silent for too long");
    life.desk.onTimer();
    if (process_.now() >= life.retry_at) {
        life.retry_at = TimePoint::max();
        establish();
    }
    settle();
}

void ClientStation::onBeat() {
    life_->core.onHeartbeatTimer();
    settle();
}

void ClientStation::readSlowly(Duration each) {
    reading_ = each;
    if (life_ && life_->data != nullptr) life_->data->readSlowly(process_, each);
}

// -- the session

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
    life.backoff = kFirstBackoff;
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
    life.desk.onDisconnected();
    life.data->close(process_);
    if (life.signal != nullptr) life.signal->close(process_);
    life.retry_at = process_.now() + life.backoff;
    life.backoff = std::min(life.backoff * 2, kLastBackoff);
    settle();
}

// -- from the server

void ClientStation::newBasicPrflMsg(std::uint64_t attempt, Presence presence,
                                    const Registration& registration, const std::string& profile) {
    if (!hears(attempt)) return;
    life_->desk.onEntity(presence, registration.entity, registration.name, !profile.empty());
    life_->core.onProfile(presence, registration, profile);
    settle();
}
void ClientStation::newStatusMsg(std::uint64_t attempt, const EntityStatus& status) {
    if (!hears(attempt)) return;
    life_->core.onStatus(status);
    settle();
}
void ClientStation::newSvcRecordMsg(std::uint64_t attempt, const Header& head, const std::string& record) {
    if (!hears(attempt)) return;
    life_->core.onServiceRecord(head, record);
    settle();
}
void ClientStation::newEntityMsg(std::uint64_t attempt, const Header& head, const std::string& bytes) {
    if (!hears(attempt)) return;
    if (head.msg_type == kMsgReceipt) {
        proto::ToClient message;
        if (message.ParseFromString(bytes) && message.has_receipt())
            life_->desk.onReceipt(head.entity, message.receipt());
    } else {
        life_->core.onEntityMsg(head, bytes);
    }
    settle();
}
void ClientStation::newRefusalMsg(std::uint64_t attempt, const Header& head, const Refusal& refusal) {
    if (!hears(attempt)) return;
    if (head.msg_type == client::kMsgStop)
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

// -- to the server

template <class Deliver>
void ClientStation::toServer(Connection* connection, Deliver deliver) {
    if (!life_ || !life_->up || connection == nullptr) return;
    connection->send(process_, [server = &server_, session = life_->session, deliver = std::move(deliver)] {
        deliver(*server, *session);
    });
}

void ClientStation::sendToEntity(const Header& head, std::string bytes) {
    toServer(life_->data,
             [head, bytes = std::move(bytes)](ServerStation& server, ServerStation::ClientSession& session) {
                 server.sendToEntity(session, head, bytes);
             });
}
void ClientStation::sendToEntityDataSeq(const Header& head, std::string bytes) {
    toServer(life_->data,
             [head, bytes = std::move(bytes)](ServerStation& server, ServerStation::ClientSession& session) {
                 server.sendToEntityDataSeq(session, head, bytes);
             });
}
void ClientStation::sendRequest(const Header& head, std::string) {
    toServer(life_->data, [head](ServerStation& server, ServerStation::ClientSession& session) {
        server.sendRequest(session, head);
    });
}
void ClientStation::sendReset(const Header& head) {
    toServer(life_->signal, [head](ServerStation& server, ServerStation::ClientSession& session) {
        server.sendReset(session, head);
    });
}
void ClientStation::sendClear(const Header& head) {
    toServer(life_->signal, [head](ServerStation& server, ServerStation::ClientSession& session) {
        server.sendClear(session, head);
    });
}
void ClientStation::keepAlive(std::int64_t, bool) {
    if (!life_->up) return;
    life_->signal->beat(process_,
                        [server = &server_, session = life_->session] { server->keepAlive(*session); });
}
void ClientStation::sendStopSignal(Lane lane, const Header& head, StopCause cause) {
    toServer(lane == Lane::Signal ? life_->signal : life_->data,
             [head, cause](ServerStation& server, ServerStation::ClientSession& session) {
                 server.sendStopSignal(session, head, cause);
             });
}

void ClientStation::sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                                    StopCause cause) {
    toServer(lane == Lane::Signal ? life_->signal : life_->data,
             [head, entities = std::move(entities), cause](ServerStation& server,
                                                           ServerStation::ClientSession& session) {
                 server.sendStopSignals(session, head, entities, cause);
             });
}

}  // namespace axon::simulation
