// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "cli/session.hpp"

namespace axon::cli {

/// What the user wrote.
struct CommandLine {
    const Verb* verb = nullptr;
    Json args = Json::object();
    Settings settings;
    std::vector<std::string> command;  ///< after `checkout … --`
};

struct Parsed {
    std::optional<CommandLine> line;  ///< or else:
    int exit = kDone;
    std::string out, err;  ///< help, or what is wrong
};

/// `words` without the program's name. AXON_SERVER, AXON_CONFIG, AXON_USER and AXON_PASSWORD give defaults
/// through `environment`. Where the server is: --server, else the file of --config, else AXON_SERVER, else
/// the file of AXON_CONFIG, else this machine.
Parsed parseCommandLine(std::vector<std::string> words,
                        const std::function<const char*(const char*)>& environment);

}  // namespace axon::cli
