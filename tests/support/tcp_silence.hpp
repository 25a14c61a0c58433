// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <dirent.h>
#include <linux/filter.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <arpa/inet.h>
#include <array>
#include <chrono>
#include <cstdlib>
#include <string>

// Connections of the test's own process that fall silent without an end, as behind a firewall that has
// forgotten them.
namespace axon::test {

/// "a.b.c.d:port" of an end of a connection; empty where there is none.
inline std::string endpointOf(int socket, decltype(&::getpeername) end) {
    sockaddr_in address{};
    socklen_t size = sizeof address;
    if (end(socket, reinterpret_cast<sockaddr*>(&address), &size) != 0 || address.sin_family != AF_INET)
        return {};
    std::array<char, INET_ADDRSTRLEN> host{};
    ::inet_ntop(AF_INET, &address.sin_addr, host.data(), host.size());
    return std::string(host.data()) + ":" + std::to_string(ntohs(address.sin_port));
}

/// The socket of this process with these two ends, of which one may be empty; -1: none. It stays its owner's.
inline int socketBetween(const std::string& here, const std::string& there) {
    int found = -1;
    DIR* const folder = ::opendir("/proc/self/fd");
    if (folder == nullptr) return found;
    while (const dirent* entry = ::readdir(folder)) {
        const int fd = std::atoi(entry->d_name);
        const auto peer = endpointOf(fd, ::getpeername);
        if (!peer.empty() && (there.empty() || peer == there) &&
            (here.empty() || endpointOf(fd, ::getsockname) == here))
            found = fd;
    }
    ::closedir(folder);
    return found;
}

/// Nothing that comes for this socket is taken from now on, not even what acknowledges its own bytes.
inline bool deafen(int socket) {
    sock_filter nothing = BPF_STMT(BPF_RET | BPF_K, 0);
    const sock_fprog program{1, &nothing};
    return ::setsockopt(socket, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof program) == 0;
}

/// Instead of the product's time for bytes that nobody takes.
inline bool losePatienceAfter(int socket, std::chrono::milliseconds time) {
    const auto value = static_cast<unsigned>(time.count());
    return ::setsockopt(socket, IPPROTO_TCP, TCP_USER_TIMEOUT, &value, sizeof value) == 0;
}

}  // namespace axon::test
