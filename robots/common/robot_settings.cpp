// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/robot_settings.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <sstream>
#include <system_error>

#include "common/descriptor.hpp"

namespace axon::robots {
namespace {

template <class T>
bool parse(std::string_view text, T& value) {
    const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
    return result.ec == std::errc{} && result.ptr == text.data() + text.size();
}

std::string escaped(std::string_view text) {
    std::string out;
    for (const char c : text) {
        switch (c) {
            case '&':
                out += "&amp;";
                break;
            case '<':
                out += "&lt;";
                break;
            case '"':
                out += "&quot;";
                break;
            default:
                out += c;
        }
    }
    return out;
}

struct Attribute {
    std::string name;
    std::size_t begin = 0;  // of the value with its quotes
    std::size_t end = 0;
};

/// Of the element BasicProfile; as far as they are well-formed, the profile's reader complains about the
/// rest.
std::vector<Attribute> attributesOfRoot(const std::string& xml) {
    constexpr std::string_view kBlank = " \t\r\n";
    constexpr std::string_view kRoot = "<BasicProfile";
    std::size_t at = xml.find(kRoot);
    for (auto comment = xml.find("<!--"); comment < at && at != std::string::npos;
         comment = xml.find("<!--", comment)) {
        comment = std::min(xml.find("-->", comment), xml.size());
        at = xml.find(kRoot, comment);
    }
    std::vector<Attribute> attributes;
    if (at == std::string::npos) return attributes;
    at += kRoot.size();
    while (true) {
        const auto name = xml.find_first_not_of(kBlank, at);
        const auto equals = xml.find('=', at);
        if (equals == std::string::npos || xml.find('>', at) < equals) return attributes;
        const auto name_end = xml.find_last_not_of(kBlank, equals - 1) + 1;
        const auto begin = xml.find_first_not_of(kBlank, equals + 1);
        if (begin == std::string::npos || name_end <= name || (xml[begin] != '"' && xml[begin] != '\''))
            return attributes;
        const auto close = xml.find(xml[begin], begin + 1);
        if (close == std::string::npos) return attributes;
        attributes.push_back({xml.substr(name, name_end - name), begin, close + 1});
        at = close + 1;
    }
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

std::array<double, 3> parseThreeNumbers(std::string_view text, std::string_view what,
                                        std::string_view expected) {
    std::array<double, 3> numbers{};
    std::size_t at = 0;
    for (std::size_t i = 0; i < numbers.size(); ++i) {
        const auto comma = i + 1 < numbers.size() ? text.find(',', at) : text.size();
        if (comma == std::string_view::npos || !parse(text.substr(at, comma - at), numbers[i]) ||
            !std::isfinite(numbers[i]))
            throw BadSetting(fmt::format("{} {}: expected {}", what, text, expected));
        at = comma + 1;
    }
    return numbers;
}

std::filesystem::path installedFolder(const std::string& kind) {
    std::error_code error;
    return std::filesystem::read_symlink("/proc/self/exe", error).parent_path().parent_path() /
           "share/axon/robots" / kind;
}

std::filesystem::path profileFolder(const RobotSettings& settings) {
    const auto folder = settings.profiles.empty() ? installedFolder(settings.kind) : settings.profiles;
    for (const char* file : {"basic_profile.xml", "services_profile.xml"}) {
        std::error_code error;
        if (std::filesystem::is_regular_file(folder / file, error)) continue;
        throw BadSetting(fmt::format("there is no {} in {}: say with --profiles where the two profiles lie",
                                     file, folder.string()));
    }
    return folder;
}

std::string withEntityName(const std::string& xml, std::string_view name) {
    for (const auto& [attribute, begin, end] : attributesOfRoot(xml)) {
        if (attribute == "name") return xml.substr(0, begin) + '"' + escaped(name) + '"' + xml.substr(end);
    }
    throw BadSetting("--name: the basic profile has no <BasicProfile name=\"...\"> to put it into");
}

std::string contentOf(const std::filesystem::path& file) {
    std::ostringstream content;
    content << std::ifstream(file).rdbuf();
    return content.str();
}

TemporaryFile::TemporaryFile(const std::string& content) {
    auto pattern = (std::filesystem::temp_directory_path() / "axon-robot-XXXXXX.xml").string();
    const Descriptor made(::mkstemps(pattern.data(), 4));
    if (!made.open())
        throw std::system_error(errno, std::generic_category(), "cannot make a temporary file in " + pattern);
    path_ = pattern;
    std::ofstream(path_) << content;
}

TemporaryFile::~TemporaryFile() {
    std::error_code error;
    std::filesystem::remove(path_, error);
}

}  // namespace axon::robots
