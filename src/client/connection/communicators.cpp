// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/connection/communicators.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>

#include "client/base/durations.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/tls.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::client {

Result<void> Communicators::open(const Options& options) {
    try {
        const auto milliseconds = std::max<long long>(
            1, std::chrono::duration_cast<std::chrono::milliseconds>(toDuration(options.timeout)).count());
        auto properties = options.properties;
        properties["Ice.Override.ConnectTimeout"] = std::to_string(milliseconds);
        const auto& server = options.server;
        const bool tls = transport::isRouter(server) ? transport::isTlsRouter(server)
                                                     : transport::parseEndpoint(server).tls;
        if (tls && !transport::speaksTls(properties))
            return Refusal{RefusalCode::Malformed, transport::certificateMissing(server, "client"), {}};
        data_communicator_ = transport::makeCommunicator({"axon-client", Lane::Data, 1, 1, properties});
        signal_communicator_ = transport::makeCommunicator(
            {"axon-signal", Lane::Signal, 1, 1, properties, transport::kReceiptPriority});
        for (auto [home, holder] :
             {std::pair{&data_, &data_communicator_}, {&signal_, &signal_communicator_}}) {
            home->communicator = holder->communicator();
            home->adapter = home->communicator->createObjectAdapter("");
            home->adapter->activate();
            if (transport::isRouter(server))
                home->router = transport::routerProxy(*home->communicator, server);
        }
    } catch (const std::invalid_argument& error) {
        return Refusal{RefusalCode::Malformed, error.what(), {}};
    } catch (const std::exception& error) {
        return Refusal{RefusalCode::Internal, error.what(), {}};
    }
    return {};
}

void Communicators::destroy() {
    for (auto* holder : {&data_communicator_, &signal_communicator_}) {
        if (holder->communicator()) holder->communicator()->destroy();
    }
}

}  // namespace axon::client
