// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/server/server_communicators.hpp"

#include "transport/ice/broken_protocol.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/tls.hpp"

namespace axon::entity_manager {

ServerCommunicators::ServerCommunicators(int data_threads, int signal_threads,
                                         const std::map<std::string, std::string>& properties,
                                         audit::AuditTrail* trail)
    : refusals_(std::make_shared<DirectRefusals>(trail)),
      data_(transport::makeCommunicator({.name = "axon-em-data",
                                         .lane = Lane::Data,
                                         .client_threads = data_threads,
                                         .properties = properties})),
      signal_(transport::makeCommunicator({.name = "axon-em-signal",
                                           .lane = Lane::Signal,
                                           .client_threads = signal_threads,
                                           .properties = properties})),
      properties_(properties),
      releases_(std::make_shared<ReleaseNotes>("this Entity Manager", transport::ourContract())),
      data_adapter_(data_->createObjectAdapter("")),
      signal_adapter_(signal_->createObjectAdapter("")) {
    watchStrangers(signal());
    data_adapter_->activate();
    signal_adapter_->activate();
}

void ServerCommunicators::watchStrangers(const std::shared_ptr<Ice::Communicator>& communicator) {
    transport::onBrokenProtocol(
        communicator,
        [refusals = refusals_](const std::string& peer, const std::string&, const std::string& why) {
            refusals->refused({}, peer, kSignalLane, {RefusalCode::Malformed, why, {}});
        });
    transport::onRefused(communicator, [refusals = refusals_](const std::string& peer, const std::string&,
                                                              const std::string& why) {
        refusals->record({}, peer, "a TLS handshake", {RefusalCode::PermissionDenied, why, {}});
    });
}

const std::shared_ptr<Ice::Communicator>& ServerCommunicators::direct(bool tls) {
    if (!tls) return signal();
    const std::lock_guard lock(mutex_);
    if (!direct_tls_.communicator()) {
        auto properties = properties_;
        properties.emplace("Ice.MessageSizeMax", std::to_string(transport::kSignalSizeMaxKib));
        direct_tls_ = transport::makeCommunicator(
            {.name = "axon-em-direct", .lane = Lane::Data, .properties = std::move(properties)});
        watchStrangers(direct_tls_.communicator());
    }
    return direct_tls_.communicator();
}

transport::ConnectionLimits& ServerCommunicators::limits() {
    // A client opens a path in a moment, and each Entity Manager has one holder at a time.
    static constexpr transport::ConnectionBounds kBounds{.strangers_of_one_address = 256, .strangers = 1024};
    std::call_once(limited_, [this] {
        limits_.emplace(
            clock_, [this](const std::string& line) { refusals_->closed({}, line); }, kBounds);
    });
    return *limits_;
}

void ServerCommunicators::destroy() {
    data_->destroy();
    signal_->destroy();
    std::shared_ptr<Ice::Communicator> tls;
    {
        const std::lock_guard lock(mutex_);
        tls = direct_tls_.communicator();
    }
    if (tls) tls->destroy();  // which joins threads that may want the mutex
}

}  // namespace axon::entity_manager
