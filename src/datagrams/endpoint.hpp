// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <compare>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace axon::datagrams {

/// An IPv4 address and a port, as numbers in the machine's order. Never a name: the way of a stop asks no
/// resolver.
struct Endpoint {
    std::uint32_t address = 0;
    std::uint16_t port = 0;

    /// "127.0.0.1:5500"; nothing else is accepted.
    static std::optional<Endpoint> parse(std::string_view text);
    std::string toString() const;
    auto operator<=>(const Endpoint&) const = default;
};

/// "127.0.0.1" without a port.
std::optional<std::uint32_t> parseAddress(std::string_view text);

}  // namespace axon::datagrams
