// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/servants.hpp"

#include <spdlog/spdlog.h>

#include <utility>

#include "common/queue_share.hpp"
#include "transport/ice/communicator.hpp"

namespace axon::front_end_server {

using transport::ByteRange;
using transport::fromIce;
using transport::toIce;
using transport::toRange;
using transport::toView;
using transport::Traffic;
using Prx = Axon::FrontEndComm::ClientCallbackPrx;
using Answered = std::function<void()>;
using Failed = std::function<void(std::exception_ptr)>;
using Sent = std::function<void(bool)>;
using IceHeader = Axon::CommUtil::Header;
static_assert(Axon::CommUtil::StopList::kMost == kStopsAtOnce);

IceClientOutbox::IceClientOutbox(const std::shared_ptr<Prx>& callback, transport::OutboxLimits limits,
                                 std::shared_ptr<transport::PeerConnection> peer)
    : peer_(std::move(peer)),
      sender_(callback, limits, transport::untilOf(*peer_),
              [peer = peer_](bool improper, const std::string& why) {
                  peer->disconnect({improper, why}, false);
              }) {}

void IceClientOutbox::newBasicPrflMsg(Presence presence, const Registration& registration,
                                      std::string_view profile) {
    sender_.send(Traffic::Control, {}, profile,
                 [its_presence = toIce(presence), its_registration = toIce(registration)](
                     Prx& prx, const IceHeader&, ByteRange bytes, Answered a, Failed f, Sent s) {
                     prx.newBasicPrflMsgAsync(its_presence, its_registration, bytes, std::move(a),
                                              std::move(f), std::move(s));
                 });
}

void IceClientOutbox::newStatusMsg(const EntityStatus& status) {
    sender_.send(Traffic::Control, 0, [its_status = toIce(status)](Prx& prx, Answered a, Failed f, Sent s) {
        prx.newStatusMsgAsync(its_status, std::move(a), std::move(f), std::move(s));
    });
}

bool IceClientOutbox::newEntityMsg(Lane lane, const Header& head, std::string_view message,
                                   QueueShare share) {
    return sender_.send(
        lane == Lane::Signal ? Traffic::Signal : Traffic::Control, head, message,
        [](Prx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
            prx.newEntityMsgAsync(h, bytes, std::move(a), std::move(f), std::move(s));
        },
        senderKey(head.entity, share));
}

void IceClientOutbox::newEntityMsgDataSeq(const Header& head, std::string_view data) {
    sender_.send(
        Traffic::Data, head, data,
        [](Prx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
            prx.newEntityMsgDataSeqAsync(h, bytes, std::move(a), std::move(f), std::move(s));
        },
        senderKey(head.entity));
}

void IceClientOutbox::newRefusalMsg(const Header& head, const Refusal& refusal) {
    sender_.send(Traffic::Control, head, {},
                 [code = static_cast<int>(refusal.code), reason = refusal.message](
                     Prx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
                     prx.newRefusalMsgAsync(h, code, reason, std::move(a), std::move(f), std::move(s));
                 });
}

void IceClientOutbox::newStopAccepted(const Header& head, std::int32_t entities) {
    sender_.send(Traffic::Signal, head, {},
                 [entities](Prx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
                     prx.newStopAcceptedAsync(h, entities, std::move(a), std::move(f), std::move(s));
                 });
}

void IceClientOutbox::newUpdateMsg(RefusalCode code, const std::string& text) {
    sender_.send(Traffic::Control, text.size(),
                 [its_code = static_cast<int>(code), text](Prx& prx, Answered a, Failed f, Sent s) {
                     prx.newUpdateMsgAsync(its_code, text, std::move(a), std::move(f), std::move(s));
                 });
}

void IceClientOutbox::newHeartbeat(std::int64_t sequence) {
    sender_.send(Traffic::Heartbeat, 0, [sequence](Prx& prx, Answered a, Failed f, Sent s) {
        prx.newHeartbeatAsync(static_cast<double>(sequence), std::move(a), std::move(f), std::move(s));
    });
}

void IceClientOutbox::disconnect(bool orderly, const std::string& why) {
    if (const auto dropped = sender_.counts().dropped; dropped > 0) {
        spdlog::info("front-end server: {} messages to {} were dropped, it did not read them in time",
                     dropped, peer_->peer());
    }
    peer_->disconnect({false, why}, orderly);
    sender_.close();
}

using EntityPrx = Axon::FrontEndComm::FrontEndToEntityCommPrx;

namespace {

Refusal topicDown() {
    return {RefusalCode::NotConnected,
            "the way to the entity's server has failed, and the topic between the servers is down: only "
            "stops may get "
            "through; try again in a few seconds, and if that lasts, start icebox again",
            {}};
}

}  // namespace

IceEntityTopic::IceEntityTopic(const std::shared_ptr<Ice::Communicator>& data,
                               const std::shared_ptr<Ice::Communicator>& signal,
                               std::function<void(const Header&, const Refusal&)> lost)
    : lost_([lost = std::move(lost)](const Header& head) { lost(head, topicDown()); }),
      publisher_(data, signal, "front-end server") {}

Result<void> IceEntityTopic::clientMsg(const std::string& server, const Header& head,
                                       std::string_view message) {
    const auto ticket = std::make_shared<transport::PublicationTicket>(lost_, head);
    const bool taken = publisher_.one(
        server, Traffic::Control, head, message,
        [ticket](EntityPrx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
            prx.clientMsgAsync(h, bytes, std::move(a),
                               transport::PublicationTicket::watch(ticket, std::move(f)), std::move(s));
            ticket->given();
        },
        senderKey(head.sender.id));
    if (ticket.use_count() == 1 && ticket->take())
        return taken ? topicDown() : queueShareFull("the entity's server");
    return {};
}
void IceEntityTopic::clientMsgDataSeq(const std::string& server, const Header& head, std::string_view data) {
    publisher_.one(
        server, Traffic::Data, head, data,
        [](EntityPrx& prx, const IceHeader& h, ByteRange bytes, Answered a, Failed f, Sent s) {
            prx.clientMsgDataSeqAsync(h, bytes, std::move(a), std::move(f), std::move(s));
        },
        senderKey(head.sender.id));
}
void IceEntityTopic::clientRequest(const Header& head) {
    publisher_.data(Traffic::Control, head, std::string_view(),
                    [](EntityPrx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
                        prx.clientRequestAsync(h, std::move(a), std::move(f), std::move(s));
                    });
}
void IceEntityTopic::clientUpdate(const Header& head, ClientChange change) {
    publisher_.signal(Traffic::Signal, head, std::string_view(),
                      [its_change = toIce(change)](EntityPrx& prx, const IceHeader& h, ByteRange, Answered a,
                                                   Failed f, Sent s) {
                          prx.clientUpdateAsync(h, its_change, std::move(a), std::move(f), std::move(s));
                      });
}
void IceEntityTopic::stopSignal(const Header& head, StopCause cause) {
    publisher_.signal(Traffic::Signal, head, std::string_view(),
                      [its_cause = toIce(cause)](EntityPrx& prx, const IceHeader& h, ByteRange, Answered a,
                                                 Failed f, Sent s) {
                          prx.stopSignalAsync(h, its_cause, std::move(a), std::move(f), std::move(s));
                      });
}
void IceEntityTopic::stopSignals(const Header& head, const std::vector<std::string>& entities,
                                 StopCause cause) {
    publisher_.signal(Traffic::Signal, head, std::string_view(),
                      [entities, its_cause = toIce(cause)](EntityPrx& prx, const IceHeader& h, ByteRange,
                                                           Answered a, Failed f, Sent s) {
                          prx.stopSignalsAsync(h, entities, its_cause, std::move(a), std::move(f),
                                               std::move(s));
                      });
}
void IceEntityTopic::resetSignal(const Header& head) {
    publisher_.signal(Traffic::Signal, head, std::string_view(),
                      [](EntityPrx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
                          prx.resetSignalAsync(h, std::move(a), std::move(f), std::move(s));
                      });
}
void IceEntityTopic::clearSignal(const Header& head) {
    publisher_.signal(Traffic::Signal, head, std::string_view(),
                      [](EntityPrx& prx, const IceHeader& h, ByteRange, Answered a, Failed f, Sent s) {
                          prx.clearSignalAsync(h, std::move(a), std::move(f), std::move(s));
                      });
}
void IceEntityTopic::frontEndServerUpdate(Lane lane, const ServerAnnouncement& self) {
    auto announcement = toIce(self);
    announcement.signals = signals_;
    announcement.messages = messages_;
    const auto call = [announcement = std::move(announcement)](EntityPrx& prx, Answered a, Failed f, Sent s) {
        prx.frontEndServerUpdateAsync(announcement, std::move(a), std::move(f), std::move(s));
    };
    publisher_.reopen();
    if (lane == Lane::Signal) {
        publisher_.neighbours(Traffic::Heartbeat, std::size_t{0}, call);
    } else {
        publisher_.data(Traffic::Control, std::size_t{0}, call);
    }
}
void IceEntityTopic::reach(const std::vector<ServerAnnouncement>& entity_servers) {
    publisher_.reach(entity_servers);
}

Axon::FrontEndComm::SessionFacts ClientSessionServant::setCallback(std::shared_ptr<Prx> callback,
                                                                   const Ice::Current& current) {
    auto proxy = session_.newCallback(callback, lane_.lane == Lane::Data, current);
    auto client = transport::valueOrThrow(lane_.core.setCallback(
        name_, who_.role, std::make_shared<IceClientOutbox>(std::move(proxy), lane_.limits, session_.peer()),
        who_.user));
    Axon::FrontEndComm::SessionFacts facts;
    facts.me = toIce(FrontEndCore::me(*client));
    facts.token = lane_.toPeer(FrontEndCore::token(*client));
    facts.entities = static_cast<int>(FrontEndCore::told(*client));
    const auto milliseconds = [](Duration duration) {
        return static_cast<int>(std::chrono::duration_cast<std::chrono::milliseconds>(duration).count());
    };
    facts.watchdogBusyMs = milliseconds(lane_.core.settings().watchdog_busy);
    facts.watchdogIdleMs = milliseconds(lane_.core.settings().watchdog_idle);
    facts.signalEndpoint = lane_.signalEndpoint(*session_.peer());
    session_.adopt(std::move(client));
    return facts;
}

void ClientSessionServant::attachSignalLane(std::string token, std::shared_ptr<Prx> callback,
                                            const Ice::Current& current) {
    auto proxy = session_.newCallback(callback, lane_.lane == Lane::Signal, current);
    session_.adopt(transport::valueOrThrow(lane_.core.attach(
        ClientLane::fromPeer(token),
        std::make_shared<IceClientOutbox>(std::move(proxy), lane_.limits, session_.peer()))));
}

void ClientSessionServant::sendRequest(IceHeader head, ByteRange message, const Ice::Current& current) {
    lane_.core.sendRequest(session_.of(current), proper(std::move(head), current), toView(message));
}
void ClientSessionServant::sendToEntity(IceHeader head, ByteRange message, const Ice::Current& current) {
    lane_.core.sendToEntity(session_.of(current), proper(std::move(head), current), toView(message));
}
void ClientSessionServant::sendToEntityDataSeq(IceHeader head, ByteRange data, const Ice::Current& current) {
    lane_.core.sendToEntityDataSeq(session_.of(current), proper(std::move(head), current), toView(data));
}
// Also of a peer that is dropped for its head a stop is a stop; what was cut names no entity.
void ClientSessionServant::sendStopSignal(IceHeader head, Axon::CommUtil::StopCause cause,
                                          const Ice::Current& current) {
    const auto& its_client = session_.of(current);
    auto its_head = fromIce(std::move(head));
    const bool proper = transport::isProper(its_head);
    if (!proper) transport::cutStrings(its_head);
    lane_.core.sendStopSignal(its_client, std::move(its_head), fromIce(cause));
    if (!proper) session_.peer()->disconnect({true, std::string(transport::kImproperHead)}, false);
}
void ClientSessionServant::sendStopSignals(IceHeader head, Axon::CommUtil::StopList entities,
                                           Axon::CommUtil::StopCause cause, const Ice::Current& current) {
    const auto& its_client = session_.of(current);
    auto its_head = fromIce(std::move(head));
    const bool proper = transport::isProper(its_head);
    if (!proper) transport::cutStrings(its_head);
    lane_.core.sendStopSignals(its_client, std::move(its_head), entities.names, fromIce(cause));
    if (!proper) session_.peer()->disconnect({true, std::string(transport::kImproperHead)}, false);
}
void ClientSessionServant::sendResetSignal(IceHeader head, const Ice::Current& current) {
    lane_.core.sendResetSignal(session_.of(current), proper(std::move(head), current));
}
void ClientSessionServant::sendClearSignal(IceHeader head, const Ice::Current& current) {
    lane_.core.sendClearSignal(session_.of(current), proper(std::move(head), current));
}
void ClientSessionServant::keepAlive(double, const Ice::Current& current) {
    lane_.core.keepAlive(session_.of(current));
}

void ClientSessionServant::leave(const Ice::Current& current) {
    session_.peer()->require(current);
    session_.end({Ending::Ended, "it ended its session"});
    session_.peer()->disconnect({false, "it ended its session"}, true);
}

// A router calls it for any end of its side, so there it means that the client is lost.
void ClientSessionServant::destroy(const Ice::Current& current) {
    const auto routed = std::dynamic_pointer_cast<transport::RoutedConnection>(session_.peer());
    if (!routed) return leave(current);
    routed->require(current);
    routed->ended("the router ended its session: the client is gone, or silent");
}

namespace {

/// "client1@host", where the user is who logged in and the rest is what the client says of itself.
std::string nameOf(const transport::LoggedIn& who, const std::string& display_name) {
    if (who.user.empty()) return display_name;
    const auto host = display_name.substr(display_name.rfind('@') + 1);
    return host.empty() || host == who.user ? who.user : who.user + "@" + host;
}

}  // namespace

void ClientGateServant::openAsync(std::string user, std::string password, std::string display_name,
                                  Opened opened, Refused refused, const Ice::Current& current) {
    const auto peer = std::make_shared<transport::DirectConnection>(current.con);
    transport::openSession(
        lane_, peer, {std::move(user), std::move(password), {}, {}}, std::move(opened), std::move(refused),
        current,
        [&lane = lane_, peer, display_name = std::move(display_name)](const transport::LoggedIn& who) {
            return std::make_shared<ClientSessionServant>(lane, peer, nameOf(who, display_name), who);
        },
        [](transport::Logins& logins, transport::LoginRequest request, transport::Logins::Answer answer) {
            logins.client(std::move(request), std::move(answer));
        });
}

transport::RouterDoor doorForRouters(ClientLane& data,
                                     const std::shared_ptr<Ice::ObjectAdapter>& data_adapter,
                                     ClientLane& signal,
                                     const std::shared_ptr<Ice::ObjectAdapter>& signal_adapter,
                                     transport::RouterConnections& routers) {
    return transport::makeDoor<Axon::FrontEndComm::ClientSessionPrx>(
        data, data_adapter, signal, signal_adapter, routers, &transport::Logins::client,
        &transport::Logins::vouchedClient,
        [](ClientLane& lane, const std::shared_ptr<transport::RoutedConnection>& peer,
           const transport::LoggedIn& who, const std::string& display_name) {
            return std::make_shared<ClientSessionServant>(lane, peer, nameOf(who, display_name), who);
        });
}

void EntityToFrontEndServant::entityBasicPrflUpdate(Axon::CommUtil::Presence presence,
                                                    Axon::CommUtil::Registration registration,
                                                    ByteRange profile, const Ice::Current&) {
    core_.entityBasicPrflUpdate(fromIce(presence), fromIce(std::move(registration)), toView(profile));
}
void EntityToFrontEndServant::entityUpdate(Axon::CommUtil::EntityStatus status, double number,
                                           const Ice::Current&) {
    core_.entityUpdate(fromIce(std::move(status)), transport::whole(number), via_);
}
void EntityToFrontEndServant::entityMsg(Axon::CommUtil::Lane lane, IceHeader head, ByteRange message,
                                        const Ice::Current&) {
    core_.entityMsg(fromIce(lane), fromIce(std::move(head)), toView(message));
}
void EntityToFrontEndServant::entityMsgDataSeq(IceHeader head, ByteRange data, const Ice::Current&) {
    core_.entityMsgDataSeq(fromIce(std::move(head)), toView(data));
}
void EntityToFrontEndServant::entityRefusal(IceHeader head, int code, std::string reason,
                                            const Ice::Current&) {
    core_.entityRefusal(lane_, fromIce(std::move(head)),
                        {static_cast<RefusalCode>(code), std::move(reason), {}});
}
void EntityToFrontEndServant::entityServerEntities(std::string server, Axon::CommUtil::Entities entities,
                                                   const Ice::Current&) {
    core_.entityServerEntities(server, entities);
}
void EntityToFrontEndServant::entityServerUpdate(Axon::CommUtil::ServerAnnouncement server,
                                                 const Ice::Current&) {
    core_.entityServerUpdate(lane_, fromIce(std::move(server)));
}

}  // namespace axon::front_end_server
