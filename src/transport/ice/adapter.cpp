// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/adapter.hpp"

#include <cerrno>
#include <stdexcept>
#include <system_error>

namespace axon::transport {
namespace {

std::vector<Endpoint> endpointsOf(const Ice::EndpointSeq& endpoints) {
    std::vector<Endpoint> all;
    for (const auto& endpoint : endpoints) {
        const auto outer = endpoint->getInfo();
        for (auto info = outer; info; info = info->underlying) {
            const auto ip = std::dynamic_pointer_cast<Ice::IPEndpointInfo>(info);
            if (ip) all.push_back({ip->host, static_cast<std::uint16_t>(ip->port), outer->secure()});
        }
    }
    return all;
}

}  // namespace

std::shared_ptr<Ice::ObjectAdapter> listen(Ice::Communicator& communicator, const std::string& name,
                                           const std::string& endpoint, int threads, Idle idle) {
    // Threads of its own, so that no adapter waits for another; in order on each connection.
    const auto properties = communicator.getProperties();
    const bool in_order = threads == 0;
    if (in_order) threads = properties->getPropertyAsIntWithDefault("Ice.ThreadPool.Server.Size", 1);
    properties->setProperty(name + ".ThreadPool.Size", std::to_string(threads));
    properties->setProperty(name + ".ThreadPool.Serialize", in_order && threads > 1 ? "1" : "0");
    if (idle != Idle::ClosedAfterAMinute) {
        properties->setProperty(name + ".ACM.Timeout", "1");
        properties->setProperty(name + ".ACM.Close", idle == Idle::Watched ? "0" : "1");
        // A router gives up a server from which it hears nothing for a second while a call is under way, so
        // calls that take longer need a sign of life.
        properties->setProperty(name + ".ACM.Heartbeat", "1");
    }
    try {
        return communicator.createObjectAdapterWithEndpoints(name, endpoint);
    } catch (const Ice::SocketException& error) {
        const bool taken = error.error == EADDRINUSE;
        throw std::runtime_error(
            name + ": cannot listen on '" + endpoint + "' (" + std::generic_category().message(error.error) +
            (taken ? "): another program has this port, perhaps an axon-server that is already running; fix: "
                     "end "
                     "that one (as root: systemctl stop axon-server, if it is the service), or choose other "
                     "ports, such as axon-server --base-port 0 for free ones"
                   : "); fix: name an address of this machine"));
    } catch (const Ice::Exception& error) {
        throw std::runtime_error(name + ": '" + endpoint + "' is not an endpoint on which to listen (" +
                                 error.what() + ")");
    }
}

namespace {

std::vector<Endpoint> withoutWildcards(std::vector<Endpoint> all) {
    for (auto& endpoint : all)
        if (endpoint.host == "0.0.0.0" || endpoint.host == "*" || endpoint.host == "::")
            endpoint.host.clear();
    return all;
}

}  // namespace

std::vector<Endpoint> publishedEndpoints(const Ice::ObjectAdapter& adapter) {
    // Not asked of Ice where none is configured: it publishes every address of the machine for an adapter
    // that listens on all.
    const auto configured = !adapter.getCommunicator()
                                 ->getProperties()
                                 ->getProperty(adapter.getName() + ".PublishedEndpoints")
                                 .empty();
    return withoutWildcards(
        endpointsOf(configured ? adapter.getPublishedEndpoints() : adapter.getEndpoints()));
}

std::vector<Endpoint> listenedEndpoints(const Ice::ObjectAdapter& adapter) {
    return withoutWildcards(endpointsOf(adapter.getEndpoints()));
}

std::vector<Endpoint> endpointsOf(const Ice::ObjectPrx& proxy) {
    return endpointsOf(proxy.ice_getEndpoints());
}

std::string addressOf(const Ice::ObjectAdapter& adapter) {
    std::string text;
    for (const auto& endpoint : endpointsOf(adapter.getEndpoints()))
        text += (text.empty() ? "" : ",") + endpoint.address();
    return text;
}

}  // namespace axon::transport
