// SPDX-License-Identifier: MIT
#include "messages/profile_command.hpp"

#include <cstdio>
#include <ostream>
#include <string_view>

#include "common/utf8.hpp"
#include "messages/profile_reader.hpp"
#include "messages/text.hpp"

namespace axon {
namespace {

/// A JSON string. File names are bytes; those that are no UTF-8 are shown as '?'.
std::string jsonText(std::string_view text) {
    const bool utf8 = isUtf8(text);
    std::string out = "\"";
    for (const char c : text) {
        const auto byte = static_cast<unsigned char>(c);
        if (c == '"' || c == '\\') {
            out += '\\';
            out += c;
        } else if (byte < 0x20U) {
            char buffer[8];
            std::snprintf(buffer, sizeof buffer, "\\u%04x", static_cast<unsigned>(byte));
            out += buffer;
        } else {
            out += byte >= 0x80U && !utf8 ? '?' : c;
        }
    }
    return out + '"';
}

void printJson(const Finding& finding, std::ostream& out) {
    out << "{\"file\":" << jsonText(finding.file) << ",\"line\":" << finding.line
        << ",\"severity\":" << (finding.severity == Finding::Severity::Error ? "\"error\"" : "\"warning\"")
        << ",\"element\":" << jsonText(finding.element) << ",\"expected\":" << jsonText(finding.expected)
        << ",\"fix\":" << jsonText(finding.fix) << "}\n";
}

std::string counted(std::size_t number, std::string_view what) {
    return std::to_string(number) + " " + std::string(what) + (number == 1 ? "" : "s");
}

}  // namespace

int checkProfiles(const std::vector<std::string>& files, bool json, std::ostream& out) {
    std::size_t errors = 0;
    std::size_t warnings = 0;
    bool all_readable = !files.empty();
    for (const auto& file : files) {
        const auto check = checkProfileFile(file);
        all_readable = all_readable && check.readable;
        for (const auto& finding : check.findings) {
            ++(finding.severity == Finding::Severity::Error ? errors : warnings);
            if (json) {
                printJson(finding, out);
            } else {
                out << finding.toString() << "\n";
            }
        }
    }
    const bool ok = all_readable && errors == 0;
    if (json) {
        out << "{\"ok\":" << (ok ? "true" : "false") << ",\"files\":" << files.size()
            << ",\"errors\":" << errors << ",\"warnings\":" << warnings << "}\n";
    } else if (files.empty()) {
        out << "profile check: at least one file is expected: axon profile check FILE...\n";
    } else {
        out << counted(files.size(), "file") << ": " << counted(errors, "error") << ", "
            << counted(warnings, "warning") << "\n";
    }
    return !all_readable ? 2 : errors > 0 ? 1 : 0;
}

}  // namespace axon
