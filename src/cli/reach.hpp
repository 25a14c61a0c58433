// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

// Whether a TCP port can be reached, for axon doctor.
namespace axon::cli {

enum class Reach {
    Open,         ///< somebody listens
    Refused,      ///< the machine is there, and nobody listens at that port
    Silent,       ///< no answer: a firewall drops it, or the machine is off
    Unreachable,  ///< the network says that there is no way
    UnknownHost,  ///< no such name
};

/// Tries a connection and closes it. Blocks for `patience` at most, and as long as the resolver needs for a
/// name.
Reach reach(const std::string& host, std::uint16_t port, std::chrono::milliseconds patience);

/// "HOST:PORT", with or without "ssl://"; nothing for another form, such as a router's proxy.
struct HostPort {
    std::string host;
    std::uint16_t port = 0;
};
std::optional<HostPort> hostPortOf(const std::string& server);

/// Whether a program of this machine listens at that port of loopback, or of all addresses.
bool isTaken(std::uint16_t port);

}  // namespace axon::cli
