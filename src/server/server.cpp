// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/server.hpp"

#include <Ice/Ice.h>
#include <arpa/inet.h>
#include <spdlog/spdlog.h>

#include <stdexcept>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_server/entity_server.hpp"
#include "front_end_server/front_end_server.hpp"
#include "transport/communicator.hpp"

namespace axon::server {

void checkLoopback(const std::string& endpoint) {
    try {
        transport::tcpEndpoint(endpoint);
    } catch (const std::invalid_argument& error) {
        throw std::runtime_error(error.what());
    }
    const auto host = endpoint.substr(0, endpoint.rfind(':'));
    in_addr address{};
    const bool numeric = inet_pton(AF_INET, host.c_str(), &address) == 1;
    const bool name = host.find_first_not_of("0123456789.") != std::string::npos;
    if (!numeric && !name) {
        throw std::runtime_error("'" + endpoint +
                                 "': expected an address of four numbers, such as 127.0.0.1:10410");
    }
    const bool loopback = host == "localhost" || (numeric && (ntohl(address.s_addr) >> 24U) == 127);
    if (!loopback) {
        throw std::runtime_error(
            "'" + endpoint +
            "' is reachable from other machines, and this version has no authentication: anybody there "
            "could move the robots. Listen on 127.0.0.1, and let other machines in through an SSH "
            "tunnel (ssh -L 10410:127.0.0.1:10410 -L 10411:127.0.0.1:10411 HOST)");
    }
}

namespace {

std::string loopbackEndpoint(const std::string& endpoint) {
    checkLoopback(endpoint);
    return transport::tcpEndpoint(endpoint);
}

transport::CommunicatorSettings communicatorSettings(const ServerSettings& settings, Lane lane) {
    transport::CommunicatorSettings its;
    its.lane = lane;
    its.name = lane == Lane::Signal ? "axon-signal" : "axon-data";
    its.server_threads = lane == Lane::Signal ? settings.signal_threads : settings.data_threads;
    its.properties = settings.ice_properties;
    return its;
}

}  // namespace

class Server::Parts {
  public:
    explicit Parts(const ServerSettings& settings)
        : data(transport::makeCommunicator(communicatorSettings(settings, Lane::Data))),
          signal(transport::makeCommunicator(communicatorSettings(settings, Lane::Signal))),
          entity({settings.entity, loopbackEndpoint(settings.entity_endpoint),
                  loopbackEndpoint(settings.entity_signal_endpoint)},
                 data.communicator(), signal.communicator(), clock, random,
                 [](const std::string& line) { spdlog::info("{}", line); }),
          front_end({settings.front_end, loopbackEndpoint(settings.client_endpoint),
                     loopbackEndpoint(settings.client_signal_endpoint)},
                    data.communicator(), signal.communicator(), clock, random,
                    [](const std::string& line) { spdlog::info("{}", line); }) {
        entity.publishTo(front_end.subscriber(Lane::Data), front_end.subscriber(Lane::Signal));
        front_end.publishTo(entity.subscriber(Lane::Data), entity.subscriber(Lane::Signal));
        entity.activate();
        front_end.activate();
    }

    ~Parts() {
        front_end.core().shutDown();
        // First the threads that call the cores, then the cores.
        data.communicator()->destroy();
        signal.communicator()->destroy();
    }

    SteadyClock clock;
    SystemRandom random;
    Ice::CommunicatorHolder data;
    Ice::CommunicatorHolder signal;
    entity_server::EntityServer entity;
    front_end_server::FrontEndServer front_end;
};

Server::Server(ServerSettings settings) : parts_(std::make_unique<Parts>(settings)) {}

Server::~Server() = default;

std::string Server::clientAddress(Lane lane) const {
    return parts_->front_end.address(lane);
}
std::string Server::entityAddress(Lane lane) const {
    return parts_->entity.address(lane);
}

std::string Server::readyLine() const {
    return "ready client=" + clientAddress(Lane::Data) + " client-signal=" + clientAddress(Lane::Signal) +
           " entity=" + entityAddress(Lane::Data) + " entity-signal=" + entityAddress(Lane::Signal);
}

entity_server::EntityServerCore& Server::entityCore() {
    return parts_->entity.core();
}
front_end_server::FrontEndCore& Server::frontEndCore() {
    return parts_->front_end.core();
}

}  // namespace axon::server
