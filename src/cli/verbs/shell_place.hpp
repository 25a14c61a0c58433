// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <optional>

namespace axon::cli {

/// The folder with the Python package axon that belongs to `program` (the path of axon itself): what
/// PYTHONPATH is to name. No value = it is not installed.
std::optional<std::filesystem::path> pythonFolder(const std::filesystem::path& program);

}  // namespace axon::cli
