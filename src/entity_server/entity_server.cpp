// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/entity_server.hpp"

#include "entity_server/servants.hpp"
#include "transport/adapter.hpp"
#include "transport/timer_thread.hpp"

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
        : core(
              settings.core, clock, random, settings.here ? *settings.here : topic, std::move(note),
              [this] { wake(); },
              [this] {
                  if (auto* thread = publisher_ready.load()) thread->wake();
              }),
          data_lane{core, Lane::Data, {}, {}, transport::OpenSessions<EntitySessionServant>(clock)},
          signal_lane{
              core, Lane::Signal, signalLimits(), {}, transport::OpenSessions<EntitySessionServant>(clock)},
          data_adapter(transport::listen(*data, "EntityServer", settings.data_endpoint)),
          signal_adapter(transport::listen(*signal, "EntityServerSignal", settings.signal_endpoint)),
          data_topic(data->createObjectAdapter("")),
          signal_topic(signal->createObjectAdapter("")) {
        const auto gate = Ice::stringToIdentity("EntityGate");
        data_lane.logins = settings.logins;
        data_lane.server = signal_lane.server = settings.name;
        data_lane.signal_endpoints = transport::publishedEndpoints(*signal_adapter);
        data_adapter->add(std::make_shared<EntityGateServant>(data_lane), gate);
        signal_adapter->add(std::make_shared<EntityGateServant>(signal_lane), gate);
        const auto subscriber = [this](Ice::ObjectAdapter& adapter) {
            return Ice::uncheckedCast<Axon::FrontEndComm::FrontEndToEntityCommPrx>(
                       adapter.addWithUUID(std::make_shared<FrontEndToEntityServant>(core)))
                ->ice_invocationTimeout(-1);
        };
        data_subscriber = subscriber(*data_topic);
        signal_subscriber = subscriber(*signal_topic);
        if (!settings.router_endpoint.empty()) {
            routers = std::make_unique<transport::RouterConnections>(settings.logins);
            door = std::make_unique<transport::RouterDoor>(
                doorForRouters(data_lane, data_adapter, signal_lane, signal_adapter, *routers));
            door->neighbours = transport::neighboursOf(*data, settings.neighbours);
            router_adapter =
                transport::listenForRouters(*data, "EntityServerRouter", settings.router_endpoint, *door);
        }
        data_topic->activate();
        signal_topic->activate();
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
    std::unique_ptr<transport::RouterConnections> routers;
    std::unique_ptr<transport::RouterDoor> door;
    std::shared_ptr<Ice::ObjectAdapter> router_adapter;
    std::shared_ptr<Ice::ObjectAdapter> data_topic;
    std::shared_ptr<Ice::ObjectAdapter> signal_topic;
    std::shared_ptr<Axon::FrontEndComm::FrontEndToEntityCommPrx> data_subscriber;
    std::shared_ptr<Axon::FrontEndComm::FrontEndToEntityCommPrx> signal_subscriber;
    std::atomic<transport::TimerThread*> timer_ready{nullptr};
    std::atomic<transport::TimerThread*> publisher_ready{nullptr};
    std::unique_ptr<transport::TimerThread> publisher;
    std::unique_ptr<transport::TimerThread> timer;  // destroyed first: it wakes the publisher
};

EntityServer::EntityServer(EntityServerSettings settings, const std::shared_ptr<Ice::Communicator>& data,
                           const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock,
                           RandomSource& random, EntityServerCore::Note note)
    : rim_(std::make_unique<Rim>(std::move(settings), data, signal, clock, random, std::move(note))) {}

EntityServer::~EntityServer() = default;

std::shared_ptr<Axon::FrontEndComm::FrontEndToEntityCommPrx> EntityServer::subscriber(Lane lane) const {
    return lane == Lane::Signal ? rim_->signal_subscriber : rim_->data_subscriber;
}

void EntityServer::publishTo(std::shared_ptr<Axon::EntityComm::EntityToFrontEndCommPrx> data,
                             std::shared_ptr<Axon::EntityComm::EntityToFrontEndCommPrx> signal) {
    rim_->topic.set(std::move(data), std::move(signal));
}

void EntityServer::activate() {
    rim_->signal_adapter->activate();
    rim_->data_adapter->activate();
    if (rim_->router_adapter) rim_->router_adapter->activate();
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
