// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/entity_server.hpp"

#include "entity_server/servants.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/timer_thread.hpp"
#include "transport/topics/topic_adapters.hpp"

namespace axon::entity_server {

namespace {

transport::OutboxLimits signalLimits() {
    transport::OutboxLimits limits;
    limits.window_bytes = 64 * 1024;
    return limits;
}

}  // namespace

class EntityServer::Rim {
  public:
    Rim(EntityServerSettings settings, const std::shared_ptr<Ice::Communicator>& data,
        const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock, RandomSource& random,
        EntityServerCore::Note note)
        : topic(
              data, settings.topic_signals,
              {[this](const Header& head, const Refusal& refusal) {
                   core.peerRefusal(Lane::Data, head, refusal);
               },
               [this](const Header& head, const Refusal& refusal) { core.clientUnreached(head, refusal); }}),
          core(
              settings.core, clock, random, settings.here ? *settings.here : topic, std::move(note),
              [this] { wake(); },
              [this] {
                  if (auto* thread = publisher_ready.load()) thread->wake();
              }),
          data_lane{core, Lane::Data, {}, {}, transport::OpenSessions<EntitySessionServant>(clock)},
          signal_lane{
              core, Lane::Signal, signalLimits(), {}, transport::OpenSessions<EntitySessionServant>(clock)},
          data_adapter(
              transport::listen(*data, "EntityServer", settings.data_endpoint, 0, transport::Idle::Watched)),
          signal_adapter(transport::listen(*signal, "EntityServerSignal", settings.signal_endpoint, 0,
                                           transport::Idle::Watched)),
          limits(*settings.limits) {
        const auto gate = Ice::stringToIdentity("EntityGate");
        data_lane.logins = settings.logins;
        data_lane.server = signal_lane.server = settings.name;
        data_lane.signal_endpoints = transport::publishedEndpoints(*signal_adapter);
        data_adapter->add(std::make_shared<EntityGateServant>(data_lane), gate);
        signal_adapter->add(std::make_shared<EntityGateServant>(signal_lane), gate);
        if (!settings.router_endpoint.empty()) {
            routers = std::make_unique<transport::RouterConnections>(settings.logins);
            door = std::make_unique<transport::RouterDoor>(
                doorForRouters(data_lane, data_adapter, signal_lane, signal_adapter, *routers));
            door->neighbours = transport::neighboursOf(*data, settings.neighbours);
            router_adapter =
                transport::listenForRouters(*data, "EntityServerRouter", settings.router_endpoint, *door);
        }
        if (settings.here == nullptr) {
            others =
                transport::listenToServers<FrontEndToEntityServant>(core, "EntityServer", settings, *data);
            topic.setDirect(others.signals, others.messages);
        }
        timer = std::make_unique<transport::TimerThread>(
            // Thousands of idle entities are served in batches, not with a wake-up for each.
            "axon-ent-timer", Lane::Signal, std::chrono::milliseconds{5}, clock, [this] {
                return std::min({core.onTimer(), data_lane.sessions.expire(), signal_lane.sessions.expire()});
            });
        timer_ready = timer.get();
        publisher = std::make_unique<transport::TimerThread>("axon-publisher", Lane::Data, Duration{}, clock,
                                                             [this, &clock] {
                                                                 core.publishPending();
                                                                 return clock.now() + std::chrono::hours{1};
                                                             });
        publisher_ready = publisher.get();
        publisher->wake();  // for what was left before it could be woken
    }

    void end() {
        timer_ready = nullptr;
        timer.reset();
        publisher_ready = nullptr;
        publisher.reset();
        if (!others.data) return;
        topic.publishTo({}, {});  // what still waits there is refused while there is a core to do it
        topic.reach({});
        topic.reachPeers({});
    }

    void watch() {
        watches = {transport::watch(limits, *data_adapter, data_lane, routers.get()),
                   transport::watch(limits, *signal_adapter, signal_lane, routers.get())};
    }

    void wake() {
        if (auto* thread = timer_ready.load()) thread->wake();
    }

    IceFrontEndTopic topic;
    EntityServerCore core;
    EntityLane data_lane;
    EntityLane signal_lane;
    std::shared_ptr<Ice::ObjectAdapter> data_adapter;
    std::shared_ptr<Ice::ObjectAdapter> signal_adapter;
    transport::ConnectionLimits& limits;
    std::unique_ptr<transport::RouterConnections> routers;
    std::unique_ptr<transport::RouterDoor> door;
    std::shared_ptr<Ice::ObjectAdapter> router_adapter;
    transport::TopicAdapters others;
    std::atomic<transport::TimerThread*> timer_ready{nullptr};
    std::atomic<transport::TimerThread*> publisher_ready{nullptr};
    std::unique_ptr<transport::TimerThread> publisher;
    std::vector<std::shared_ptr<void>> watches;
    std::unique_ptr<transport::TimerThread> timer;  // destroyed first: it wakes the publisher
};

EntityServer::EntityServer(EntityServerSettings settings, const std::shared_ptr<Ice::Communicator>& data,
                           const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock,
                           RandomSource& random, EntityServerCore::Note note)
    : rim_(std::make_unique<Rim>(std::move(settings), data, signal, clock, random, std::move(note))) {}

EntityServer::~EntityServer() = default;

std::string EntityServer::subscriber() const {
    return rim_->others.subscriber;
}

void EntityServer::publishTo(const std::vector<std::string>& front_ends,
                             const std::vector<std::string>& entity_servers) {
    rim_->topic.publishTo(front_ends, entity_servers);
    if (!front_ends.empty()) rim_->core.topicFound();
}

void EntityServer::activate() {
    rim_->watch();
    rim_->signal_adapter->activate();
    rim_->data_adapter->activate();
    if (rim_->router_adapter) rim_->router_adapter->activate();
    if (rim_->others.data) rim_->others.activate();
}

std::string EntityServer::routerAddress() const {
    return rim_->router_adapter ? transport::addressOf(*rim_->router_adapter) : std::string();
}

void EntityServer::end() {
    rim_->end();
}

std::string EntityServer::address(Lane lane) const {
    return transport::addressOf(lane == Lane::Signal ? *rim_->signal_adapter : *rim_->data_adapter);
}

EntityServerCore& EntityServer::core() {
    return rim_->core;
}

}  // namespace axon::entity_server
