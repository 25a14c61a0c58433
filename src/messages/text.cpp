// SPDX-License-Identifier: MIT
#include "messages/text.hpp"

#include <algorithm>
#include <utility>

#include "common/utf8.hpp"

namespace axon {
namespace {

char lower(char c) {
    return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
}

/// Cells of edit distance that one search may cost: two hundred ordinary names, and still nothing to wait
/// for when a hostile profile asks for hundreds of searches among thousands of long ones.
constexpr std::size_t kSearchBudget = 50000;

std::size_t editDistance(std::string_view a, std::string_view b) {
    std::vector<std::size_t> row(b.size() + 1);
    for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
    for (std::size_t i = 1; i <= a.size(); ++i) {
        std::size_t diagonal = std::exchange(row[0], i);
        for (std::size_t j = 1; j <= b.size(); ++j) {
            const std::size_t replaced = diagonal + (lower(a[i - 1]) == lower(b[j - 1]) ? 0 : 1);
            diagonal = std::exchange(row[j], std::min({replaced, row[j] + 1, row[j - 1] + 1}));
        }
    }
    return row[b.size()];
}

}  // namespace

std::string inQuotes(std::string_view text, std::size_t limit) {
    std::string out = "\"";
    std::size_t i = 0;
    while (i < text.size()) {
        const std::size_t length = utf8Length(text.substr(i));
        if (i + std::max<std::size_t>(length, 1) > limit) break;
        const auto c = static_cast<unsigned char>(text[i]);
        if (length == 0 || c < 0x20U || c == 0x7FU) {
            out += '?';
            ++i;
        } else {
            out += text.substr(i, length);
            i += length;
        }
    }
    return out + (i < text.size() ? "...\"" : "\"");
}

std::size_t countCharacters(std::string_view text) {
    return static_cast<std::size_t>(std::count_if(
        text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xC0U) != 0x80U; }));
}

std::string_view trimmed(std::string_view text) {
    constexpr std::string_view kSpace = " \t\r\n";
    const std::size_t first = text.find_first_not_of(kSpace);
    if (first == std::string_view::npos) return {};
    return text.substr(first, text.find_last_not_of(kSpace) - first + 1);
}

bool equalIgnoringCase(std::string_view a, std::string_view b) {
    return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                      [](char x, char y) { return lower(x) == lower(y); });
}

std::vector<std::string> nearNames(std::string_view name, const std::vector<std::string_view>& candidates) {
    // Longer names than a profile allows come from the wire and are nobody's slip of the finger.
    if (name.empty() || name.size() > 512) return {};
    const std::size_t limit = std::max<std::size_t>(2, name.size() / 3);
    std::size_t budget = kSearchBudget;
    std::vector<std::pair<std::size_t, std::string_view>> near;
    for (const auto candidate : candidates) {
        const std::size_t longer = std::max(candidate.size(), name.size());
        const std::size_t shorter = std::min(candidate.size(), name.size());
        if (candidate.empty() || longer - shorter > limit) continue;
        if (name.size() * candidate.size() > budget) break;
        budget -= name.size() * candidate.size();
        const std::size_t distance = editDistance(name, candidate);
        if (distance <= limit && distance < longer) near.emplace_back(distance, candidate);
    }
    std::stable_sort(near.begin(), near.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    std::vector<std::string> names;
    for (const auto& [distance, candidate] : near) {
        if (names.size() < 3 && std::find(names.begin(), names.end(), candidate) == names.end())
            names.emplace_back(candidate);
    }
    return names;
}

std::string alternatives(const std::vector<std::string>& names) {
    std::string out;
    for (std::size_t i = 0; i < names.size(); ++i) {
        if (i > 0) out += i + 1 == names.size() ? " or " : ", ";
        out += inQuotes(names[i]);
    }
    return out;
}

}  // namespace axon
