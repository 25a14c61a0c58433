// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <map>
#include <string>

namespace axon::transport {

/// Reads a file in Ice property syntax: lines KEY=VALUE, `#` begins a comment. Throws std::runtime_error that
/// says what was expected.
std::map<std::string, std::string> readProperties(const std::filesystem::path& file);

}  // namespace axon::transport
