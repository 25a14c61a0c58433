// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/service_manager.hpp"

#include <spdlog/spdlog.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <cerrno>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <string_view>

#include "common/descriptor.hpp"

namespace axon::transport {
namespace {

/// Whether it was sent; if not, errno says why.
bool send(std::string_view message, std::string_view socket) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    if (socket.size() >= sizeof address.sun_path) return errno = ENAMETOOLONG, false;
    std::memcpy(address.sun_path, socket.data(), socket.size());
    if (socket.front() == '@') address.sun_path[0] = '\0';  // a name of Linux's abstract namespace
    const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + socket.size());
    const Descriptor from(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    if (from.get() < 0) return false;
    return ::sendto(from.get(), message.data(), message.size(), MSG_NOSIGNAL,
                    reinterpret_cast<const sockaddr*>(&address), size) >= 0;
}

}  // namespace

void tellServiceManagerReady() {
    const char* socket = std::getenv("NOTIFY_SOCKET");
    if (socket == nullptr || *socket == '\0') return;
    if (!send("READY=1", socket))
        spdlog::warn(
            "the service manager at '{}' (NOTIFY_SOCKET) was not told that this program is ready: {}; fix: "
            "Type=exec in the systemd unit",
            socket, std::strerror(errno));
}

}  // namespace axon::transport
