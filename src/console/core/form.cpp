// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/form.hpp"

#include <algorithm>
#include <cctype>
#include <functional>

namespace axon::console {
namespace {

constexpr std::size_t kNamesMax = 8;

std::string_view trimmed(std::string_view text) {
    const auto begin = text.find_first_not_of(" \t");
    if (begin == std::string_view::npos) return {};
    return text.substr(begin, text.find_last_not_of(" \t") - begin + 1);
}

/// `each` returns whether it has seen enough.
void split(std::string_view text, char at, const std::function<bool(std::string_view)>& each) {
    while (true) {
        const auto end = text.find(at);
        if (each(text.substr(0, end)) || end == std::string_view::npos) return;
        text.remove_prefix(end + 1);
    }
}

int digit(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
}

std::optional<std::string> decoded(std::string_view text) {
    std::string out;
    for (std::size_t i = 0; i < text.size(); ++i) {
        const auto c = static_cast<unsigned char>(text[i]);
        if (c == '+') {
            out += ' ';
        } else if (c == '%') {
            const int high = i + 2 < text.size() ? digit(text[i + 1]) : -1;
            const int low = i + 2 < text.size() ? digit(text[i + 2]) : -1;
            if (high < 0 || low < 0) return std::nullopt;
            out += static_cast<char>(high * 16 + low);
            i += 2;
        } else if (c <= ' ' || c >= 0x7f) {
            return std::nullopt;
        } else {
            out += static_cast<char>(c);
        }
    }
    return out;
}

bool sameLetters(std::string_view one, std::string_view other) {
    return std::equal(one.begin(), one.end(), other.begin(), other.end(),
                      [](unsigned char a, unsigned char b) { return std::tolower(a) == std::tolower(b); });
}

/// Of IPv4, or what can only be one of IPv6.
bool isAddress(std::string_view text) {
    constexpr std::size_t kLongest = 45;
    const auto of = [&](char c) { return std::count(text.begin(), text.end(), c); };
    if (of(':') > 0)
        return of(':') >= 2 && of(':') <= 8 && text.size() <= kLongest &&
               text.find_first_not_of("0123456789abcdefABCDEF:.") == std::string_view::npos;
    int numbers = 0;
    bool proper = true;
    split(text, '.', [&](std::string_view part) {
        ++numbers;
        proper = !part.empty() && part.size() <= 3 &&
                 part.find_first_not_of("0123456789") == std::string_view::npos &&
                 (part.size() < 3 || part <= "255");
        return !proper;
    });
    return proper && numbers == 4;
}

/// "q=0", "q=0.0", "q=0.000"
bool isNever(std::string_view parameter) {
    const auto its = trimmed(parameter);
    if (its.size() < 3 || !sameLetters(its.substr(0, 3), "q=0")) return false;
    return its.find_first_not_of("0.", 3) == std::string_view::npos;
}

}  // namespace

std::optional<Form> parseForm(std::string_view body) {
    Form form;
    bool proper = true;
    if (body.empty()) return form;
    split(body, '&', [&](std::string_view pair) {
        const auto equals = pair.find('=');
        auto name = decoded(pair.substr(0, equals));
        auto value = decoded(equals == std::string_view::npos ? std::string_view() : pair.substr(equals + 1));
        proper = name && value && !name->empty() && form.size() < kNamesMax &&
                 form.try_emplace(std::move(*name), std::move(*value)).second;
        return !proper;
    });
    if (!proper) return std::nullopt;
    return form;
}

std::optional<std::string> cookie(std::string_view header, std::string_view name) {
    std::optional<std::string> value;
    std::size_t found = 0;
    split(header, ';', [&](std::string_view pair) {
        const auto its = trimmed(pair);
        if (its.size() > name.size() && its.substr(0, name.size()) == name && its[name.size()] == '=') {
            value = std::string(its.substr(name.size() + 1));
            ++found;
        }
        return found > 1;
    });
    if (found != 1) return std::nullopt;
    return value;
}

bool accepts(std::string_view header, std::string_view coding) {
    bool its = false;
    split(header, ',', [&](std::string_view one) {
        const auto semicolon = one.find(';');
        if (!sameLetters(trimmed(one.substr(0, semicolon)), coding)) return false;
        its = semicolon == std::string_view::npos || !isNever(one.substr(semicolon + 1));
        return true;
    });
    return its;
}

bool matchesTag(std::string_view header, std::string_view tag) {
    bool its = false;
    split(header, ',', [&](std::string_view one) {
        one = trimmed(one);
        if (one.starts_with("W/")) one.remove_prefix(2);
        its = one == tag || one == "*";
        return its;
    });
    return its;
}

std::optional<std::string> forwardedFor(std::string_view header) {
    const auto comma = header.rfind(',');
    const auto last = trimmed(comma == std::string_view::npos ? header : header.substr(comma + 1));
    if (!isAddress(last)) return std::nullopt;
    return std::string(last);
}

}  // namespace axon::console
