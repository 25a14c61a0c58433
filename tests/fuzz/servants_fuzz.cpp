// SPDX-License-Identifier: GPL-2.0-or-later
// Whatever calls a peer makes that has a session of each kind at both servers: the honest client keeps its
// session and what it holds, nobody else is its robot's holder, and its stop arrives at once. The calls go
// through Ice, in one process. The input is calls of a byte for whom they are made to, a byte for the
// operation, two for the length, then what Ice calls the encapsulation's content.
#include <Ice/Ice.h>

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "claim.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_server/servants.hpp"
#include "front_end_server/servants.hpp"

namespace {

using namespace axon;

/// As of a connection that nobody else can speak on.
class Anybody final : public transport::PeerConnection {
  public:
    void onClosed(std::function<void(const transport::CloseReason&)>) override {}
    void disconnect(transport::CloseReason, bool) override {}
    void require(const Ice::Current&) override {}
    bool routed() const override { return true; }  // its callback is where it says
    const void* key() const override { return this; }
    const void* connection() const override { return this; }
    std::string peer() const override { return "anybody"; }
    std::string ends() const override { return {}; }
    std::string localAddress() const override { return {}; }
    bool tls() const override { return false; }
};

struct HonestClient final : front_end_server::ClientOutbox {
    void newBasicPrflMsg(Presence, const Registration&, std::string_view) override {}
    void newStatusMsg(const EntityStatus& status) override { statuses[status.entity] = status; }
    bool newEntityMsg(Lane, const Header&, std::string_view, QueueShare share) override {
        return takes(share);
    }
    void newEntityMsgDataSeq(const Header&, std::string_view) override {}
    void newRefusalMsg(const Header&, const Refusal&) override {}
    void newStopAccepted(const Header&, std::int32_t) override {}
    void newUpdateMsg(RefusalCode, const std::string&) override {}
    void newHeartbeat(std::int64_t) override {}
    void disconnect(bool, const std::string&) override { dropped = true; }
    bool takes(QueueShare share) const { return !slow || share == QueueShare::Whole; }
    std::map<std::string, EntityStatus> statuses;
    bool dropped = false;
    bool slow = false;  // others have their share of what waits here
};

struct HonestEntity final : entity_server::EntityOutbox {
    bool newClientMsg(const Header&, std::string_view, QueueShare share) override {
        return !slow || share == QueueShare::Whole;
    }
    void newClientMsgDataSeq(const Header&, std::string_view) override {}
    bool stopSignal(const Header& head, StopCause) override { return last_stop = head, true; }
    bool resetSignal(const Header&) override { return true; }
    bool clearSignal(const Header&) override { return true; }
    void newClientUpdate(const Header& head, ClientChange) override {
        lost = lost || head.sender.id == holder;
    }
    void newRefusalMsg(const Header&, const Refusal&) override {}
    void newHeartbeat(std::int64_t) override {}
    void disconnect(bool, const std::string&) override { dropped = true; }
    Header last_stop;
    std::string holder;
    bool lost = false;
    bool dropped = false;
    bool slow = false;
};

/// The two servers without their sockets, as in one process.
struct Servers final : front_end_server::EntityTopic, entity_server::FrontEndTopic {
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
    void entityBasicPrflUpdate(Presence presence, const Registration& registration,
                               std::string_view profile) override {
        clients.entityBasicPrflUpdate(presence, registration, profile);
    }
    void entityUpdate(const EntityStatus& status, std::int64_t) override { clients.entityUpdate(status); }
    void entityMsg(Lane lane, const Header& head, std::string_view message) override {
        clients.entityMsg(lane, head, message);
    }
    void entityMsgDataSeq(const Header& head, std::string_view data) override {
        clients.entityMsgDataSeq(head, data);
    }
    void entityRefusal(Lane lane, const Header& head, const Refusal& refusal) override {
        clients.entityRefusal(lane, head, refusal);
    }

    ManualClock clock;
    SeededRandom random{1};
    front_end_server::FrontEndCore clients{{}, clock, random, *this, [](const std::string&) {}, [](auto) {}};
    entity_server::EntityServerCore entities{
        {}, clock, random, *this, [](const std::string&) {}, [] {}, [this] { entities.publishPending(); }};
};

const std::vector<std::string> kOperations{"sendStopSignal",      "sendStopSignals", "sendToEntity",
                                           "sendToEntityDataSeq", "sendRequest",     "sendResetSignal",
                                           "sendClearSignal",     "setCallback",     "attachSignalLane",
                                           "keepAlive",           "leave",           "destroy",
                                           "sendBasicPrfl",       "sendStatus",      "sendToClient",
                                           "sendToClientDataSeq", "sendToPeer"};

/// One for each input: when it is destroyed, Ice has told of every failed send, and nothing reaches into the
/// next input, or into what the process destroys at its end.
Ice::CommunicatorHolder communicator() {
    Ice::InitializationData data;
    data.properties = Ice::createProperties();
    data.properties->setProperty("Ice.Warn.Dispatch", "0");
    data.properties->setProperty("Ice.Warn.Connections", "0");
    data.properties->setProperty("Ice.MessageSizeMax", "4096");
    return Ice::CommunicatorHolder(data);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    Servers servers;
    // Honest ones, which hold each other.
    const auto client_out = std::make_shared<HonestClient>();
    const auto client = servers.clients.setCallback("honest", Role::Operator, client_out).value();
    require(servers.clients
                .attach(front_end_server::FrontEndCore::token(*client), std::make_shared<HonestClient>())
                .ok(),
            "a client attaches");
    const auto entity_data = std::make_shared<HonestEntity>(),
               entity_signal = std::make_shared<HonestEntity>();
    const auto entity = servers.entities.open(entity_data);
    require(servers.entities.attach(entity_server::EntityServerCore::token(*entity), entity_signal).ok(),
            "an entity attaches");
    const std::string uuid = "00000000-0000-4000-8000-000000000001";
    Registration registration;
    registration.entity = uuid;
    registration.name = "Robot";
    require(servers.entities.sendBasicPrfl(entity, registration, "profile").ok(), "an entity registers");
    const auto me = front_end_server::FrontEndCore::me(*client);

    Header asks;
    asks.entity = uuid;
    asks.msg_type = kMsgCheckOut;
    servers.clients.sendToEntity(client, asks, "");
    EntityStatus status;
    status.state = EntityState::BUSY;
    status.holder = me;
    servers.entities.sendStatus(entity, status);
    entity_signal->holder = me.id;

    client_out->slow = entity_data->slow = size % 3 == 0;  // others have their share of what waits there

    // And a peer with a session of each kind.
    const auto ice = communicator();
    const auto adapter = ice->createObjectAdapter("");
    adapter->activate();
    front_end_server::ClientLane client_data{
        servers.clients,
        Lane::Data,
        {},
        {},
        transport::OpenSessions<front_end_server::ClientSessionServant>(servers.clock)};
    front_end_server::ClientLane client_signal{
        servers.clients,
        Lane::Signal,
        {},
        {},
        transport::OpenSessions<front_end_server::ClientSessionServant>(servers.clock)};
    entity_server::EntityLane peer_data{
        servers.entities,
        Lane::Data,
        {},
        {},
        transport::OpenSessions<entity_server::EntitySessionServant>(servers.clock)};
    entity_server::EntityLane peer_signal{
        servers.entities,
        Lane::Signal,
        {},
        {},
        transport::OpenSessions<entity_server::EntitySessionServant>(servers.clock)};
    const auto nowhere = [&](const char* name) { return adapter->createProxy(Ice::stringToIdentity(name)); };
    std::array<std::shared_ptr<Ice::ObjectPrx>, 4> doors;
    {
        const auto add = [&](const std::shared_ptr<Ice::Object>& servant) {
            return adapter->addWithUUID(servant)->ice_invocationTimeout(-1);
        };
        const auto role = size % 2 == 0 ? Role::Observer : Role::Operator;
        doors[0] = add(std::make_shared<front_end_server::ClientSessionServant>(
            client_data, std::make_shared<Anybody>(), "peer", transport::LoggedIn{"peer", role}));
        doors[1] = add(std::make_shared<front_end_server::ClientSessionServant>(
            client_signal, std::make_shared<Anybody>(), "peer", transport::LoggedIn{"peer", role}));
        doors[2] = add(
            std::make_shared<entity_server::EntitySessionServant>(peer_data, std::make_shared<Anybody>()));
        doors[3] = add(
            std::make_shared<entity_server::EntitySessionServant>(peer_signal, std::make_shared<Anybody>()));
        const auto as_client = Ice::uncheckedCast<Axon::FrontEndComm::ClientCallbackPrx>(nowhere("client"));
        const auto facts =
            Ice::uncheckedCast<Axon::FrontEndComm::ClientSessionPrx>(doors[0])->setCallback(as_client);
        Ice::uncheckedCast<Axon::FrontEndComm::ClientSessionPrx>(doors[1])->attachSignalLane(facts.token,
                                                                                             as_client);
        const auto as_entity = Ice::uncheckedCast<Axon::EntityComm::EntityCallbackPrx>(nowhere("entity"));
        const auto its =
            Ice::uncheckedCast<Axon::EntityComm::EntitySessionPrx>(doors[2])->setCallback(as_entity);
        Ice::uncheckedCast<Axon::EntityComm::EntitySessionPrx>(doors[3])->attachSignalLane(its.token,
                                                                                           as_entity);
    }
    for (std::size_t at = 0; at + 4 <= size && at < 64 * 1024U;) {
        const auto& door = doors[bytes[at] % doors.size()];
        const auto& operation = kOperations[bytes[at + 1] % kOperations.size()];
        const auto length = std::min<std::size_t>(bytes[at + 2] + 256U * bytes[at + 3], size - at - 4);
        const auto whole = static_cast<std::uint32_t>(length + 6);
        std::vector<Ice::Byte> call;
        for (unsigned shift = 0; shift < 32; shift += 8)
            call.push_back(static_cast<Ice::Byte>(whole >> shift));
        call.insert(call.end(), {1, 1});
        call.insert(call.end(), bytes + at + 4, bytes + at + 4 + length);
        at += 4 + length;
        std::vector<Ice::Byte> answer;
        try {
            door->ice_invoke(operation, Ice::OperationMode::Normal, call, answer);
        } catch (const Ice::Exception&) {  // it cannot be read, or is refused
        }
        if (bytes[at - 1] % 8 == 0) {
            servers.clock.advance(std::chrono::milliseconds{20});
            servers.clients.keepAlive(client);
            servers.entities.keepAlive(entity);
            servers.clients.onTimer();
            servers.clients.tellHeld();
            servers.entities.onTimer();
        }
    }
    require(!client_out->dropped && servers.clients.clients() > 0, "the honest client keeps its session");
    require(!entity_data->dropped && !entity_signal->dropped, "the honest entity keeps its session");
    require(!entity_signal->lost, "the honest client is not given up");
    require(client_out->statuses[uuid].holder.id == me.id, "nobody else is told of as the holder");
    Header stop;
    stop.entity = uuid;
    stop.sequence = 4711;
    servers.clients.sendStopSignal(client, stop, StopCause::Requested);
    require(entity_signal->last_stop.sequence == 4711 && entity_signal->last_stop.sender.id == me.id,
            "the honest client's stop arrives");
    ice->destroy();
    return 0;
}
