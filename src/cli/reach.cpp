// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/reach.hpp"

#include <arpa/inet.h>
#include <netdb.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <memory>

#include "common/descriptor.hpp"

namespace axon::cli {

Reach meaningOf(int resolver_error) {
    switch (resolver_error) {
        case EAI_AGAIN:
        case EAI_FAIL:
        case EAI_SYSTEM:
        case EAI_MEMORY:
            return Reach::NoResolver;
        default:
            return Reach::UnknownHost;
    }
}

Addresses addressesOf(const std::string& host, std::uint16_t port) {
    addrinfo hints{};
    hints.ai_family = AF_UNSPEC;
    hints.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    if (const int error = ::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found);
        error != 0)
        return {{}, meaningOf(error)};
    const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> all(found, ::freeaddrinfo);
    Addresses addresses;
    for (const auto* one = all.get(); one != nullptr; one = one->ai_next) {
        auto& address = addresses.list.emplace_back();
        address.size = std::min<socklen_t>(one->ai_addrlen, sizeof address.storage);
        std::memcpy(&address.storage, one->ai_addr, address.size);
    }
    return addresses;
}

bool answersWithin(int fd, std::chrono::milliseconds patience) {
    pollfd watched{fd, POLLOUT, 0};
    return ::poll(&watched, 1, static_cast<int>(patience.count())) > 0;
}

Reach reach(const std::string& host, std::uint16_t port, std::chrono::milliseconds patience,
            const Network& network) {
    const auto addresses = network.addresses(host, port);
    if (addresses.list.empty()) return addresses.otherwise;
    Reach answer = Reach::Unreachable;
    for (const auto& [storage, size] : addresses.list) {
        const Descriptor fd(::socket(storage.ss_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
        if (!fd.open()) continue;
        int error = ::connect(fd.get(), reinterpret_cast<const sockaddr*>(&storage), size) == 0 ? 0 : errno;
        if (error == EINPROGRESS) {
            if (!network.answers(fd.get(), patience)) {
                answer = Reach::Silent;
                continue;
            }
            socklen_t length = sizeof error;
            ::getsockopt(fd.get(), SOL_SOCKET, SO_ERROR, &error, &length);
        }
        if (error == 0) return Reach::Open;
        if (error == ECONNREFUSED) answer = Reach::Refused;
        if (error == ETIMEDOUT) answer = Reach::Silent;
    }
    return answer;
}

std::optional<HostPort> hostPortOf(const std::string& server) {
    if (server.find(' ') != std::string::npos) return std::nullopt;
    const auto scheme = server.find("://");
    const auto from = scheme == std::string::npos ? 0 : scheme + 3;
    const auto colon = server.rfind(':');
    if (colon == std::string::npos || colon <= from) return std::nullopt;
    HostPort place{server.substr(from, colon - from), 0};
    if (place.host.size() > 2 && place.host.front() == '[' && place.host.back() == ']')
        place.host = place.host.substr(1, place.host.size() - 2);
    const auto* last = server.data() + server.size();
    const auto [end, error] = std::from_chars(server.data() + colon + 1, last, place.port);
    if (error != std::errc{} || end != last || place.port == 0) return std::nullopt;
    return place;
}

bool isTaken(std::uint16_t port) {
    const Descriptor fd(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    const int on = 1;
    // A connection that has ended keeps nobody from listening.
    ::setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return fd.open() && ::bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 &&
           errno == EADDRINUSE;
}

}  // namespace axon::cli
