// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "cli/session.hpp"

// Pictures of a camera's stream as files.
namespace axon::cli {

/// Nothing where the text is no base64.
std::optional<std::string> fromBase64(std::string_view text);

/// The picture of a sample as the content of a file that viewers and browsers show: jpeg and png as they are,
/// if they begin as such, rgb8, bgr8 and mono8 as BMP. Nothing where the sample has no such picture.
std::optional<std::string> pictureOf(const Json& sample);

/// Whoever reads the file meanwhile sees the old content or the new one, whole. Replaces nothing but a
/// regular file: no device, no link. MALFORMED with the reason.
Result<void> replaceFile(const std::filesystem::path& file, std::string_view bytes);

/// A page that shows the picture at `path` and loads it again five times a second.
std::string viewerPage(const std::string& title, const std::string& path);

/// The name of the folder for the page of one stream: two streams never have the same.
std::string viewFolderName(const std::string& entity_id, const std::string& stream);

}  // namespace axon::cli
