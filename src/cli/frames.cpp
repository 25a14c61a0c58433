// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/frames.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <random>
#include <system_error>

#include "common/descriptor.hpp"
#include "messages/text.hpp"

namespace axon::cli {
namespace {

void put(std::string& bytes, std::uint32_t value, int count) {
    for (int i = 0; i < count; ++i)
        bytes += static_cast<char>((value >> (8U * static_cast<unsigned>(i))) & 0xFFU);
}

constexpr std::uint32_t kMostPixels = 1U << 24U;

/// 24 bits per pixel, rows from below, each filled up to four bytes. `red`: which byte of a pixel is red;
/// `bytes_of_pixel` is 3 or 1.
std::string bitmap(std::uint32_t width, std::uint32_t height, std::string_view pixels,
                   std::size_t bytes_of_pixel, std::size_t red) {
    const auto row = (width * 3 + 3) / 4 * 4;
    std::string bytes = "BM";
    bytes.reserve(54 + static_cast<std::size_t>(row) * height);
    put(bytes, 54 + row * height, 4);
    put(bytes, 0, 4);
    put(bytes, 54, 4);  // where the pixels begin
    put(bytes, 40, 4);  // length of the header from here
    put(bytes, width, 4);
    put(bytes, height, 4);
    put(bytes, 1, 2);
    put(bytes, 24, 2);
    for (int i = 0; i < 6; ++i) put(bytes, 0, 4);
    for (std::uint32_t y = height; y-- > 0;) {
        for (std::uint32_t x = 0; x < width; ++x) {
            const auto at = (static_cast<std::size_t>(y) * width + x) * bytes_of_pixel;
            for (std::size_t colour = 0; colour < 3; ++colour)  // blue, green, red
                bytes += pixels[at + (bytes_of_pixel == 1 ? 0 : red == 0 ? 2 - colour : colour)];
        }
        bytes.append(row - width * 3, '\0');
    }
    return bytes;
}

/// 0, or errno.
int writeAll(int fd, std::string_view bytes) {
    while (!bytes.empty()) {
        const auto count = ::write(fd, bytes.data(), bytes.size());
        if (count < 0 && errno == EINTR) continue;
        if (count < 0) return errno;
        bytes.remove_prefix(static_cast<std::size_t>(count));
    }
    return 0;
}

/// Bytes that are neither letters, digits nor in `kept` as `mark` and two digits.
std::string encoded(std::string_view text, char mark, std::string_view kept) {
    std::string out;
    for (const char c : text) {
        const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                           kept.find(c) != std::string_view::npos;
        out += plain ? std::string(1, c) : fmt::format("{}{:02X}", mark, static_cast<unsigned char>(c));
    }
    return out;
}

}  // namespace

std::optional<std::string> fromBase64(std::string_view text) {
    std::string bytes;
    bytes.reserve(text.size() / 4 * 3);
    std::uint32_t collected = 0;
    unsigned bits = 0;
    std::size_t digits = 0;
    while (text.ends_with('=') && digits++ < 2) text.remove_suffix(1);
    if (text.size() % 4 == 1) return std::nullopt;
    for (const char c : text) {
        std::uint32_t value = 0;
        if (c >= 'A' && c <= 'Z') {
            value = static_cast<std::uint32_t>(c - 'A');
        } else if (c >= 'a' && c <= 'z') {
            value = static_cast<std::uint32_t>(c - 'a') + 26;
        } else if (c >= '0' && c <= '9') {
            value = static_cast<std::uint32_t>(c - '0') + 52;
        } else if (c == '+' || c == '-') {
            value = 62;
        } else if (c == '/' || c == '_') {
            value = 63;
        } else {
            return std::nullopt;
        }
        collected = (collected << 6U | value) & 0xFFFFFFU;
        bits += 6;
        if (bits < 8) continue;
        bits -= 8;
        bytes += static_cast<char>((collected >> bits) & 0xFFU);
    }
    return bytes;
}

std::optional<std::string> pictureOf(const Json& sample) {
    const auto image = sample.is_object() ? sample.find("image") : sample.end();
    if (!sample.is_object() || image == sample.end() || !image->is_object()) return std::nullopt;
    const auto coded = image->value("pixels", Json());
    const auto encoding = image->value("encoding", Json());
    if (!coded.is_string() || !encoding.is_string()) return std::nullopt;
    auto pixels = fromBase64(coded.get_ref<const std::string&>());
    if (!pixels || pixels->empty()) return std::nullopt;
    const auto ifItBegins = [&](std::string_view with) {
        return pixels->starts_with(with) ? std::move(pixels) : std::nullopt;
    };
    if (encoding == "jpeg" || encoding == "jpg") return ifItBegins("\xFF\xD8\xFF");
    if (encoding == "png") return ifItBegins("\x89PNG");
    const std::size_t bytes_of_pixel = encoding == "mono8"                        ? 1
                                       : encoding == "rgb8" || encoding == "bgr8" ? 3
                                                                                  : 0;
    const auto width = image->value("width", Json(0));
    const auto height = image->value("height", Json(0));
    if (bytes_of_pixel == 0 || !width.is_number_unsigned() || !height.is_number_unsigned())
        return std::nullopt;
    const auto columns = width.get<std::uint64_t>();
    const auto rows = height.get<std::uint64_t>();
    if (columns == 0 || rows == 0 || columns > kMostPixels || rows > kMostPixels ||
        columns * rows > kMostPixels || columns * rows * bytes_of_pixel != pixels->size())
        return std::nullopt;
    return bitmap(static_cast<std::uint32_t>(columns), static_cast<std::uint32_t>(rows), *pixels,
                  bytes_of_pixel, encoding == "rgb8" ? 0 : 2);
}

Result<void> replaceFile(const std::filesystem::path& file, std::string_view bytes) {
    const auto refuse = [&](const std::string& why) {
        return Refusal{RefusalCode::Malformed, "cannot write " + inQuotes(file.string(), 200) + ": " + why};
    };
    struct stat found {};
    if (::lstat(file.c_str(), &found) == 0 && !S_ISREG(found.st_mode))
        return refuse("it is there already and is no regular file");
    // Of a name that nobody can have taken before, and with the mode that the umask gives a new file.
    std::filesystem::path beside;
    Descriptor out;
    std::random_device random;
    do {
        beside = file;
        beside += fmt::format(".new-{:08x}{:08x}", random(), random());
        out = Descriptor(::open(beside.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666));
    } while (!out.open() && errno == EEXIST);
    if (!out.open()) return refuse(std::generic_category().message(errno));
    int error = writeAll(out.get(), bytes);
    out.reset();
    if (error == 0 && ::rename(beside.c_str(), file.c_str()) != 0) error = errno;
    if (error == 0) return {};
    ::unlink(beside.c_str());
    return refuse(std::generic_category().message(error));
}

std::string viewerPage(const std::string& title, const std::string& path) {
    const auto escaped = [](const std::string& text) {
        std::string out;
        for (const char c : text) {
            if (c == '&' || c == '<' || c == '>' || c == '"' || c == '\'') {
                out += "&#" + std::to_string(static_cast<int>(c)) + ";";
            } else {
                out += c;
            }
        }
        return out;
    };
    return "<!DOCTYPE html>\n<html><head><meta charset=\"utf-8\"><title>" + escaped(title) +
           "</title></head>\n<body style=\"margin:0;background:#222\">\n"
           "<img id=\"picture\" alt=\"waiting for the first picture\" style=\"width:100%;height:100vh;"
           "object-fit:contain;color:#ccc\" src=\"" +
           encoded(path, '%', "/-._~") +
           "\">\n<script>\n"
           "const picture = document.getElementById('picture');\n"
           "const address = picture.getAttribute('src');\n"
           "const next = () => setTimeout(() => { picture.src = address + '?' + Date.now(); }, 200);\n"
           "picture.onload = next;\npicture.onerror = next;\nnext();\n"
           "</script>\n</body></html>\n";
}

std::string viewFolderName(const std::string& entity_id, const std::string& stream) {
    return "view-" + encoded(entity_id, '_', "-") + "-" + encoded(stream, '_', "-");
}

}  // namespace axon::cli
