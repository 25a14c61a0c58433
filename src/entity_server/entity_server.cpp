// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/entity_server.hpp"

#include <atomic>

#include "entity_server/servants.hpp"
#include "transport/sessions/server_rim.hpp"

namespace axon::entity_server {

struct EntityServer::Parts {
    Parts(const EntityServerSettings& settings, const std::shared_ptr<Ice::Communicator>& data,
          const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock, RandomSource& random,
          EntityServerCore::Note note)
        : topic(
              data, settings.topic_signals,
              {[this](const Header& head, const Refusal& refusal) {
                   core.peerRefusal(Lane::Data, head, refusal);
               },
               [this](const Header& head, const Refusal& refusal) { core.clientUnreached(head, refusal); }},
              [this](const auto& server, const auto& signals) { core.serverRefused(server, signals); },
              settings.links),
          core(
              settings.core, clock, random, settings.here ? *settings.here : topic, std::move(note),
              [this] { rim.wake(); },
              [this] {
                  if (auto* thread = publisher_ready.load()) thread->wake();
              },
              settings.audit, settings.users),
          rim(core, topic, settings, data, signal, clock) {
        publisher = std::make_unique<transport::TimerThread>("axon-publisher", Lane::Data, Duration{}, clock,
                                                             [this, &clock] {
                                                                 core.publishPending();
                                                                 return clock.now() + std::chrono::hours{1};
                                                             });
        publisher_ready = publisher.get();
        publisher->wake();  // for what was left before it could be woken
    }

    ~Parts() { endThreads(); }

    /// Each of the two threads wakes the other one, so both end before either is destroyed.
    void endThreads() {
        rim.end();
        publisher->end();
    }
    void end() {
        endThreads();
        if (rim.isOneOfSeveral()) topic.end();
    }

    IceFrontEndTopic topic;
    EntityServerCore core;
    std::atomic<transport::TimerThread*> publisher_ready{nullptr};
    std::unique_ptr<transport::TimerThread> publisher;
    transport::ServerRim<EntitySessions> rim;
};

EntityServer::EntityServer(const EntityServerSettings& settings,
                           const std::shared_ptr<Ice::Communicator>& data,
                           const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock,
                           RandomSource& random, EntityServerCore::Note note)
    : parts_(std::make_unique<Parts>(settings, data, signal, clock, random, std::move(note))) {}

EntityServer::~EntityServer() = default;

std::string EntityServer::subscriber() const {
    return parts_->rim.subscriber();
}

void EntityServer::publishTo(const std::vector<std::string>& front_ends,
                             const std::vector<std::string>& entity_servers) {
    parts_->topic.publishTo(front_ends, entity_servers);
    if (!front_ends.empty()) parts_->core.topicFound();
}

void EntityServer::activate() {
    parts_->rim.activate();
}

std::string EntityServer::routerAddress() const {
    return parts_->rim.routerAddress();
}

void EntityServer::end() {
    parts_->end();
}

std::string EntityServer::address(Lane lane) const {
    return parts_->rim.address(lane);
}

EntityServerCore& EntityServer::core() {
    return parts_->core;
}

}  // namespace axon::entity_server
