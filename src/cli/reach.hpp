// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <sys/socket.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

// Whether a TCP port can be reached, for axon doctor.
namespace axon::cli {

enum class Reach {
    Open,         ///< somebody listens
    Refused,      ///< the machine is there, and nobody listens at that port
    Silent,       ///< no answer: a firewall drops it, or the machine is off
    Unreachable,  ///< the network says that there is no way
    UnknownHost,  ///< no such name
    NoResolver,   ///< whether there is such a name cannot be known: the name service (DNS) does not answer
};

/// The addresses of a name, or why there are none: UnknownHost or NoResolver.
struct Addresses {
    struct Address {
        sockaddr_storage storage{};
        socklen_t size = 0;
    };
    std::vector<Address> list;
    Reach otherwise = Reach::UnknownHost;
};
/// Asks the system. Blocks as long as that needs.
Addresses addressesOf(const std::string& host, std::uint16_t port);
/// What an error of getaddrinfo means.
Reach meaningOf(int resolver_error);

/// Whether a connection that is being made is made, or refused, within this time.
bool answersWithin(int fd, std::chrono::milliseconds patience);

/// What reach() asks for; tests put their own in its place.
struct Network {
    std::function<Addresses(const std::string& host, std::uint16_t port)> addresses = addressesOf;
    std::function<bool(int fd, std::chrono::milliseconds patience)> answers = answersWithin;
};

/// Tries a connection to one address after the other and closes it. Blocks for `patience` at most for each
/// address, and as long as the resolver needs for a name.
Reach reach(const std::string& host, std::uint16_t port, std::chrono::milliseconds patience,
            const Network& network = {});

/// "HOST:PORT", with or without "ssl://"; nothing for another form, such as a router's proxy.
struct HostPort {
    std::string host;
    std::uint16_t port = 0;
};
std::optional<HostPort> hostPortOf(const std::string& server);

/// Whether a program of this machine listens at that port of loopback, or of all addresses.
bool isTaken(std::uint16_t port);

}  // namespace axon::cli
