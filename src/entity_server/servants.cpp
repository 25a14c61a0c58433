// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/servants.hpp"

#include <spdlog/spdlog.h>

#include <utility>

#include "common/laboratory_name.hpp"
#include "common/queue_share.hpp"
#include "transport/ice/bound_uuid.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/users_context.hpp"
#include "transport/outbox/forward.hpp"

namespace axon::entity_server {

using transport::ByteRange;
using transport::forward;
using transport::fromIce;
using transport::PublicationTicket;
using transport::toIce;
using transport::toView;
using transport::Traffic;
using Prx = Axon::EntityComm::EntityCallbackPrx;
using IceHeader = Axon::CommUtil::Header;

namespace {
constexpr const char* kRegistration = "the registration of an entity";
}  // namespace

bool IceEntityOutbox::newClientMsg(const Header& head, std::string_view message, QueueShare share) {
    return sender_.send(Traffic::Control, head, message, forward<Prx>(&Prx::newClientMsgAsync),
                        senderKey(head.sender.id, share));
}

void IceEntityOutbox::newClientMsgDataSeq(const Header& head, std::string_view data) {
    sender_.send(Traffic::Data, head, data, forward<Prx>(&Prx::newClientMsgDataSeqAsync),
                 senderKey(head.sender.id));
}

bool IceEntityOutbox::stopSignal(const Header& head, StopCause cause) {
    const bool of_peer = cause == StopCause::Requested || cause == StopCause::Drill;
    return sender_.send(Traffic::Signal, head, {}, forward<Prx>(&Prx::stopSignalAsync, toIce(cause)),
                        of_peer ? sessionKey(head.sender.id) : kServersOwn);
}

bool IceEntityOutbox::resetSignal(const Header& head) {
    return sender_.send(Traffic::Signal, head, {}, forward<Prx>(&Prx::resetSignalAsync),
                        senderKey(head.sender.id));
}

bool IceEntityOutbox::clearSignal(const Header& head) {
    return sender_.send(Traffic::Signal, head, {}, forward<Prx>(&Prx::clearSignalAsync),
                        senderKey(head.sender.id));
}

void IceEntityOutbox::newClientUpdate(const Header& head, ClientChange change) {
    sender_.send(Traffic::Signal, head, {}, forward<Prx>(&Prx::newClientUpdateAsync, toIce(change)));
}

void IceEntityOutbox::newRefusalMsg(const Header& head, const Refusal& refusal) {
    sender_.refuse(head, refusal);
}

void IceEntityOutbox::newHeartbeat(std::int64_t sequence) {
    sender_.beat(sequence);
}

void IceEntityOutbox::disconnect(bool orderly, const std::string& why) {
    sender_.disconnect(orderly, why);
}

using FrontEndPrx = Axon::EntityComm::EntityToFrontEndCommPrx;
using PeerPrx = Axon::FrontEndComm::FrontEndToEntityCommPrx;

namespace {

constexpr const char* kLeft = "it ended its session";
constexpr std::size_t kBytesOfUuid = 40;  // of one in a list, about

Refusal serverUnreached(const std::string& server) {
    return {RefusalCode::NotConnected,
            "entity server " + server + ", which has that entity, is out of reach at the moment; try again",
            {}};
}

}  // namespace

IceFrontEndTopic::IceFrontEndTopic(const std::shared_ptr<Ice::Communicator>& data,
                                   const std::shared_ptr<Ice::Communicator>& signal, Lost lost,
                                   const std::function<void(const std::string&, const std::string&)>& refused,
                                   transport::LinkTrust* links)
    : peer_lost_([lost = std::move(lost.to_peer)](const Header& head) {
          lost(head, {RefusalCode::NotConnected,
                      "the connection to the entity server that has that entity has failed; try again",
                      {}});
      }),
      client_lost_([lost = lost.to_client](const Header& head) {
          lost(head,
               {RefusalCode::NotConnected, "the connection to the client's front-end server has failed", {}});
      }),
      to_client_refused_(std::move(lost.to_client)),
      front_ends_(data, signal, "entity server", refused, links, certificates::Kind::FrontEnd),
      peers_(data, signal, "entity server", refused, links, certificates::Kind::EntityServer) {}

/// To the front-end server of the recipient, or to all.
template <class Call>
bool IceFrontEndTopic::toOne(Traffic traffic, const Header& head, std::string_view bytes, const Call& call,
                             SenderKey from) {
    return front_ends_.toOne(std::string(originOf(head.sender.id).server), traffic, head, bytes, call, from);
}

void IceFrontEndTopic::end() {
    publishTo({}, {});  // what still waits there is refused while there is a core to do it
    reach({});
    reachPeers({});
}

void IceFrontEndTopic::entityBasicPrflUpdate(Presence presence, const Registration& registration,
                                             std::string_view profile) {
    front_ends_.toAll(
        Traffic::Control, Header{}, profile,
        forward<FrontEndPrx>(&FrontEndPrx::entityBasicPrflUpdateAsync, toIce(presence), toIce(registration)));
}
void IceFrontEndTopic::entityUpdate(const EntityStatus& status, std::int64_t number) {
    const auto call =
        forward<FrontEndPrx>(&FrontEndPrx::entityUpdateAsync, toIce(status), static_cast<double>(number));
    front_ends_.toNeighbours(Lane::Data, Traffic::Control, std::size_t{0}, call);
    front_ends_.toAll(Traffic::Control, std::size_t{0}, call);
}
void IceFrontEndTopic::entityMsg(Lane lane, const Header& head, std::string_view message) {
    const auto call = forward<FrontEndPrx>(&FrontEndPrx::entityMsgAsync, toIce(lane));
    if (lane == Lane::Signal) {
        front_ends_.signalToAll(Traffic::Signal, head, message, call);
    } else if (head.sender.id.empty()) {
        front_ends_.toAll(Traffic::Control, head, message, call);
    } else {
        const auto ticket = std::make_shared<PublicationTicket>(client_lost_, head);
        const bool taken = toOne(Traffic::Control, head, message, PublicationTicket::follow(ticket, call),
                                 senderKey(head.entity));
        if (!taken && PublicationTicket::returned(ticket))
            to_client_refused_(head, queueShareFull("the client's front-end server"));
    }
}
void IceFrontEndTopic::entityMsgDataSeq(const Header& head, std::string_view data) {
    toOne(Traffic::Data, head, data, forward<FrontEndPrx>(&FrontEndPrx::entityMsgDataSeqAsync),
          senderKey(head.entity));
}
void IceFrontEndTopic::entityRefusal(Lane lane, const Header& head, const Refusal& refusal) {
    const auto call = forward<FrontEndPrx>(&FrontEndPrx::entityRefusalAsync, static_cast<int>(refusal.code),
                                           refusal.message);
    if (lane == Lane::Signal) {
        front_ends_.signalToAll(Traffic::Signal, head, std::string_view(), call);
    } else {
        toOne(Traffic::Control, head, std::string_view(), call);
    }
}
void IceFrontEndTopic::entityServerEntities(const std::string& server,
                                            const std::vector<std::string>& entities) {
    front_ends_.toAll(Traffic::Control, entities.size() * kBytesOfUuid,
                      forward<FrontEndPrx>(&FrontEndPrx::entityServerEntitiesAsync, server, entities));
}
void IceFrontEndTopic::entityServerUpdate(Lane lane, const ServerAnnouncement& self) {
    front_ends_.announce(
        lane, 0, forward<FrontEndPrx>(&FrontEndPrx::entityServerUpdateAsync, front_ends_.announcement(self)));
}
void IceFrontEndTopic::reach(const std::vector<ServerAnnouncement>& front_ends) {
    front_ends_.reach(front_ends);
}
void IceFrontEndTopic::peersUpdate(Lane lane, const ServerAnnouncement& self,
                                   const std::vector<std::string>& entities) {
    peers_.announce(lane, entities.size() * kBytesOfUuid,
                    forward<PeerPrx>(&PeerPrx::entityServerUpdateAsync, peers_.announcement(self), entities));
}
void IceFrontEndTopic::reachPeers(const std::vector<ServerAnnouncement>& entity_servers) {
    peers_.reach(entity_servers);
}
Result<void> IceFrontEndTopic::peerMsg(Lane lane, const std::string& server, const Header& head,
                                       std::string_view message) {
    const bool raw = head.msg_type == kMsgRaw;  // droppable, and nobody waits for it
    const auto refused = [&](std::optional<bool> taken) {
        return taken.value_or(true) ? serverUnreached(server) : queueShareFull("that entity's server");
    };
    const auto from = senderKey(head.sender.id);
    const auto call = forward<PeerPrx>(&PeerPrx::peerMsgAsync);
    if (lane == Lane::Signal || raw) {
        const auto taken = peers_.toNeighbour(lane, server, raw ? Traffic::Data : Traffic::Control, head,
                                              message, call, from);
        return taken.value_or(false) ? Result<void>() : refused(taken);
    }
    const auto ticket = std::make_shared<PublicationTicket>(peer_lost_, head);
    const auto taken = peers_.toNeighbour(lane, server, Traffic::Control, head, message,
                                          PublicationTicket::follow(ticket, call), from);
    if (PublicationTicket::returned(ticket)) return refused(taken);
    return {};
}
void IceFrontEndTopic::peerRefusal(Lane lane, const std::string& server, const Header& head,
                                   const Refusal& refusal) {
    peers_.toNeighbour(
        lane, server, Traffic::Control, head, std::string_view(),
        forward<PeerPrx>(&PeerPrx::peerRefusalAsync, static_cast<int>(refusal.code), refusal.message));
}

Axon::EntityComm::SessionFacts EntitySessionServant::setCallback(std::shared_ptr<Prx> callback,
                                                                 const Ice::Current& current) {
    auto proxy = session_.newCallback(callback, lane_.lane == Lane::Data, current);
    auto session = lane_.core.open(
        std::make_shared<IceEntityOutbox>(std::move(proxy), lane_.limits, session_.peer()), user_);
    const auto token = EntityServerCore::token(*session);
    session_.adopt(std::move(session));
    return {lane_.toPeer(token), lane_.signalEndpoint(*session_.peer())};
}

void EntitySessionServant::attachSignalLane(std::string token, std::shared_ptr<Prx> callback,
                                            const Ice::Current& current) {
    auto proxy = session_.newCallback(callback, lane_.lane == Lane::Signal, current);
    session_.adopt(lane_.orTurnAway(
        lane_.core.attach(EntityLane::fromPeer(token),
                          std::make_shared<IceEntityOutbox>(std::move(proxy), lane_.limits, session_.peer())),
        *session_.peer(), "the signal lane of an Entity Manager"));
}

void EntitySessionServant::sendBasicPrfl(Axon::CommUtil::Registration registration, ByteRange profile,
                                         ByteRange secret, const Ice::Current& current) {
    if (lane_.lane == Lane::Signal) {
        session_.of(current);
        throw toIce(Refusal{RefusalCode::WrongState, "sendBasicPrfl belongs on the data lane's session", {}});
    }
    const auto& its_session = session_.of(current);
    auto its = fromIce(std::move(registration));
    if (!transport::mayRegister(its.entity, toView(secret))) {
        spdlog::warn("audit: registration of {} refused, from {}: without its secret",
                     its.entity.substr(0, 64), session_.peer()->peer());
        const Refusal refusal{RefusalCode::PermissionDenied,
                              "the UUID " + its.entity.substr(0, 64) +
                                  " is bound to a secret, which was not shown: it is in the state folder of "
                                  "the robot that has this UUID "
                                  "(docs/reference/sessions.md)",
                              {}};
        lane_.turnedAway(session_.peer()->peer(), kRegistration, refusal);
        throw toIce(refusal);
    }
    // An entity that is not ready is called by the name of its application, which need not be its own.
    const bool of_partner = certified_.ends_with(kLaboratorySeparator);
    if (!certified_.empty() && !of_partner && toView(profile).empty()) its.name = certified_;
    if (!certified_.empty() && !certificatePermits(certified_, its.name)) {
        const auto refusal = "the certificate that was shown is the entity '" + certified_ +
                             (of_partner ? "'s, a partner's laboratory; expected a name that begins so, not '"
                                         : "'s; expected its name in the basic profile, not '") +
                             its.name + "': axon certs issue --entity NAME makes one for another name";
        spdlog::warn("audit: registration refused, from {}: {}", session_.peer()->peer(), refusal);
        lane_.turnedAway(session_.peer()->peer(), kRegistration,
                         {RefusalCode::PermissionDenied, refusal, {}});
        throw toIce(Refusal{RefusalCode::PermissionDenied, refusal, {}});
    }
    lane_.orTurnAway(lane_.core.sendBasicPrfl(its_session, std::move(its), toView(profile)), *session_.peer(),
                     kRegistration);
}
void EntitySessionServant::sendStatus(Axon::CommUtil::EntityStatus status, const Ice::Current& current) {
    const auto& its_session = session_.of(current);
    if (lane_.lane == Lane::Signal) return lane_.core.refuseOnSignalLane(its_session, kMsgStatus);
    lane_.core.sendStatus(its_session, fromIce(std::move(status)));
}
void EntitySessionServant::sendToClient(IceHeader head, ByteRange message, const Ice::Current& current) {
    lane_.core.sendToClient(session_.of(current), lane_.lane, proper(std::move(head), current),
                            toView(message));
}
void EntitySessionServant::sendToClientDataSeq(IceHeader head, ByteRange data, const Ice::Current& current) {
    lane_.core.sendToClientDataSeq(session_.of(current), proper(std::move(head), current), toView(data));
}
void EntitySessionServant::sendToPeer(IceHeader head, ByteRange message, const Ice::Current& current) {
    lane_.core.sendToPeer(session_.of(current), lane_.lane, proper(std::move(head), current),
                          toView(message));
}
void EntitySessionServant::keepAlive(double, const Ice::Current& current) {
    lane_.core.keepAlive(session_.of(current));
}

void EntitySessionServant::leave(const Ice::Current& current) {
    session_.leave({true, kLeft}, current);
}

void EntitySessionServant::destroy(const Ice::Current& current) {
    session_.destroy({true, kLeft}, "the Entity Manager", current);
}

void EntityGateServant::openAsync(std::string user, std::string password, Opened opened, Refused refused,
                                  const Ice::Current& current) {
    transport::openSession<EntitySessions>(lane_, {std::move(user), std::move(password), {}, {}}, {},
                                           std::move(opened), std::move(refused), current);
}

std::shared_ptr<EntitySessionServant> EntitySessions::make(
    EntityLane& lane, const std::shared_ptr<transport::PeerConnection>& peer, const transport::LoggedIn& who,
    const std::string&) {
    return std::make_shared<EntitySessionServant>(lane, peer, who.entity, who.user);
}

certificates::Kind FrontEndToEntityServant::callerOf(std::string_view operation) {
    if (operation == "clientRequest") return certificates::Kind::Storm;
    const bool of_peers =
        operation == "entityServerUpdate" || operation == "peerMsg" || operation == "peerRefusal";
    return of_peers ? certificates::Kind::EntityServer : certificates::Kind::FrontEnd;
}
bool FrontEndToEntityServant::ofItsClient(const IceHeader& head, const Ice::Current& current) const {
    return links_ == nullptr ||
           links_->speaksAs(current, std::string(originOf(head.sender.id).server), "speaks for a client of");
}
void FrontEndToEntityServant::clientMsg(IceHeader head, ByteRange message, const Ice::Current& current) {
    if (!ofItsClient(head, current)) return;
    core_.clientMsg(fromIce(std::move(head)), toView(message), via_);
}
void FrontEndToEntityServant::clientMsgDataSeq(IceHeader head, ByteRange data, const Ice::Current& current) {
    if (!ofItsClient(head, current)) return;
    core_.clientMsgDataSeq(fromIce(std::move(head)), toView(data), via_);
}
void FrontEndToEntityServant::clientRequest(IceHeader head, const Ice::Current&) {
    core_.clientRequest(fromIce(std::move(head)));
}
void FrontEndToEntityServant::clientUpdate(IceHeader head, Axon::CommUtil::ClientChange change,
                                           const Ice::Current& current) {
    if (!ofItsClient(head, current)) return;
    core_.clientUpdate(fromIce(std::move(head)), fromIce(change));
}
void FrontEndToEntityServant::stopSignal(IceHeader head, Axon::CommUtil::StopCause cause,
                                         const Ice::Current&) {
    core_.stopSignal(fromIce(std::move(head)), fromIce(cause));
}
void FrontEndToEntityServant::stopSignals(IceHeader head, Axon::CommUtil::Entities entities,
                                          Axon::CommUtil::StopCause cause, const Ice::Current&) {
    core_.stopSignals(fromIce(std::move(head)), entities, fromIce(cause));
}
void FrontEndToEntityServant::resetSignal(IceHeader head, const Ice::Current& current) {
    if (!ofItsClient(head, current)) return;
    core_.resetSignal(fromIce(std::move(head)));
}
void FrontEndToEntityServant::clearSignal(IceHeader head, const Ice::Current& current) {
    if (!ofItsClient(head, current)) return;
    core_.clearSignal(fromIce(std::move(head)));
}
void FrontEndToEntityServant::frontEndServerUpdate(Axon::CommUtil::ServerAnnouncement server,
                                                   const Ice::Current& current) {
    if (links_ != nullptr && !links_->speaksAs(current, server.name, transport::kAnnounced)) return;
    core_.frontEndServerUpdate(lane_, fromIce(std::move(server)), transport::usersIn(current.ctx));
}
void FrontEndToEntityServant::entityServerUpdate(Axon::CommUtil::ServerAnnouncement server,
                                                 Axon::CommUtil::Entities entities,
                                                 const Ice::Current& current) {
    if (links_ != nullptr && !links_->speaksAs(current, server.name, transport::kAnnounced)) return;
    core_.entityServerUpdate(lane_, fromIce(std::move(server)), entities);
}
bool FrontEndToEntityServant::ofItsEntity(const std::string& entity, const char* what,
                                          const Ice::Current& current) const {
    return links_ == nullptr || links_->mayTellOf(current, entity, core_.serverOf(entity, lane_).get(), what);
}
void FrontEndToEntityServant::peerMsg(IceHeader head, ByteRange message, const Ice::Current& current) {
    if (!ofItsEntity(head.sender.id, "sends a message of", current)) return;
    core_.peerMsg(lane_, fromIce(std::move(head)), toView(message));
}
void FrontEndToEntityServant::peerRefusal(IceHeader head, int code, std::string reason,
                                          const Ice::Current& current) {
    // A server that the entity has left says that it is unknown there.
    if (static_cast<RefusalCode>(code) != RefusalCode::UnknownEntity &&
        !ofItsEntity(head.entity, "refuses in the name of", current))
        return;
    core_.peerRefusal(lane_, fromIce(std::move(head)),
                      {static_cast<RefusalCode>(code), std::move(reason), {}});
}

}  // namespace axon::entity_server
