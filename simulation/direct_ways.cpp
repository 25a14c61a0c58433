// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/direct_ways.hpp"

namespace axon::simulation {

using direct::Keeping;

std::string endpointOf(const std::string& listener, Lane lane) {
    return listener + (lane == Lane::Data ? ":data" : ":signal");
}

SimulatedPath::SimulatedPath(Place place, client::DirectOffer offer, Id128 number)
    : DirectPath(std::move(offer), number, place.client), place_(std::move(place)) {}

SimulatedPath::~SimulatedPath() {
    if (isOpen()) --data_.road->open;
}

void SimulatedPath::open(Duration timeout) {
    timeout_ = timeout;
    openLane(Lane::Data);
}

/// Each of the four calls has the same time.
void SimulatedPath::await(int step) {
    step_ = step;
    place_.timeline.after(timeout_, place_.client, [weak = weak_from_this(), step] {
        if (const auto self = weak.lock(); self && self->step_ == step && !self->isOpen())
            self->close("no answer in time");
    });
}

void SimulatedPath::openLane(Lane lane) {
    if (ended_) return;
    auto& its = end(lane);
    its.road = place_.road(lane == Lane::Data ? offer_.data_endpoint : offer_.signal_endpoint);
    if (its.road == nullptr) return close("nobody listens there");
    auto* const listener = its.road->listener;
    auto& connection = place_.network.connect(its.road->path, place_.client, listener->listeningProcess());
    its.connection = &connection;
    its.life = listener->listeningProcess().life();
    if (lane == Lane::Data) connection.readSlowly(place_.client, place_.reading());
    connection.onClosed(place_.client, [weak = weak_from_this()] {
        if (const auto self = weak.lock()) self->close("the Entity Manager's end is closed");
    });
    await(step_ + 1);
    toListener(its, [&connection, lane, weak = std::weak_ptr<DirectCaller>(weak_from_this())](
                        DirectListener& to) { to.challenge(connection, lane, weak); });
    if (!listener->listeningProcess().alive()) connection.refused(place_.client);
}

void SimulatedPath::challenged(Lane lane, const Id128& nonce) {
    if (ended_) return;
    SaidOpening said{
        {lane, offer_.lease, Id128::parse(uuidOf(offer_.client)).value_or(Id128{}), number_, nonce},
        proofFor(lane, nonce)};
    await(step_ + 1);
    toListener(end(lane), [connection = end(lane).connection, lane, said = std::move(said),
                           weak = std::weak_ptr<DirectCaller>(weak_from_this())](DirectListener& to) {
        to.open(*connection, lane, said, weak);
    });
}

void SimulatedPath::opened(Lane lane, const std::string& proof) {
    if (ended_) return;
    if (!trusts(proof)) return close("who answers does not know the lease's key");
    if (lane == Lane::Data) return openLane(Lane::Signal);
    liveness.heard(clock_.now());
    open_ = true;
    ++data_.road->open;
    place_.events.directChanged();
}

void SimulatedPath::refused(Lane, const Refusal& refusal) {
    close(refusal.message);
}

void SimulatedPath::close(const std::string& why) {
    if (ended_) return;
    const bool stood = open_;
    if (stood) --data_.road->open;
    ended_ = true;
    reason_ = why;
    for (const auto* its : {&data_, &signal_})
        if (its->connection != nullptr) its->connection->close(place_.client);
    if (stood) place_.ended(*this, why);
    place_.events.directChanged();
}

template <class Deliver>
void SimulatedPath::toListener(const End& its, Deliver deliver) const {
    its.connection->send(place_.client,
                         [listener = its.road->listener, life = its.life, deliver = std::move(deliver)] {
                             if (listener->listeningProcess().life() == life) deliver(*listener);
                         });
}

void SimulatedPath::send(Keeping keeping, const Header& head,
                         std::shared_ptr<const std::string> message) const {
    if (isOpen())
        toListener(data_, [connection = data_.connection, keeping, head, message = std::move(message)](
                              DirectListener& to) { to.sendToEntity(*connection, keeping, head, *message); });
}
void SimulatedPath::sendStopSignal(const Header& head, StopCause cause) const {
    if (isOpen())
        toListener(signal_, [connection = signal_.connection, head, cause](DirectListener& to) {
            to.sendStopSignal(*connection, head, cause);
        });
}
void SimulatedPath::sendResetSignal(const Header& head) const {
    if (isOpen())
        toListener(signal_, [connection = signal_.connection, head](DirectListener& to) {
            to.sendResetSignal(*connection, head);
        });
}
void SimulatedPath::sendClearSignal(const Header& head) const {
    if (isOpen())
        toListener(signal_, [connection = signal_.connection, head](DirectListener& to) {
            to.sendClearSignal(*connection, head);
        });
}
void SimulatedPath::beat() const {
    if (!isOpen()) return;
    signal_.connection->beat(
        place_.client, [listener = signal_.road->listener, life = signal_.life,
                        connection = signal_.connection, received = passed.load(), busy = liveness.busy()] {
            if (listener->listeningProcess().life() == life) listener->keepAlive(*connection, received, busy);
        });
}
void SimulatedPath::readSlowly(Duration each) {
    if (data_.connection != nullptr) data_.connection->readSlowly(place_.client, each);
}

void SimulatedPath::newEntityMsg(Lane lane, Keeping keeping, const Header& head, const std::string& bytes) {
    if (ended_) return;
    auto its = head;
    its.sender = {};
    its.entity = entity();
    if (lane == Lane::Data)
        place_.events.newDirectMsg(*this, keeping, std::move(its), bytes);
    else if (its.msg_type == kMsgReceipt)
        place_.events.newDirectReceipt(*this, its, bytes);
}
void SimulatedPath::newHeartbeat(std::int64_t received, bool asks) {
    if (!ended_) heard(received, asks);
}

}  // namespace axon::simulation
