// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/servants.hpp"

#include <spdlog/spdlog.h>

#include <utility>

#include "common/queue_share.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/users_context.hpp"
#include "transport/outbox/forward.hpp"

namespace axon::front_end_server {

using transport::ByteRange;
using transport::forward;
using transport::fromIce;
using transport::toIce;
using transport::toView;
using transport::Traffic;
using Prx = Axon::FrontEndComm::ClientCallbackPrx;
using IceHeader = Axon::CommUtil::Header;
static_assert(Axon::CommUtil::StopList::kMost == kStopsAtOnce);

namespace {

constexpr const char* kLeft = "it ended its session";

/// "client1@host", where the user is who logged in and the rest is what the client says of itself.
std::string nameOf(const transport::LoggedIn& who, const std::string& display_name) {
    if (who.user.empty()) return display_name;
    const auto host = display_name.substr(display_name.rfind('@') + 1);
    return host.empty() || host == who.user ? who.user : who.user + "@" + host;
}

}  // namespace

void IceClientOutbox::newBasicPrflMsg(Presence presence, const Registration& registration,
                                      std::string_view profile) {
    sender_.send(Traffic::Control, {}, profile,
                 forward<Prx>(&Prx::newBasicPrflMsgAsync, toIce(presence), toIce(registration)));
}

void IceClientOutbox::newStatusMsg(const EntityStatus& status) {
    sender_.send(Traffic::Control, textBytes(status), forward<Prx>(&Prx::newStatusMsgAsync, toIce(status)));
}

bool IceClientOutbox::newEntityMsg(Lane lane, const Header& head, std::string_view message,
                                   QueueShare share) {
    return sender_.send(lane == Lane::Signal ? Traffic::Signal : Traffic::Control, head, message,
                        forward<Prx>(&Prx::newEntityMsgAsync), senderKey(head.entity, share));
}

void IceClientOutbox::newEntityMsgDataSeq(const Header& head, std::string_view data) {
    sender_.send(Traffic::Data, head, data, forward<Prx>(&Prx::newEntityMsgDataSeqAsync),
                 senderKey(head.entity));
}

void IceClientOutbox::newRefusalMsg(const Header& head, const Refusal& refusal) {
    sender_.refuse(head, refusal);
}

void IceClientOutbox::newStopAccepted(const Header& head, std::int32_t entities) {
    sender_.send(Traffic::Signal, head, {}, forward<Prx>(&Prx::newStopAcceptedAsync, entities));
}

void IceClientOutbox::newUpdateMsg(RefusalCode code, const std::string& text) {
    sender_.send(Traffic::Control, text.size(),
                 forward<Prx>(&Prx::newUpdateMsgAsync, static_cast<int>(code), text));
}

void IceClientOutbox::newHeartbeat(std::int64_t sequence) {
    sender_.beat(sequence);
}

void IceClientOutbox::disconnect(bool orderly, const std::string& why) {
    sender_.disconnect(orderly, why);
}

using EntityPrx = Axon::FrontEndComm::FrontEndToEntityCommPrx;
using transport::PublicationTicket;

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
                               std::function<void(const Header&, const Refusal&)> lost,
                               std::function<void(const std::string&, const std::string&)> refused,
                               transport::LinkTrust* links)
    : lost_([lost = std::move(lost)](const Header& head) { lost(head, topicDown()); }),
      publisher_(data, signal, "front-end server", std::move(refused), links,
                 certificates::Kind::EntityServer) {}

void IceEntityTopic::end() {
    publisher_.publishTo({});  // what still waits there is refused while there is a core to do it
    publisher_.reach({});
}

Result<void> IceEntityTopic::clientMsg(const std::string& server, const Header& head,
                                       std::string_view message) {
    const auto ticket = std::make_shared<PublicationTicket>(lost_, head);
    const bool taken =
        publisher_.toOne(server, Traffic::Control, head, message,
                         PublicationTicket::follow(ticket, forward<EntityPrx>(&EntityPrx::clientMsgAsync)),
                         senderKey(head.sender.id));
    if (PublicationTicket::returned(ticket))
        return taken ? topicDown() : queueShareFull("the entity's server");
    return {};
}
void IceEntityTopic::clientMsgDataSeq(const std::string& server, const Header& head, std::string_view data) {
    publisher_.toOne(server, Traffic::Data, head, data, forward<EntityPrx>(&EntityPrx::clientMsgDataSeqAsync),
                     senderKey(head.sender.id));
}
void IceEntityTopic::clientRequest(const Header& head) {
    publisher_.toAll(Traffic::Control, head, std::string_view(),
                     forward<EntityPrx>(&EntityPrx::clientRequestAsync));
}
void IceEntityTopic::clientUpdate(const Header& head, ClientChange change) {
    publisher_.signalToAll(Traffic::Signal, head, std::string_view(),
                           forward<EntityPrx>(&EntityPrx::clientUpdateAsync, toIce(change)));
}
void IceEntityTopic::stopSignal(const Header& head, StopCause cause) {
    publisher_.signalToAll(Traffic::Signal, head, std::string_view(),
                           forward<EntityPrx>(&EntityPrx::stopSignalAsync, toIce(cause)));
}
void IceEntityTopic::stopSignals(const Header& head, const std::vector<std::string>& entities,
                                 StopCause cause) {
    publisher_.signalToAll(Traffic::Signal, head, std::string_view(),
                           forward<EntityPrx>(&EntityPrx::stopSignalsAsync, entities, toIce(cause)));
}
void IceEntityTopic::resetSignal(const Header& head) {
    publisher_.signalToAll(Traffic::Signal, head, std::string_view(),
                           forward<EntityPrx>(&EntityPrx::resetSignalAsync));
}
void IceEntityTopic::clearSignal(const Header& head) {
    publisher_.signalToAll(Traffic::Signal, head, std::string_view(),
                           forward<EntityPrx>(&EntityPrx::clearSignalAsync));
}
void IceEntityTopic::frontEndServerUpdate(Lane lane, const ServerAnnouncement& self,
                                          const std::string& users) {
    publisher_.announce(
        lane, 0,
        [announced = publisher_.announcement(self), context = transport::usersContext(users)](
            EntityPrx& prx, transport::Answered answered, transport::Failed failed, transport::Sent sent) {
            prx.frontEndServerUpdateAsync(announced, std::move(answered), std::move(failed), std::move(sent),
                                          context);
        });
}
void IceEntityTopic::reach(const std::vector<ServerAnnouncement>& entity_servers) {
    publisher_.reach(entity_servers);
}

Axon::FrontEndComm::SessionFacts ClientSessionServant::setCallback(std::shared_ptr<Prx> callback,
                                                                   const Ice::Current& current) {
    auto proxy = session_.newCallback(callback, lane_.lane == Lane::Data, current);
    auto client = lane_.orTurnAway(
        lane_.core.setCallback(
            name_, who_.role,
            std::make_shared<IceClientOutbox>(std::move(proxy), lane_.limits, session_.peer()), who_.user),
        *session_.peer(), "a session of a client");
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
    session_.adopt(lane_.orTurnAway(
        lane_.core.attach(ClientLane::fromPeer(token),
                          std::make_shared<IceClientOutbox>(std::move(proxy), lane_.limits, session_.peer())),
        *session_.peer(), "the signal lane of a client"));
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
    session_.leave({Ending::Ended, kLeft}, current);
}

void ClientSessionServant::destroy(const Ice::Current& current) {
    session_.destroy({Ending::Ended, kLeft}, "the client", current);
}

void ClientGateServant::openAsync(std::string user, std::string password, std::string display_name,
                                  Opened opened, Refused refused, const Ice::Current& current) {
    transport::openSession<ClientSessions>(lane_, {std::move(user), std::move(password), {}, {}},
                                           std::move(display_name), std::move(opened), std::move(refused),
                                           current);
}

std::shared_ptr<ClientSessionServant> ClientSessions::make(
    ClientLane& lane, const std::shared_ptr<transport::PeerConnection>& peer, const transport::LoggedIn& who,
    const std::string& display_name) {
    return std::make_shared<ClientSessionServant>(lane, peer, nameOf(who, display_name), who);
}

certificates::Kind EntityToFrontEndServant::callerOf(std::string_view operation) {
    const bool published = operation == "entityBasicPrflUpdate" || operation == "entityServerEntities";
    return published ? certificates::Kind::Storm : certificates::Kind::EntityServer;
}
void EntityToFrontEndServant::entityBasicPrflUpdate(Axon::CommUtil::Presence presence,
                                                    Axon::CommUtil::Registration registration,
                                                    ByteRange profile, const Ice::Current&) {
    core_.entityBasicPrflUpdate(fromIce(presence), fromIce(std::move(registration)), toView(profile));
}
void EntityToFrontEndServant::entityUpdate(Axon::CommUtil::EntityStatus status, double number,
                                           const Ice::Current& current) {
    if (links_ != nullptr && !links_->speaksAs(current, status.server, "tells of an entity of")) return;
    core_.entityUpdate(fromIce(std::move(status)), transport::whole(number), via_);
}
bool EntityToFrontEndServant::ofItsEntity(const IceHeader& head, const char* what,
                                          const Ice::Current& current) const {
    return links_ == nullptr ||
           links_->mayTellOf(current, head.entity, core_.serverOf(head.entity, lane_).get(), what);
}
void EntityToFrontEndServant::entityMsg(Axon::CommUtil::Lane lane, IceHeader head, ByteRange message,
                                        const Ice::Current& current) {
    if (!ofItsEntity(head, "sends a message of", current)) return;
    core_.entityMsg(fromIce(lane), fromIce(std::move(head)), toView(message));
}
void EntityToFrontEndServant::entityMsgDataSeq(IceHeader head, ByteRange data, const Ice::Current& current) {
    if (!ofItsEntity(head, "sends data of", current)) return;
    core_.entityMsgDataSeq(fromIce(std::move(head)), toView(data));
}
void EntityToFrontEndServant::entityRefusal(IceHeader head, int code, std::string reason,
                                            const Ice::Current& current) {
    // A server that the entity has left says that it is unknown there.
    if (static_cast<RefusalCode>(code) != RefusalCode::UnknownEntity &&
        !ofItsEntity(head, "refuses in the name of", current))
        return;
    core_.entityRefusal(lane_, fromIce(std::move(head)),
                        {static_cast<RefusalCode>(code), std::move(reason), {}});
}
void EntityToFrontEndServant::entityServerEntities(std::string server, Axon::CommUtil::Entities entities,
                                                   const Ice::Current&) {
    core_.entityServerEntities(server, entities);
}
void EntityToFrontEndServant::entityServerUpdate(Axon::CommUtil::ServerAnnouncement server,
                                                 const Ice::Current& current) {
    if (links_ != nullptr && !links_->speaksAs(current, server.name, transport::kAnnounced)) return;
    core_.entityServerUpdate(lane_, fromIce(std::move(server)));
}

}  // namespace axon::front_end_server
