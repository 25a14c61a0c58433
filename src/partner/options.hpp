// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <optional>
#include <string>

#include "partner/gateway.hpp"

namespace axon::partner {

/// All that axon-partner is told: command line over configuration file over defaults (README.md).
struct PartnerOptions {
    GatewaySettings gateway;  ///< without its secret
    std::filesystem::path state_folder;
    std::string log_level = "info";
    /// Set when there is nothing to run: --help, --version, or a wrong command line (which has been
    /// explained).
    std::optional<int> exit_code;
};

/// Throws std::runtime_error with the fix for a configuration that cannot be used.
PartnerOptions readPartnerOptions(int argc, const char* const* argv);

}  // namespace axon::partner
