// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "common/clock.hpp"
#include "common/release.hpp"
#include "entity_manager/links/direct_refusals.hpp"
#include "transport/ice/connection_limits.hpp"

namespace axon::entity_manager {

/// The two Ice communicators of a process that hosts Entity Managers, shared by all of them: data, and
/// signals with a client thread pool of its own, because pushes over an outgoing connection are dispatched by
/// that pool (ADR 0003). Destroying it closes every connection and joins the threads, so it outlives
/// its Entity Managers.
class ServerCommunicators {
  public:
    /// `properties`: of Ice (Ice.*, IceSSL.*), for both. `trail`: of who is turned away at the ports of
    /// direct paths; null: nobody is told. Throws std::runtime_error for settings Ice does not accept.
    explicit ServerCommunicators(int data_threads = 2, int signal_threads = 1,
                                 const std::map<std::string, std::string>& properties = {},
                                 audit::AuditTrail* trail = nullptr);

    /// Closes every connection and joins the threads; blocks. Entity Managers that are left hear of nobody
    /// any more.
    void destroy();

    const std::shared_ptr<Ice::Communicator>& data() const { return data_.communicator(); }
    const std::shared_ptr<Ice::Communicator>& signal() const { return signal_.communicator(); }
    const std::shared_ptr<Ice::ObjectAdapter>& dataAdapter() const { return data_adapter_; }
    const std::shared_ptr<Ice::ObjectAdapter>& signalAdapter() const { return signal_adapter_; }
    /// The properties of Ice that they were made with.
    const std::map<std::string, std::string>& properties() const { return properties_; }
    /// Where the signal lanes of direct paths are opened: that of signals; for TLS one of its own, whose
    /// threads have no priority, as strangers make them calculate. Made by the first call. Throws
    /// std::runtime_error.
    const std::shared_ptr<Ice::Communicator>& direct(bool tls);
    /// What is said of servers of other releases, once for all Entity Managers.
    const std::shared_ptr<ReleaseNotes>& releases() const { return releases_; }
    /// Of the ports of direct paths; has a thread from the first call on. Any thread.
    transport::ConnectionLimits& limits();
    /// At the ports of direct paths. Any thread.
    const std::shared_ptr<DirectRefusals>& refusals() const { return refusals_; }

  private:
    /// Those that Ice itself turns away there.
    void watchStrangers(const std::shared_ptr<Ice::Communicator>& communicator);

    const std::shared_ptr<DirectRefusals> refusals_;  // before the communicators, whose threads use it
    Ice::CommunicatorHolder data_;
    Ice::CommunicatorHolder signal_;
    const std::map<std::string, std::string> properties_;
    const std::shared_ptr<ReleaseNotes> releases_;
    std::mutex mutex_;
    Ice::CommunicatorHolder direct_tls_;                // made under mutex_; none before
    std::shared_ptr<Ice::ObjectAdapter> data_adapter_;  // no endpoints: pushes come over our own connections
    std::shared_ptr<Ice::ObjectAdapter> signal_adapter_;
    const SteadyClock clock_{};
    std::once_flag limited_;
    std::optional<transport::ConnectionLimits> limits_;
};

}  // namespace axon::entity_manager
