// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/front_end_server.hpp"

#include "front_end_server/servants.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/timer_thread.hpp"
#include "transport/topics/topic_adapters.hpp"

namespace axon::front_end_server {

namespace {

transport::OutboxLimits signalLimits() {
    transport::OutboxLimits limits;
    limits.window_bytes = 64 * 1024;
    return limits;
}

}  // namespace

class FrontEndServer::Rim {
  public:
    Rim(FrontEndServerSettings settings, const std::shared_ptr<Ice::Communicator>& data,
        const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock, RandomSource& random,
        FrontEndCore::Note note)
        : topic(data, settings.topic_signals,
                [this](const Header& head, const Refusal& refusal) {
                    core.entityRefusal(Lane::Data, head, refusal);
                }),
          core(
              settings.core, clock, random, settings.here ? *settings.here : topic, std::move(note),
              [this] { wake(); }, settings.global_services),
          data_lane{core, Lane::Data, {}, {}, transport::OpenSessions<ClientSessionServant>(clock)},
          signal_lane{
              core, Lane::Signal, signalLimits(), {}, transport::OpenSessions<ClientSessionServant>(clock)},
          data_adapter(transport::listen(*data, "FrontEndServer", settings.data_endpoint, 0,
                                         transport::Idle::Watched)),
          signal_adapter(transport::listen(*signal, "FrontEndServerSignal", settings.signal_endpoint, 0,
                                           transport::Idle::Watched)),
          limits(*settings.limits) {
        const auto gate = Ice::stringToIdentity("ClientGate");
        data_lane.logins = settings.logins;
        data_lane.server = signal_lane.server = settings.name;
        data_lane.signal_endpoints = transport::publishedEndpoints(*signal_adapter);
        data_adapter->add(std::make_shared<ClientGateServant>(data_lane), gate);
        signal_adapter->add(std::make_shared<ClientGateServant>(signal_lane), gate);
        if (!settings.router_endpoint.empty()) {
            routers = std::make_unique<transport::RouterConnections>(settings.logins);
            door = std::make_unique<transport::RouterDoor>(
                doorForRouters(data_lane, data_adapter, signal_lane, signal_adapter, *routers));
            door->neighbours = transport::neighboursOf(*data, settings.neighbours);
            router_adapter =
                transport::listenForRouters(*data, "FrontEndServerRouter", settings.router_endpoint, *door);
        }
        if (settings.here == nullptr) {
            others =
                transport::listenToServers<EntityToFrontEndServant>(core, "FrontEndServer", settings, *data);
            topic.setDirect(others.signals, others.messages);
        }
        timer = std::make_unique<transport::TimerThread>(
            // It walks all clients, and each task that begins wakes it: not for every one of them.
            "axon-fe-timer", Lane::Signal, std::chrono::milliseconds{5}, clock, [this] {
                return std::min({core.onTimer(), data_lane.sessions.expire(), signal_lane.sessions.expire()});
            });
        timer_ready = timer.get();
    }

    void end() {
        timer_ready = nullptr;
        timer.reset();
        if (!others.data) return;
        topic.publishTo({});  // what still waits there is refused while there is a core to do it
        topic.reach({});
    }

    void watch() {
        watches = {transport::watch(limits, *data_adapter, data_lane, routers.get()),
                   transport::watch(limits, *signal_adapter, signal_lane, routers.get())};
    }

    void wake() {
        if (auto* thread = timer_ready.load()) thread->wake();
    }

    IceEntityTopic topic;
    FrontEndCore core;
    ClientLane data_lane;
    ClientLane signal_lane;
    std::shared_ptr<Ice::ObjectAdapter> data_adapter;
    std::shared_ptr<Ice::ObjectAdapter> signal_adapter;
    transport::ConnectionLimits& limits;
    std::unique_ptr<transport::RouterConnections> routers;
    std::unique_ptr<transport::RouterDoor> door;
    std::shared_ptr<Ice::ObjectAdapter> router_adapter;
    transport::TopicAdapters others;
    std::atomic<transport::TimerThread*> timer_ready{nullptr};
    std::vector<std::shared_ptr<void>> watches;
    std::unique_ptr<transport::TimerThread> timer;
};

FrontEndServer::FrontEndServer(FrontEndServerSettings settings,
                               const std::shared_ptr<Ice::Communicator>& data,
                               const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock,
                               RandomSource& random, FrontEndCore::Note note)
    : rim_(std::make_unique<Rim>(std::move(settings), data, signal, clock, random, std::move(note))) {}

FrontEndServer::~FrontEndServer() = default;

std::string FrontEndServer::subscriber() const {
    return rim_->others.subscriber;
}

void FrontEndServer::publishTo(const std::vector<std::string>& entity_servers) {
    rim_->topic.publishTo(entity_servers);
    if (!entity_servers.empty()) rim_->core.topicFound();
}

void FrontEndServer::activate() {
    rim_->watch();
    rim_->signal_adapter->activate();
    rim_->data_adapter->activate();
    if (rim_->router_adapter) rim_->router_adapter->activate();
    if (rim_->others.data) rim_->others.activate();
}

std::string FrontEndServer::routerAddress() const {
    return rim_->router_adapter ? transport::addressOf(*rim_->router_adapter) : std::string();
}

void FrontEndServer::end() {
    rim_->end();
}

std::string FrontEndServer::address(Lane lane) const {
    return transport::addressOf(lane == Lane::Signal ? *rim_->signal_adapter : *rim_->data_adapter);
}

FrontEndCore& FrontEndServer::core() {
    return rim_->core;
}

}  // namespace axon::front_end_server
