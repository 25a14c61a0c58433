// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/table.hpp"

#include <algorithm>
#include <cstdint>

#include "common/utf8.hpp"
#include "messages/text.hpp"

namespace axon::cli {
namespace {

/// The character at `at` and the position after it. The text is UTF-8.
std::uint32_t pointAt(std::string_view text, std::size_t& at) {
    const auto lead = static_cast<unsigned char>(text[at++]);
    if (lead < 0x80U) return lead;
    const int more = lead >= 0xF0U ? 3 : lead >= 0xE0U ? 2 : 1;
    std::uint32_t point = lead & (0x3FU >> static_cast<unsigned>(more));
    for (int i = 0; i < more && at < text.size(); ++i) {
        point = (point << 6U) | (static_cast<unsigned char>(text[at++]) & 0x3FU);
    }
    return point;
}

std::size_t widthOf(std::uint32_t point) {
    const auto within = [point](std::uint32_t from, std::uint32_t to) {
        return point >= from && point <= to;
    };
    if (within(0x300, 0x36F) || within(0x200B, 0x200F) || within(0x20D0, 0x20FF) || within(0xFE00, 0xFE0F))
        return 0;
    const bool wide = within(0x1100, 0x115F) || within(0x2E80, 0xA4CF) || within(0xAC00, 0xD7A3) ||
                      within(0xF900, 0xFAFF) || within(0xFE30, 0xFE6F) || within(0xFF00, 0xFF60) ||
                      within(0xFFE0, 0xFFE6) || within(0x1F300, 0x1FAFF) || within(0x20000, 0x3FFFD);
    return wide ? 2 : 1;
}

}  // namespace

std::string tinted(std::string_view text, Tint tint, bool colour) {
    static constexpr const char* kCodes[] = {"", "1", "2", "32", "33", "31", "36"};
    if (!colour || tint == Tint::None || text.empty()) return std::string(text);
    return "\x1b[" + std::string(kCodes[static_cast<int>(tint)]) + "m" + std::string(text) + "\x1b[0m";
}

std::string printable(std::string_view text, bool lines) {
    std::string out;
    out.reserve(text.size());
    for (std::size_t i = 0; i < text.size();) {
        const auto c = static_cast<unsigned char>(text[i]);
        if (c < 0x80U) {
            if (c == '\n' && lines) {
                out += '\n';
            } else if (c == '\n' || c == '\t') {
                out += ' ';
            } else {
                out += c < 0x20U || c == 0x7FU ? '?' : text[i];
            }
            ++i;
            continue;
        }
        std::size_t length = c >= 0xF0U ? 4 : c >= 0xE0U ? 3 : 2;
        if (i + length > text.size() || !isUtf8(text.substr(i, length))) {
            out += '?';
            ++i;
            continue;
        }
        // U+0080 to U+009F are control characters as well: some terminals take U+009B for the start of a
        // sequence.
        const bool control = c == 0xC2U && static_cast<unsigned char>(text[i + 1]) < 0xA0U;
        if (control) {
            out += '?';
        } else {
            out += text.substr(i, length);
        }
        i += length;
    }
    return out;
}

std::size_t columns(std::string_view text) {
    std::size_t width = 0;
    for (std::size_t at = 0; at < text.size();) width += widthOf(pointAt(text, at));
    return width;
}

std::string shortened(std::string_view text, std::size_t width) {
    if (columns(text) <= width) return std::string(text);
    if (width == 0) return {};
    std::size_t used = 0;
    std::size_t at = 0;
    while (at < text.size()) {
        auto next = at;
        const auto more = widthOf(pointAt(text, next));
        if (used + more > width - 1) break;
        used += more;
        at = next;
    }
    return std::string(text.substr(0, at)) + "…";
}

std::string Table::text(bool colour) const {
    std::vector<std::size_t> widths(head_.size(), 0);
    for (const auto& row : rows_) {
        for (std::size_t i = 0; i < row.size() && i < widths.size(); ++i) {
            widths[i] = std::max(widths[i], columns(row[i].text));
        }
    }
    for (std::size_t i = 0; i < head_.size(); ++i) {
        if (widths[i] > 0) widths[i] = std::max(widths[i], columns(head_[i]));
    }
    std::string out;
    const auto print = [&](const std::vector<Cell>& row) {
        std::string built(indent_, ' ');
        std::size_t owed = 0;
        for (std::size_t i = 0; i < row.size() && i < widths.size(); ++i) {
            if (widths[i] == 0) continue;
            if (!row[i].text.empty()) {
                built.append(owed, ' ');
                owed = 0;
                built += tinted(row[i].text, row[i].tint, colour);
            }
            owed += widths[i] - columns(row[i].text) + 2;
        }
        out += built + "\n";
    };
    std::vector<Cell> head;
    for (const auto& name : head_) head.push_back({name, Tint::Dim});
    print(head);
    for (const auto& row : rows_) print(row);
    return out;
}

}  // namespace axon::cli
