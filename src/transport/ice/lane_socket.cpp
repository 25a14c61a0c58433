// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/lane_socket.hpp"

#include <arpa/inet.h>
#include <dirent.h>
#include <netinet/in.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <memory>
#include <optional>

#include "common/descriptor.hpp"
#include "datagrams/signal_socket.hpp"
#include "transport/ice/ip_layer.hpp"

namespace axon::transport {
namespace {

constexpr int kLooksBelow = 64;  // descriptors, before the whole table is read

std::optional<sockaddr_in> addressOf(const std::string& host, int port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    if (::inet_pton(AF_INET, host.c_str(), &address.sin_addr) != 1) return std::nullopt;
    return address;
}

template <class Ask>
bool answers(Ask ask, int fd, const sockaddr_in& expected) {
    sockaddr_in found{};
    socklen_t size = sizeof found;
    return ask(fd, reinterpret_cast<sockaddr*>(&found), &size) == 0 && size == sizeof found &&
           found.sin_family == AF_INET && found.sin_port == expected.sin_port &&
           found.sin_addr.s_addr == expected.sin_addr.s_addr;
}

bool isBetween(int fd, const sockaddr_in& local, const sockaddr_in& remote) {
    int type = 0;
    socklen_t size = sizeof type;
    return answers(::getsockname, fd, local) && answers(::getpeername, fd, remote) &&
           ::getsockopt(fd, SOL_SOCKET, SO_TYPE, &type, &size) == 0 && type == SOCK_STREAM;
}

void sayOnce(const std::vector<std::string>& missing) {
    static std::atomic_flag said;
    if (missing.empty() || said.test_and_set()) return;
    std::string names;
    for (const auto& name : missing) names += (names.empty() ? "" : ", ") + name;
    // The client library has a logger of its own; standard output is its program's.
    const auto logger = spdlog::get("axon");
    (logger ? logger : spdlog::default_logger())
        ->info(
            "signal lane: this kernel does not have {}, so stops are slower where packets are lost; fix: "
            "Linux 6.18 has all of them",
            names);
}

}  // namespace

int socketOf(const Ice::Connection& connection) {
    const auto ip = ipOf(connection);
    if (!ip) return -1;
    const auto local = addressOf(ip->localAddress, ip->localPort);
    const auto remote = addressOf(ip->remoteAddress, ip->remotePort);
    if (!local || !remote) return -1;

    // A new descriptor has the lowest free number, so a young connection is mostly just below the next one.
    const int next = Descriptor(::eventfd(0, EFD_CLOEXEC)).get();  // and it is free again
    for (int fd = next - 1; fd >= 0 && fd >= next - kLooksBelow; --fd)
        if (isBetween(fd, *local, *remote)) return fd;

    const std::unique_ptr<DIR, int (*)(DIR*)> table(::opendir("/proc/self/fd"), ::closedir);
    if (!table) return -1;
    while (const auto* entry = ::readdir(table.get())) {
        char* end = nullptr;
        const long fd = std::strtol(entry->d_name, &end, 10);
        if (end != entry->d_name && *end == '\0' && isBetween(static_cast<int>(fd), *local, *remote))
            return static_cast<int>(fd);
    }
    return -1;
}

bool prepareSignalLane(const Ice::Connection& connection) {
    const int fd = socketOf(connection);
    if (fd < 0) return false;
    sayOnce(datagrams::prepareSignalSocket(fd));
    return true;
}

}  // namespace axon::transport
