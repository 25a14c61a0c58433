// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "server/server.hpp"

namespace axon::server {

struct Options {
    ServerSettings settings;
    std::string log_level = "info";
};

/// The command line of `axon-server` and the files that it names. Without options, the
/// command line has been answered already (--help, --version, a wrong option) and `exit_code` is the status.
/// Throws std::runtime_error for misconfiguration.
struct Parsed {
    std::optional<Options> options;
    int exit_code = 0;
};
Parsed parseOptions(int argc, char** argv);

/// Reads a settings file (docs/reference/settings_files.md) such as frontendserver.cfg into the settings;
/// docs/reference/server_configuration.md lists the keys. Throws std::runtime_error naming file, key,
/// what was expected and how to fix it.
void readConfiguration(const std::string& file, ServerSettings& settings);

}  // namespace axon::server
