// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <vector>

#include "cli/session.hpp"

// How help, messages and manual pages name what a verb takes. Pure functions of the tables of verbs.
namespace axon::cli {

/// "ENTITY", "PARAMETER=VALUE".
std::string placeholderOf(const Operand& operand);
/// "FILE", "[=SECONDS]"; empty where the option takes nothing.
std::string placeholderOf(const Option& option);
/// "axon run ENTITY SERVICE [PARAMETER=VALUE…] [OPTIONS]".
std::string synopsisOf(const Verb& verb);
/// The words of an exit status: what the command promises about each of them.
struct ExitMeaning {
    int status;
    const char* meaning;
};
const std::vector<ExitMeaning>& exitMeanings();

}  // namespace axon::cli
