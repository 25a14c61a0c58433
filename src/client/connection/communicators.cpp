// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/connection/communicators.hpp"

#include <spdlog/logger.h>

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>

#include "client/base/durations.hpp"
#include "client/base/log.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/tls.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::client {
namespace {

LaneHome homeOf(const Ice::CommunicatorHolder& holder) {
    LaneHome home;
    home.communicator = holder.communicator();
    home.adapter = home.communicator->createObjectAdapter("");
    home.adapter->activate();
    return home;
}

}  // namespace

Result<void> Communicators::open(const Options& options) {
    try {
        const auto& server = options.server;
        auto milliseconds = std::max<long long>(
            1, std::chrono::duration_cast<std::chrono::milliseconds>(toDuration(options.timeout)).count());
        if (const auto tried = transport::routerTriedFor(server))
            milliseconds = std::min<long long>(milliseconds, *tried);
        auto properties = options.properties;
        properties.try_emplace("Ice.Override.ConnectTimeout", std::to_string(milliseconds));
        const bool tls = transport::isRouter(server) ? transport::isTlsRouter(server)
                                                     : transport::parseEndpoint(server).tls;
        if (tls && !transport::speaksTls(properties))
            return Refusal{RefusalCode::Malformed, transport::certificateMissing(server, "client"), {}};
        data_communicator_ = transport::makeCommunicator({"axon-client", Lane::Data, 1, 1, properties});
        signal_communicator_ = transport::makeCommunicator(
            {"axon-signal", Lane::Signal, 1, 1, properties, transport::kReceiptPriority});
        for (auto [home, holder] :
             {std::pair{&data_, &data_communicator_}, {&signal_, &signal_communicator_}}) {
            *home = homeOf(*holder);
            if (transport::isRouter(server))
                home->router = transport::routerProxy(*home->communicator, server);
        }
        if (options.direct && !routed() && transport::speaksTls(properties)) openTls(properties);
        properties_ = std::move(properties);
    } catch (const std::invalid_argument& error) {
        return Refusal{RefusalCode::Malformed, error.what(), {}};
    } catch (const std::exception& error) {
        return Refusal{RefusalCode::Internal, error.what(), {}};
    }
    return {};
}

void Communicators::openTls(const std::map<std::string, std::string>& properties) {
    try {
        tls_ = direct::lane::Tls::of(transport::credentialsOf(properties), transport::wallTime);
    } catch (const certificates::Unusable& unusable) {
        log().debug("no direct path over TLS: {}; fix: {}", unusable.what(), unusable.fix());
    }
}

LaneHome Communicators::directSignal() {
    const std::lock_guard lock(mutex_);
    if (destroyed_) throw std::runtime_error("this program is shutting down");
    if (!direct_.communicator) {
        direct_communicator_ = transport::makeCommunicator({"axon-direct-sig", Lane::Signal, 1, 1,
                                                            transport::callingEntities(properties_),
                                                            transport::kReceiptPriority});
        transport::onlyEntities(direct_communicator_.communicator(),
                                std::shared_ptr<const certificates::Trust>(tls_, &tls_->trust()));
        direct_ = homeOf(direct_communicator_);
    }
    return direct_;
}

void Communicators::destroy() {
    std::shared_ptr<Ice::Communicator> direct;
    {
        const std::lock_guard lock(mutex_);
        destroyed_ = true;
        direct = direct_.communicator;
    }
    if (direct) direct->destroy();
    for (auto* holder : {&data_communicator_, &signal_communicator_}) {
        if (holder->communicator()) holder->communicator()->destroy();
    }
}

}  // namespace axon::client
