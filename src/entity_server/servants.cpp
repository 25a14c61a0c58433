// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/servants.hpp"

#include <spdlog/spdlog.h>

#include <utility>

#include "common/queue_share.hpp"
#include "transport/ice/bound_uuid.hpp"
#include "transport/ice/communicator.hpp"

namespace axon::entity_server {

using transport::ByteRange;
using transport::fromIce;
using transport::toIce;
using transport::toRange;
using transport::toView;
using transport::Traffic;
using Prx = Axon::EntityComm::EntityCallbackPrx;
using Answered = std::function<void()>;
using Failed = std::function<void(std::exception_ptr)>;
using Sent = std::function<void(bool)>;
using IceHeader = Axon::CommUtil::Header;

IceEntityOutbox::IceEntityOutbox(const std::shared_ptr<Prx>& callback, transport::OutboxLimits limits,
                                 std::shared_ptr<transport::PeerConnection> peer)
    : peer_(std::move(peer)),
      sender_(callback, limits, transport::untilOf(*peer_),
              [peer = peer_](bool improper, const std::string& why) {
                  peer->disconnect({improper, why}, false);
              }) {}

bool IceEntityOutbox::newClientMsg(const Header& head, std::string_view message, QueueShare share) {
    return sender_.send(
        Traffic::Control, head, message,
        [](Prx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
            prx.newClientMsgAsync(h, bytes, std::move(a), std::move(f), std::move(s));
        },
        senderKey(head.sender.id, share));
}

void IceEntityOutbox::newClientMsgDataSeq(const Header& head, std::string_view data) {
    sender_.send(
        Traffic::Data, head, data,
        [](Prx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
            prx.newClientMsgDataSeqAsync(h, bytes, std::move(a), std::move(f), std::move(s));
        },
        senderKey(head.sender.id));
}

bool IceEntityOutbox::stopSignal(const Header& head, StopCause cause) {
    const bool of_peer = cause == StopCause::Requested || cause == StopCause::Drill;
    return sender_.send(
        Traffic::Signal, head, {},
        [its_cause = toIce(cause)](Prx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
            prx.stopSignalAsync(h, its_cause, std::move(a), std::move(f), std::move(s));
        },
        of_peer ? sessionKey(head.sender.id) : kServersOwn);
}

bool IceEntityOutbox::resetSignal(const Header& head) {
    return sender_.send(
        Traffic::Signal, head, {},
        [](Prx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
            prx.resetSignalAsync(h, std::move(a), std::move(f), std::move(s));
        },
        senderKey(head.sender.id));
}

bool IceEntityOutbox::clearSignal(const Header& head) {
    return sender_.send(
        Traffic::Signal, head, {},
        [](Prx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
            prx.clearSignalAsync(h, std::move(a), std::move(f), std::move(s));
        },
        senderKey(head.sender.id));
}

void IceEntityOutbox::newClientUpdate(const Header& head, ClientChange change) {
    sender_.send(
        Traffic::Signal, head, {},
        [its_change = toIce(change)](Prx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
            prx.newClientUpdateAsync(h, its_change, std::move(a), std::move(f), std::move(s));
        });
}

void IceEntityOutbox::newRefusalMsg(const Header& head, const Refusal& refusal) {
    sender_.send(Traffic::Control, head, {},
                 [code = static_cast<int>(refusal.code), reason = refusal.message](
                     Prx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
                     prx.newRefusalMsgAsync(h, code, reason, std::move(a), std::move(f), std::move(s));
                 });
}

void IceEntityOutbox::newHeartbeat(std::int64_t sequence) {
    sender_.send(Traffic::Heartbeat, 0, [sequence](Prx& prx, Answered a, Failed f, Sent s) {
        prx.newHeartbeatAsync(static_cast<double>(sequence), std::move(a), std::move(f), std::move(s));
    });
}

void IceEntityOutbox::disconnect(bool orderly, const std::string& why) {
    if (const auto dropped = sender_.counts().dropped; dropped > 0) {
        spdlog::info("entity server: {} messages to {} were dropped, it did not read them in time", dropped,
                     peer_->peer());
    }
    peer_->disconnect({false, why}, orderly);
    sender_.close();
}

using FrontEndPrx = Axon::EntityComm::EntityToFrontEndCommPrx;
using PeerPrx = Axon::FrontEndComm::FrontEndToEntityCommPrx;

namespace {

Refusal serverUnreached(const std::string& server) {
    return {RefusalCode::NotConnected,
            "entity server " + server + ", which has that entity, is out of reach at the moment; try again",
            {}};
}

}  // namespace

IceFrontEndTopic::IceFrontEndTopic(const std::shared_ptr<Ice::Communicator>& data,
                                   const std::shared_ptr<Ice::Communicator>& signal, Lost lost)
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
      front_ends_(data, signal, "entity server"),
      peers_(data, signal, "entity server") {}

/// To the front-end server of the recipient, or to all.
template <class Call>
bool IceFrontEndTopic::toOne(Traffic traffic, const Header& head, std::string_view bytes, const Call& call,
                             SenderKey from) {
    return front_ends_.one(std::string(originOf(head.sender.id).server), traffic, head, bytes, call, from);
}

void IceFrontEndTopic::entityBasicPrflUpdate(Presence presence, const Registration& registration,
                                             std::string_view profile) {
    front_ends_.data(Traffic::Control, Header{}, profile,
                     [its_presence = toIce(presence), its_registration = toIce(registration)](
                         FrontEndPrx& prx, const IceHeader&, ByteRange bytes, Answered a, Failed f, Sent s) {
                         prx.entityBasicPrflUpdateAsync(its_presence, its_registration, bytes, std::move(a),
                                                        std::move(f), std::move(s));
                     });
}
void IceFrontEndTopic::entityUpdate(const EntityStatus& status, std::int64_t number) {
    const auto call = [its_status = toIce(status), its_number = static_cast<double>(number)](
                          FrontEndPrx& prx, Answered a, Failed f, Sent s) {
        prx.entityUpdateAsync(its_status, its_number, std::move(a), std::move(f), std::move(s));
    };
    front_ends_.neighboursData(Traffic::Control, std::size_t{0}, call);
    front_ends_.data(Traffic::Control, std::size_t{0}, call);
}
void IceFrontEndTopic::entityMsg(Lane lane, const Header& head, std::string_view message) {
    const auto call = [its_lane = toIce(lane)](FrontEndPrx& prx, const IceHeader& h, ByteRange bytes,
                                               Answered a, Failed f, Sent s) {
        prx.entityMsgAsync(its_lane, h, bytes, std::move(a), std::move(f), std::move(s));
    };
    if (lane == Lane::Signal) {
        front_ends_.signal(Traffic::Signal, head, message, call);
    } else if (head.sender.id.empty()) {
        front_ends_.data(Traffic::Control, head, message, call);
    } else {
        const auto ticket = std::make_shared<transport::PublicationTicket>(client_lost_, head);
        const bool taken = toOne(
            Traffic::Control, head, message,
            [ticket](FrontEndPrx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
                prx.entityMsgAsync(Axon::CommUtil::Lane::Data, h, bytes, std::move(a),
                                   transport::PublicationTicket::watch(ticket, std::move(f)), std::move(s));
                ticket->given();
            },
            senderKey(head.entity));
        if (!taken && ticket.use_count() == 1 && ticket->take())
            to_client_refused_(head, queueShareFull("the client's front-end server"));
    }
}
void IceFrontEndTopic::entityMsgDataSeq(const Header& head, std::string_view data) {
    toOne(
        Traffic::Data, head, data,
        [](FrontEndPrx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
            prx.entityMsgDataSeqAsync(h, bytes, std::move(a), std::move(f), std::move(s));
        },
        senderKey(head.entity));
}
void IceFrontEndTopic::entityRefusal(Lane lane, const Header& head, const Refusal& refusal) {
    const auto call = [code = static_cast<int>(refusal.code), reason = refusal.message](
                          FrontEndPrx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
        prx.entityRefusalAsync(h, code, reason, std::move(a), std::move(f), std::move(s));
    };
    if (lane == Lane::Signal) {
        front_ends_.signal(Traffic::Signal, head, std::string_view(), call);
    } else {
        toOne(Traffic::Control, head, std::string_view(), call);
    }
}
void IceFrontEndTopic::entityServerEntities(const std::string& server,
                                            const std::vector<std::string>& entities) {
    front_ends_.data(Traffic::Control, entities.size() * 40,
                     [server, entities](FrontEndPrx& prx, Answered a, Failed f, Sent s) {
                         prx.entityServerEntitiesAsync(server, entities, std::move(a), std::move(f),
                                                       std::move(s));
                     });
}
Axon::CommUtil::ServerAnnouncement IceFrontEndTopic::withProxies(const ServerAnnouncement& self) const {
    auto announcement = toIce(self);
    announcement.signals = signals_;
    announcement.messages = messages_;
    return announcement;
}
void IceFrontEndTopic::entityServerUpdate(Lane lane, const ServerAnnouncement& self) {
    const auto call = [announcement = withProxies(self)](FrontEndPrx& prx, Answered a, Failed f, Sent s) {
        prx.entityServerUpdateAsync(announcement, std::move(a), std::move(f), std::move(s));
    };
    front_ends_.reopen();
    if (lane == Lane::Signal) return front_ends_.neighbours(Traffic::Heartbeat, std::size_t{0}, call);
    front_ends_.data(Traffic::Control, std::size_t{0}, call);
}
void IceFrontEndTopic::reach(const std::vector<ServerAnnouncement>& front_ends) {
    front_ends_.reach(front_ends);
}
void IceFrontEndTopic::peersUpdate(Lane lane, const ServerAnnouncement& self,
                                   const std::vector<std::string>& entities) {
    const auto call = [announcement = withProxies(self), entities](PeerPrx& prx, Answered a, Failed f,
                                                                   Sent s) {
        prx.entityServerUpdateAsync(announcement, entities, std::move(a), std::move(f), std::move(s));
    };
    peers_.reopen();
    if (lane == Lane::Signal) {
        peers_.neighbours(Traffic::Heartbeat, std::size_t{0}, call);
    } else {
        peers_.data(Traffic::Control, entities.size() * 40, call);
    }
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
    if (lane == Lane::Signal || raw) {
        const auto taken = peers_.straight(
            lane, server, raw ? Traffic::Data : Traffic::Control, head, message,
            [](PeerPrx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
                prx.peerMsgAsync(h, bytes, std::move(a), std::move(f), std::move(s));
            },
            from);
        return taken.value_or(false) ? Result<void>() : refused(taken);
    }
    const auto ticket = std::make_shared<transport::PublicationTicket>(peer_lost_, head);
    const auto taken = peers_.straight(
        lane, server, Traffic::Control, head, message,
        [ticket](PeerPrx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
            prx.peerMsgAsync(h, bytes, std::move(a),
                             transport::PublicationTicket::watch(ticket, std::move(f)), std::move(s));
            ticket->given();
        },
        from);
    if (ticket.use_count() == 1 && ticket->take()) return refused(taken);
    return {};
}
void IceFrontEndTopic::peerRefusal(Lane lane, const std::string& server, const Header& head,
                                   const Refusal& refusal) {
    peers_.straight(lane, server, Traffic::Control, head, std::string_view(),
                    [code = static_cast<int>(refusal.code), reason = refusal.message](
                        PeerPrx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
                        prx.peerRefusalAsync(h, code, reason, std::move(a), std::move(f), std::move(s));
                    });
}

Axon::EntityComm::SessionFacts EntitySessionServant::setCallback(std::shared_ptr<Prx> callback,
                                                                 const Ice::Current& current) {
    auto proxy = session_.newCallback(callback, lane_.lane == Lane::Data, current);
    auto session =
        lane_.core.open(std::make_shared<IceEntityOutbox>(std::move(proxy), lane_.limits, session_.peer()));
    const auto token = EntityServerCore::token(*session);
    session_.adopt(std::move(session));
    return {lane_.toPeer(token), lane_.signalEndpoint(*session_.peer())};
}

void EntitySessionServant::attachSignalLane(std::string token, std::shared_ptr<Prx> callback,
                                            const Ice::Current& current) {
    auto proxy = session_.newCallback(callback, lane_.lane == Lane::Signal, current);
    session_.adopt(transport::valueOrThrow(lane_.core.attach(
        EntityLane::fromPeer(token),
        std::make_shared<IceEntityOutbox>(std::move(proxy), lane_.limits, session_.peer()))));
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
        throw toIce(Refusal{RefusalCode::PermissionDenied,
                            "the UUID " + its.entity.substr(0, 64) +
                                " is bound to a secret, which was not shown: it is in the state folder of "
                                "the robot that has this UUID "
                                "(docs/reference/sessions.md)",
                            {}});
    }
    // An entity that is not ready is called by the name of its application, which need not be its own.
    if (!certified_.empty() && toView(profile).empty()) its.name = certified_;
    if (!certified_.empty() && its.name != certified_) {
        const auto refusal = "the certificate that was shown is the entity '" + certified_ +
                             "'s; expected its name in the basic profile, not '" + its.name +
                             "': axon certs issue --entity NAME makes one for another name";
        spdlog::warn("audit: registration refused, from {}: {}", session_.peer()->peer(), refusal);
        throw toIce(Refusal{RefusalCode::PermissionDenied, refusal, {}});
    }
    transport::valueOrThrow(lane_.core.sendBasicPrfl(its_session, std::move(its), toView(profile)));
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
    session_.peer()->require(current);
    session_.end({true, "it ended its session"});
    session_.peer()->disconnect({false, "it ended its session"}, true);
}

// A router calls it for any end of its side, so there it means that the Entity Manager is lost.
void EntitySessionServant::destroy(const Ice::Current& current) {
    const auto routed = std::dynamic_pointer_cast<transport::RoutedConnection>(session_.peer());
    if (!routed) return leave(current);
    routed->require(current);
    routed->ended("the router ended its session: the Entity Manager is gone, or silent");
}

void EntityGateServant::openAsync(std::string user, std::string password, Opened opened, Refused refused,
                                  const Ice::Current& current) {
    const auto peer = std::make_shared<transport::DirectConnection>(current.con);
    transport::openSession(
        lane_, peer, {std::move(user), std::move(password), {}, {}}, std::move(opened), std::move(refused),
        current,
        [&lane = lane_, peer](const transport::LoggedIn& who) {
            return std::make_shared<EntitySessionServant>(lane, peer, who.entity);
        },
        [](transport::Logins& logins, transport::LoginRequest request, transport::Logins::Answer answer) {
            logins.entity(std::move(request), std::move(answer));
        });
}

transport::RouterDoor doorForRouters(EntityLane& data,
                                     const std::shared_ptr<Ice::ObjectAdapter>& data_adapter,
                                     EntityLane& signal,
                                     const std::shared_ptr<Ice::ObjectAdapter>& signal_adapter,
                                     transport::RouterConnections& routers) {
    return transport::makeDoor<Axon::EntityComm::EntitySessionPrx>(
        data, data_adapter, signal, signal_adapter, routers, &transport::Logins::entity,
        &transport::Logins::vouchedEntity,
        [](EntityLane& lane, const std::shared_ptr<transport::RoutedConnection>& peer,
           const transport::LoggedIn& who,
           const std::string&) { return std::make_shared<EntitySessionServant>(lane, peer, who.entity); });
}

void FrontEndToEntityServant::clientMsg(IceHeader head, ByteRange message, const Ice::Current&) {
    core_.clientMsg(fromIce(std::move(head)), toView(message), via_);
}
void FrontEndToEntityServant::clientMsgDataSeq(IceHeader head, ByteRange data, const Ice::Current&) {
    core_.clientMsgDataSeq(fromIce(std::move(head)), toView(data), via_);
}
void FrontEndToEntityServant::clientRequest(IceHeader head, const Ice::Current&) {
    core_.clientRequest(fromIce(std::move(head)));
}
void FrontEndToEntityServant::clientUpdate(IceHeader head, Axon::CommUtil::ClientChange change,
                                           const Ice::Current&) {
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
void FrontEndToEntityServant::resetSignal(IceHeader head, const Ice::Current&) {
    core_.resetSignal(fromIce(std::move(head)));
}
void FrontEndToEntityServant::clearSignal(IceHeader head, const Ice::Current&) {
    core_.clearSignal(fromIce(std::move(head)));
}
void FrontEndToEntityServant::frontEndServerUpdate(Axon::CommUtil::ServerAnnouncement server,
                                                   const Ice::Current&) {
    core_.frontEndServerUpdate(lane_, fromIce(std::move(server)));
}
void FrontEndToEntityServant::entityServerUpdate(Axon::CommUtil::ServerAnnouncement server,
                                                 Axon::CommUtil::Entities entities, const Ice::Current&) {
    core_.entityServerUpdate(lane_, fromIce(std::move(server)), entities);
}
void FrontEndToEntityServant::peerMsg(IceHeader head, ByteRange message, const Ice::Current&) {
    core_.peerMsg(lane_, fromIce(std::move(head)), toView(message));
}
void FrontEndToEntityServant::peerRefusal(IceHeader head, int code, std::string reason, const Ice::Current&) {
    core_.peerRefusal(lane_, fromIce(std::move(head)),
                      {static_cast<RefusalCode>(code), std::move(reason), {}});
}

}  // namespace axon::entity_server
