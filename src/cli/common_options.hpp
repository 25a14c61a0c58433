// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <variant>
#include <vector>

#include "cli/session.hpp"

// The options that all verbs share.
namespace axon::cli {

/// One of them. A new one is a line of the table in common_options.cpp and a member of Settings: the parser,
/// --help, the shell completion and the start of an agent go by the table, and a test compares it with
/// docs/reference/command.md.
struct CommonOption {
    const char* name;  ///< without "--"
    Takes takes;
    const char* placeholder;  ///< what help calls its value; empty where it takes none
    const char* environment;  ///< the variable that gives its default; empty where there is none
    /// Where its value goes; a flag (bool) turns the default over.
    std::variant<std::string Settings::*, double Settings::*, bool Settings::*> setting;
    bool for_agent;  ///< whether an agent is started with it
    const char* help;
};

const std::vector<CommonOption>& commonOptions();
/// For --help: the text of the table, the variable and the default that `settings` have.
std::string helpOf(const CommonOption& option, const Settings& settings);
/// The words of a command line that start an agent with these settings. No password is among them.
std::vector<std::string> wordsForAgent(const Settings& settings);

}  // namespace axon::cli
