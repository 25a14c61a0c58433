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
#include <memory>

#include "common/descriptor.hpp"

namespace axon::cli {

Reach reach(const std::string& host, std::uint16_t port, std::chrono::milliseconds patience) {
    addrinfo hints{};
    hints.ai_family = AF_UNSPEC;
    hints.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    if (::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found) != 0 || found == nullptr)
        return Reach::UnknownHost;
    const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> all(found, ::freeaddrinfo);
    const auto end = std::chrono::steady_clock::now() + patience;
    Reach answer = Reach::Unreachable;
    for (const auto* one = all.get(); one != nullptr; one = one->ai_next) {
        const Descriptor fd(::socket(one->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
        if (!fd.open()) continue;
        int error = ::connect(fd.get(), one->ai_addr, one->ai_addrlen) == 0 ? 0 : errno;
        if (error == EINPROGRESS) {
            const auto left =
                std::chrono::ceil<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
            pollfd watched{fd.get(), POLLOUT, 0};
            if (::poll(&watched, 1, static_cast<int>(std::max<std::int64_t>(0, left.count()))) <= 0) {
                answer = Reach::Silent;
                continue;
            }
            socklen_t size = sizeof error;
            ::getsockopt(fd.get(), SOL_SOCKET, SO_ERROR, &error, &size);
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
