// SPDX-License-Identifier: GPL-2.0-or-later
#include "datagrams/endpoint.hpp"

#include <charconv>

namespace axon::datagrams {
namespace {

/// A decimal number without sign or leading zeros, which some readers take for octal.
std::optional<std::uint32_t> number(std::string_view text, std::uint32_t most) {
    std::uint32_t value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size() || value > most) return std::nullopt;
    if (text.size() > 1 && text.front() == '0') return std::nullopt;
    return value;
}

}  // namespace

std::optional<std::uint32_t> parseAddress(std::string_view text) {
    std::uint32_t address = 0;
    for (int part = 0; part < 4; ++part) {
        const auto dot = part < 3 ? text.find('.') : text.size();
        if (dot == std::string_view::npos) return std::nullopt;
        const auto value = number(text.substr(0, dot), 255);
        if (!value) return std::nullopt;
        address = address << 8U | *value;
        text.remove_prefix(part < 3 ? dot + 1 : dot);
    }
    return address;
}

std::optional<Endpoint> Endpoint::parse(std::string_view text) {
    const auto colon = text.rfind(':');
    if (colon == std::string_view::npos) return std::nullopt;
    const auto address = parseAddress(text.substr(0, colon));
    const auto port = number(text.substr(colon + 1), 65535);
    if (!address || !port) return std::nullopt;
    return Endpoint{*address, static_cast<std::uint16_t>(*port)};
}

std::string Endpoint::toString() const {
    std::string text;
    for (int shift = 24; shift >= 0; shift -= 8)
        text += std::to_string(address >> static_cast<unsigned>(shift) & 255U) + (shift > 0 ? "." : ":");
    return text + std::to_string(port);
}

}  // namespace axon::datagrams
