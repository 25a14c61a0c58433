// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/cyton/settings.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <charconv>
#include <cmath>
#include <fstream>
#include <regex>
#include <system_error>

namespace axon::cyton {
namespace {

template <class T>
bool parse(std::string_view text, T& value) {
    const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
    return result.ec == std::errc{} && result.ptr == text.data() + text.size();
}

std::string escaped(std::string_view text) {
    std::string out;
    for (const char c : text) {
        if (c == '&')
            out += "&amp;";
        else if (c == '<')
            out += "&lt;";
        else if (c == '"')
            out += "&quot;";
        else
            out += c;
    }
    return out;
}

}  // namespace

std::pair<std::uint16_t, std::uint16_t> parsePortRange(const std::string& text) {
    const auto dash = text.find('-');
    std::uint16_t first = 0;
    std::uint16_t last = 0;
    if (dash == std::string::npos || !parse(text.substr(0, dash), first) ||
        !parse(text.substr(dash + 1), last) || first > last) {
        throw BadSetting(
            fmt::format("--ports {}: expected a ports.cfg that exists, or a range such as 5500-5600", text));
    }
    return {first, last};
}

std::array<double, 3> parsePlace(const std::string& text) {
    std::array<double, 3> place{};
    std::size_t at = 0;
    for (std::size_t i = 0; i < place.size(); ++i) {
        const auto comma = i + 1 < place.size() ? text.find(',', at) : text.size();
        if (comma == std::string::npos || !parse(text.substr(at, comma - at), place[i]) ||
            !std::isfinite(place[i]))
            throw BadSetting(fmt::format("--at {}: expected X,Y,Z in mm, for example 600,3000,700", text));
        at = comma + 1;
    }
    return place;
}

std::string withSpeed(const std::string& arm) {
    return arm.starts_with('/') && arm.find(':') == std::string::npos ? arm + ":115200" : arm;
}

std::string withEntityName(const std::string& xml, std::string_view name) {
    // The first name="..." of the root element, comments before it skipped.
    static const std::regex kName(
        R"(^(?:\s|<\?[^>]*\?>|<!--(?:[^-]|-(?!->))*-->)*<BasicProfile\b[^>]*?\sname\s*=\s*("[^"]*"|'[^']*'))");
    std::smatch match;
    if (!std::regex_search(xml, match, kName))
        throw BadSetting("--name: the basic profile has no <BasicProfile name=\"...\"> to put it into");
    return xml.substr(0, static_cast<std::size_t>(match.position(1))) + '"' + escaped(name) + '"' +
           xml.substr(static_cast<std::size_t>(match.position(1) + match.length(1)));
}

std::filesystem::path profileFolder(const Settings& settings) {
    auto folder = settings.profiles;
    if (folder.empty()) {
        std::error_code error;
        folder = std::filesystem::read_symlink("/proc/self/exe", error).parent_path().parent_path() /
                 "share/axon/robots/cyton";
    }
    for (const char* file : {"basic_profile.xml", "services_profile.xml"}) {
        std::error_code error;
        if (std::filesystem::is_regular_file(folder / file, error)) continue;
        throw BadSetting(fmt::format("there is no {} in {}: say with --profiles where the two profiles lie",
                                     file, folder.string()));
    }
    return folder;
}

TemporaryFile::TemporaryFile(const std::string& content) {
    auto pattern = (std::filesystem::temp_directory_path() / "axon-cyton-XXXXXX.xml").string();
    const int fd = ::mkstemps(pattern.data(), 4);
    if (fd < 0)
        throw std::system_error(errno, std::generic_category(), "cannot make a temporary file in " + pattern);
    ::close(fd);
    path_ = pattern;
    std::ofstream(path_) << content;
}

TemporaryFile::~TemporaryFile() {
    std::error_code error;
    std::filesystem::remove(path_, error);
}

}  // namespace axon::cyton
