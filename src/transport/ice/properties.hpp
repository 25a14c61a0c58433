// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <map>
#include <set>
#include <string>

#include "host/settings_file.hpp"

namespace axon::transport {

/// What the configuration file of one of our programs says.
struct Properties {
    std::map<std::string, Setting, std::less<>> own;  ///< by key
    std::map<std::string, std::string> ice;           ///< Ice.* and IceSSL.*, for its communicators
};

/// Reads a configuration file (host/settings_file.hpp, docs/reference/settings_files.md). `known` are the
/// keys of the program; one that ends in a dot stands for all keys that begin with it and are longer. If a
/// key appears twice, the last line counts, and an empty value is the same as no value, as with Ice. Throws
/// std::runtime_error for a file that cannot be read, a line that is no setting, and a key that is neither
/// known nor one of Ice; the message says what was expected and the fix.
Properties readProperties(const std::filesystem::path& file, const std::set<std::string>& known);

}  // namespace axon::transport
