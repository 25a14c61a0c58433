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

/// The picture of a sample as a file that viewers and browsers show: jpeg and png as they are, rgb8, bgr8 and
/// mono8 as BMP. Nothing where the sample has no such picture.
struct Picture {
    std::string bytes;
    const char* extension;  ///< ".jpg", ".png", ".bmp"
};
std::optional<Picture> pictureOf(const Json& sample);

/// Whoever reads the file meanwhile sees the old content or the new one, whole. MALFORMED with the reason.
Result<void> replaceFile(const std::filesystem::path& file, std::string_view bytes);

/// A page that shows the picture `name` beside it and loads it again five times a second.
std::string viewerPage(const std::string& title, const std::string& name);

}  // namespace axon::cli
