// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "cli/session.hpp"

// Manual pages in the form of man, from the same tables as --help.
namespace axon::cli {

/// "axon-global-run" for the verb "global run".
std::string manualName(const Verb& verb);
/// The page of a verb.
std::string manualPage(const Verb& verb);
/// axon(1): the verbs, the options of every verb, environment and exit status.
std::string manualPage();

/// The completion script of "bash", "zsh" or "fish".
std::string completionScript(const std::string& shell);

/// Writes below `folder` (an installation's share) all pages, man/man1/*.1, and the scripts where the shells
/// look for them. What cannot be written is MALFORMED, with the file.
Result<void> writeManual(const std::filesystem::path& folder);

}  // namespace axon::cli
