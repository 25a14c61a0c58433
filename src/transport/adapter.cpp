// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/adapter.hpp"

#include <stdexcept>

namespace axon::transport {
namespace {

std::shared_ptr<Ice::IPEndpointInfo> firstOf(const Ice::EndpointSeq& endpoints) {
    for (const auto& endpoint : endpoints) {
        for (auto info = endpoint->getInfo(); info; info = info->underlying) {
            if (auto ip = std::dynamic_pointer_cast<Ice::IPEndpointInfo>(info)) return ip;
        }
    }
    throw std::logic_error("an adapter that listens has an endpoint");
}

std::shared_ptr<Ice::IPEndpointInfo> endpointOf(const Ice::ObjectAdapter& adapter) {
    return firstOf(adapter.getEndpoints());
}

/// Only where one was configured: Ice publishes every address of the machine for an adapter that listens on all.
std::shared_ptr<Ice::IPEndpointInfo> publishedOf(const Ice::ObjectAdapter& adapter) {
    const auto properties = adapter.getCommunicator()->getProperties();
    if (properties->getProperty(adapter.getName() + ".PublishedEndpoints").empty()) return endpointOf(adapter);
    return firstOf(adapter.getPublishedEndpoints());
}

}  // namespace

std::shared_ptr<Ice::ObjectAdapter> listen(Ice::Communicator& communicator, const std::string& name,
                                           const std::string& endpoint, int threads) {
    // Threads of its own, so that no adapter waits for another; in order on each connection.
    const auto properties = communicator.getProperties();
    const bool in_order = threads == 0;
    if (in_order) threads = properties->getPropertyAsIntWithDefault("Ice.ThreadPool.Server.Size", 1);
    properties->setProperty(name + ".ThreadPool.Size", std::to_string(threads));
    properties->setProperty(name + ".ThreadPool.Serialize", in_order && threads > 1 ? "1" : "0");
    try {
        return communicator.createObjectAdapterWithEndpoints(name, endpoint);
    } catch (const Ice::SocketException& error) {
        throw std::runtime_error(
            name + ": cannot listen on '" + endpoint + "' (" + error.what() +
            "); is another axon-server running, or the address not this machine's? Choose another port, "
            "or 0 for a free one");
    } catch (const Ice::Exception& error) {
        throw std::runtime_error(name + ": '" + endpoint + "' is no endpoint to listen on (" + error.what() +
                                 ")");
    }
}

int portOf(const Ice::ObjectAdapter& adapter) {
    return publishedOf(adapter)->port;
}

std::string hostOf(const Ice::ObjectAdapter& adapter) {
    const auto host = publishedOf(adapter)->host;
    return host == "0.0.0.0" || host == "*" || host == "::" ? std::string() : host;
}

std::string addressOf(const Ice::ObjectAdapter& adapter) {
    const auto endpoint = endpointOf(adapter);
    return endpoint->host + ":" + std::to_string(endpoint->port);
}

}  // namespace axon::transport
