// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/front_end_server.hpp"

#include <chrono>
#include <optional>

#include "front_end_server/servants.hpp"
#include "transport/ice/timer_thread.hpp"
#include "transport/sessions/server_rim.hpp"
#include "transport/sessions/session_door.hpp"

namespace axon::front_end_server {

struct FrontEndServer::Parts {
    Parts(const FrontEndServerSettings& settings, const std::shared_ptr<Ice::Communicator>& data,
          const std::shared_ptr<Ice::Communicator>& signal, const Clock& its_clock, RandomSource& random,
          FrontEndCore::Note note)
        : topic(
              data, settings.topic_signals,
              [this](const Header& head, const Refusal& refusal) {
                  core.entityRefusal(Lane::Data, head, refusal);
              },
              [this](const auto& server, const auto& signals) { core.entityServerRefused(server, signals); },
              settings.links),
          core(
              settings.core, its_clock, random, settings.here ? *settings.here : topic, std::move(note),
              [this](FrontEndCore::Due due) { wake(due); }, settings.global_services, settings.audit,
              settings.users, &machine_time),
          rim(core, topic, settings, data, signal, its_clock),
          clock(its_clock),
          statuses("axon-statuses", Lane::Data, std::chrono::milliseconds{5}, machine_time,
                   [this] { return core.tellHeld(); }) {}
    void wake(FrontEndCore::Due due) {
        if (due == FrontEndCore::Due::OnTimer) return rim.wake();
        statuses.wake();  // it is there before the first client
    }

    const SteadyClock machine_time{};
    IceEntityTopic topic;
    FrontEndCore core;
    transport::ServerRim<ClientSessions> rim;
    const Clock& clock;
    std::optional<transport::SessionDoor<ClientSessions>> browsers;
    transport::TimerThread statuses;  // destroyed first: it calls the core
};

FrontEndServer::FrontEndServer(const FrontEndServerSettings& settings,
                               const std::shared_ptr<Ice::Communicator>& data,
                               const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock,
                               RandomSource& random, FrontEndCore::Note note)
    : parts_(std::make_unique<Parts>(settings, data, signal, clock, random, std::move(note))) {}

FrontEndServer::~FrontEndServer() = default;

std::string FrontEndServer::subscriber() const {
    return parts_->rim.subscriber();
}

void FrontEndServer::publishTo(const std::vector<std::string>& entity_servers) {
    parts_->topic.publishTo(entity_servers);
    if (!entity_servers.empty()) parts_->core.topicFound();
}

void FrontEndServer::activate() {
    parts_->rim.activate();
    if (parts_->browsers) parts_->browsers->activate();
}

transport::DoorPorts FrontEndServer::listenToBrowsers(const transport::DoorSettings& settings) {
    parts_->browsers.emplace(parts_->core, "FrontEndServerBrowsers", settings, parts_->clock);
    return parts_->browsers->ports();
}

void FrontEndServer::closeToBrowsers() {
    if (parts_->browsers) parts_->browsers->end();
    parts_->browsers.reset();
}

std::string FrontEndServer::routerAddress() const {
    return parts_->rim.routerAddress();
}

void FrontEndServer::end() {
    parts_->rim.end();
    parts_->statuses.end();
    if (parts_->browsers) parts_->browsers->end();
    if (parts_->rim.isOneOfSeveral()) parts_->topic.end();
}

std::string FrontEndServer::address(Lane lane) const {
    return parts_->rim.address(lane);
}

FrontEndCore& FrontEndServer::core() {
    return parts_->core;
}

}  // namespace axon::front_end_server
