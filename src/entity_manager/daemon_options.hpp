// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "audit/trail.hpp"
#include "entity_manager/links/back_end/back_end_interface.hpp"
#include "entity_manager/links/datagrams/datagram_desk.hpp"
#include "entity_manager/links/direct/direct_door.hpp"
#include "entity_manager/links/server/entity_communicator.hpp"
#include "entity_manager/ports/core_settings.hpp"

namespace axon::entity_manager {

/// All that axon-entity-manager is told: command line over configuration file over defaults
/// (docs/reference/configuration.md).
struct DaemonOptions {
    EntityManagerCoreSettings core;
    ServerAddress server;
    BackEndSettings back_end;
    DatagramSettings datagrams;
    DirectSettings direct;
    std::filesystem::path state_folder;
    audit::TrailSettings audit;  ///< no folder: nothing is recorded
    std::string log_level = "info";
    bool lock_memory = true;                            ///< where permitted
    std::map<std::string, std::string> ice_properties;  ///< Ice.* and IceSSL.* of the configuration
    /// Set when there is nothing to run: --help, --version, or a wrong command line (which has been
    /// explained).
    std::optional<int> exit_code;

    /// Of its audit trail.
    std::string trailName() const {
        return "axon-entity-manager-" + core.application +
               (back_end.instance.empty() ? std::string() : "-" + back_end.instance);
    }
};

/// Throws std::runtime_error with the fix for a configuration that cannot be used.
DaemonOptions readDaemonOptions(int argc, const char* const* argv);

}  // namespace axon::entity_manager
