// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <map>
#include <string>

namespace axon::transport {

/// A file in Ice property syntax: lines KEY=VALUE, `#` begins a comment. Throws std::runtime_error with the
/// mend.
std::map<std::string, std::string> readProperties(const std::filesystem::path& file);

}  // namespace axon::transport
