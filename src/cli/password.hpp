// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <optional>
#include <string>

#include "common/result.hpp"

// Where passwords come from; never from the command line, which every user of the machine can read.
namespace axon::cli {

/// The first line of the file. PERMISSION_DENIED with the fix when others may read it, or it is not this
/// user's.
Result<std::string> readPassword(const std::filesystem::path& file);

/// Asks at the terminal, without showing what is typed. Nothing where there is no terminal.
std::optional<std::string> askPassword(const std::string& user, const std::string& server);

}  // namespace axon::cli
