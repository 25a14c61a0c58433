// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <optional>
#include <string_view>

namespace axon::cli {

/// The page of the documentation site that belongs to this program: installed beside it
/// (PREFIX/share/doc/axon/html), or built (build/docs-site). `page` is its path in the sources, or in the
/// site; empty = the first one. Nothing where there is no such file.
std::optional<std::filesystem::path> docsPage(const std::filesystem::path& program, std::string_view page);

}  // namespace axon::cli
