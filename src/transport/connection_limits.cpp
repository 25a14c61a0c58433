// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/connection_limits.hpp"

#include <arpa/inet.h>
#include <dirent.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

#include <cstdlib>
#include <memory>
#include <optional>
#include <utility>

#include "common/descriptor.hpp"

namespace axon::transport {
namespace {

constexpr std::chrono::milliseconds kLookSoon{100};
constexpr std::chrono::seconds kLook{1};
constexpr std::chrono::seconds kLookForSilence{5};

/// A number that no other socket of this machine has or will have; nothing where the descriptor is no socket.
std::optional<std::uint64_t> cookieOf(int fd) {
    std::uint64_t cookie = 0;
    socklen_t size = sizeof cookie;
    if (::getsockopt(fd, SOL_SOCKET, SO_COOKIE, &cookie, &size) != 0) return std::nullopt;
    return cookie;
}

std::optional<sockaddr_in> endOf(int fd, int (*ask)(int, sockaddr*, socklen_t*)) {
    sockaddr_in found{};
    socklen_t size = sizeof found;
    if (ask(fd, reinterpret_cast<sockaddr*>(&found), &size) != 0 || size != sizeof found ||
        found.sin_family != AF_INET)
        return std::nullopt;
    return found;
}

Duration silenceOf(int fd) {
    tcp_info info{};
    socklen_t size = sizeof info;
    if (::getsockopt(fd, IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return {};
    return std::chrono::milliseconds{info.tcpi_last_data_recv};
}

}  // namespace

ConnectionLimits::ConnectionLimits(const Clock& clock, Note note, ConnectionBounds bounds)
    : clock_(clock),
      note_(std::move(note)),
      core_(bounds),
      thread_("axon-limits", Lane::Data, kLookSoon, clock, [this] { return look(); }) {}

void ConnectionLimits::watch(const std::vector<std::uint16_t>& ports, const HasSession& has_session) {
    const std::lock_guard lock(mutex_);
    for (const auto port : ports) watched_[port] = has_session;
}

void ConnectionLimits::unwatch(const std::vector<std::uint16_t>& ports) {
    const std::lock_guard lock(mutex_);
    for (const auto port : ports) watched_.erase(port);
}

std::vector<ConnectionLimits::Open> ConnectionLimits::openSockets() {
    std::vector<Open> open;
    const std::unique_ptr<DIR, int (*)(DIR*)> table(::opendir("/proc/self/fd"), ::closedir);
    if (!table) return open;
    while (const auto* entry = ::readdir(table.get())) {
        char* end_of_number = nullptr;
        const auto fd = static_cast<int>(std::strtol(entry->d_name, &end_of_number, 10));
        if (end_of_number == entry->d_name || *end_of_number != '\0') continue;
        if (const auto cookie = cookieOf(fd)) open.push_back({fd, *cookie});
    }
    return open;
}

/// Port 0 where it is no connection of TCP: it listens, or its other end has gone already.
ConnectionLimits::Connection ConnectionLimits::endsOf(int fd) {
    const auto local = endOf(fd, ::getsockname);
    const auto remote = endOf(fd, ::getpeername);
    if (!local || !remote) return {};
    char address[INET_ADDRSTRLEN] = {};
    ::inet_ntop(AF_INET, &remote->sin_addr, address, sizeof address);
    return {ntohs(local->sin_port), std::string(address) + ":" + std::to_string(ntohs(remote->sin_port)),
            address};
}

TimePoint ConnectionLimits::look() {
    const auto now = clock_.now();
    const bool for_silence = now >= silence_due_;
    if (for_silence) silence_due_ = now + kLookForSilence;
    const auto open = openSockets();

    std::vector<ConnectionLimitsCore::Seen> seen;
    std::unordered_map<std::uint64_t, int> descriptors;
    {
        const std::lock_guard lock(mutex_);
        std::unordered_map<std::uint64_t, Connection> still;
        for (const auto& [fd, id] : open) {
            const auto known = connections_.find(id);
            const auto& one =
                still.emplace(id, known != connections_.end() ? std::move(known->second) : endsOf(fd))
                    .first->second;
            const auto watched = watched_.find(one.port);
            if (watched == watched_.end()) continue;
            const bool has_session = watched->second(one.peer);
            seen.push_back(
                {id, one.address, has_session, for_silence && has_session ? silenceOf(fd) : Duration{}});
            descriptors.emplace(id, fd);
        }
        connections_ = std::move(still);
    }

    const auto verdict = core_.look(seen, now);
    for (const auto id : verdict.close) {
        // Ice may have closed it meanwhile, and the descriptor be another's: the copy stays what it is found
        // to be.
        const Descriptor copy(::fcntl(descriptors.at(id), F_DUPFD_CLOEXEC, 0));
        if (copy.open() && cookieOf(copy.get()) == id) ::shutdown(copy.get(), SHUT_RDWR);
    }
    for (const auto& note : verdict.notes) note_(note);
    return now + (verdict.strangers ? Duration(kLookSoon) : Duration(kLook));
}

}  // namespace axon::transport
