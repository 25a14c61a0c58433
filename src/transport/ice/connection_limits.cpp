// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/connection_limits.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <optional>
#include <utility>

#include "transport/ice/known_connections.hpp"

namespace axon::transport {
namespace {

constexpr std::chrono::milliseconds kLookSoon{100};
constexpr std::chrono::seconds kLook{1};
constexpr std::chrono::seconds kLookForSilence{5};
constexpr std::chrono::seconds kSessionsLast{1};  // longer than strangers, at the end

template <class Value>
std::optional<Value> option(int fd, int level, int name) {
    Value value{};
    socklen_t size = sizeof value;
    if (::getsockopt(fd, level, name, &value, &size) != 0) return std::nullopt;
    return value;
}

/// A number that no other socket of this machine has or will have; nothing where the descriptor is no socket.
std::optional<std::uint64_t> cookieOf(int fd) {
    return option<std::uint64_t>(fd, SOL_SOCKET, SO_COOKIE);
}

/// As Ice writes it.
std::optional<std::pair<std::string, std::uint16_t>> endOf(int fd, int (*ask)(int, sockaddr*, socklen_t*)) {
    sockaddr_storage found{};
    socklen_t size = sizeof found;
    auto* address = reinterpret_cast<sockaddr*>(&found);
    char host[NI_MAXHOST], port[NI_MAXSERV];
    if (ask(fd, address, &size) != 0 || (found.ss_family != AF_INET && found.ss_family != AF_INET6) ||
        ::getnameinfo(address, size, host, sizeof host, port, sizeof port, NI_NUMERICHOST | NI_NUMERICSERV) !=
            0)
        return std::nullopt;
    return std::pair(std::string(host), static_cast<std::uint16_t>(std::atoi(port)));
}

Duration silenceOf(int fd) {
    const auto info = option<tcp_info>(fd, IPPROTO_TCP, TCP_INFO);
    return info ? Duration(std::chrono::milliseconds{info->tcpi_last_data_recv}) : Duration{};
}

bool isNumeric(const std::string& host) {
    in6_addr any{};
    return ::inet_pton(AF_INET, host.c_str(), &any) == 1 || ::inet_pton(AF_INET6, host.c_str(), &any) == 1;
}

std::size_t descriptorsAllowed() {
    rlimit limit{};
    return ::getrlimit(RLIMIT_NOFILE, &limit) == 0 ? limit.rlim_cur : 1024;
}

}  // namespace

ConnectionLimits::ConnectionLimits(const Clock& clock, Note note, const ConnectionBounds& bounds)
    : clock_(clock),
      note_(std::move(note)),
      table_(::opendir("/proc/self/fd"), ::closedir),
      core_(bounds.fittingInto(descriptorsAllowed())),
      null_(::open("/dev/null", O_RDONLY | O_CLOEXEC)),
      spare_(::open("/dev/null", O_RDONLY | O_CLOEXEC)),
      thread_("axon-limits", Lane::Data, kLookSoon, clock, [this] { return look(); }) {}

ConnectionLimits::~ConnectionLimits() = default;

std::shared_ptr<void> ConnectionLimits::watch(std::vector<Endpoint> endpoints, Sessions sessions) {
    const std::lock_guard lock(mutex_);
    const auto number = ++watches_;
    watched_.emplace(number, Watched{std::move(endpoints), std::move(sessions)});
    return {nullptr, [this, number](void*) {
                const std::lock_guard its_lock(mutex_);
                watched_.erase(number);
            }};
}

void ConnectionLimits::close() {
    {
        const std::lock_guard lock(mutex_);
        closed_at_ = clock_.now();
    }
    thread_.wake();
}

bool ConnectionLimits::readDescriptors(std::vector<Open>& open) {
    if (!table_) return false;
    ::rewinddir(table_.get());
    while (const auto* entry = ::readdir(table_.get())) {
        char* end = nullptr;
        const auto fd = static_cast<int>(std::strtol(entry->d_name, &end, 10));
        if (end == entry->d_name || *end != '\0') continue;
        if (const auto cookie = cookieOf(fd)) open.push_back({fd, *cookie});
    }
    return true;
}

ConnectionLimits::Ends ConnectionLimits::endsOf(int fd) {
    if (option<int>(fd, SOL_SOCKET, SO_PROTOCOL) != IPPROTO_TCP) return {};
    const auto local = endOf(fd, ::getsockname);
    const auto remote = endOf(fd, ::getpeername);
    if (!local || !remote) return {};
    const auto told = [](const auto& end) { return end.first + ":" + std::to_string(end.second); };
    return {{local->first, local->second}, bothEnds(told(*remote), told(*local)), remote->first};
}

/// Under mutex_.
const ConnectionLimits::Watched* ConnectionLimits::watcherOf(const Ends& ends) const {
    const Watched* of_port = nullptr;
    for (const auto& [number, its] : watched_) {
        for (const auto& endpoint : its.endpoints) {
            if (endpoint.port != ends.local.port) continue;
            if (endpoint.host == ends.local.host) return &its;
            if (!isNumeric(endpoint.host)) of_port = &its;
        }
    }
    return of_port;
}

void ConnectionLimits::shutDown(const Open& connection) {
    // Ice may have closed it meanwhile, and the descriptor be another's: the copy stays what it is found to
    // be.
    if (!spare_.open() || ::dup3(connection.fd, spare_.get(), O_CLOEXEC) < 0) return;
    if (cookieOf(spare_.get()) == connection.id) ::shutdown(spare_.get(), SHUT_RDWR);
    ::dup3(null_.get(), spare_.get(), O_CLOEXEC);
}

TimePoint ConnectionLimits::look() {
    const auto now = clock_.now();
    {
        const std::lock_guard lock(mutex_);
        if (watched_.empty()) return now + kLook;
    }
    std::vector<Open> open;
    if (!readDescriptors(open)) {
        if (!std::exchange(unreadable_told_, true))
            note_(
                "connections are not bounded: /proc/self/fd cannot be read; fix: mount /proc where this "
                "program runs");
        return now + kLook;
    }
    std::unordered_map<std::uint64_t, Ends> still;
    for (const auto& [fd, id] : open) {
        const auto known = ends_.find(id);
        still.emplace(id, known != ends_.end() ? std::move(known->second) : endsOf(fd));
    }
    ends_ = std::move(still);
    const bool for_silence = now >= silence_due_;
    if (for_silence) silence_due_ = now + kLookForSilence;

    std::vector<ConnectionLimitsCore::Seen> seen;
    std::unordered_map<std::uint64_t, Open> watched;
    bool closing = false, all = false;
    {
        const std::lock_guard lock(mutex_);
        closing = now >= closed_at_;
        all = closing && now >= closed_at_ + kSessionsLast;
        for (const auto& one : open) {
            const auto& ends = ends_.at(one.id);
            const auto* watcher = ends.local.port == 0 ? nullptr : watcherOf(ends);
            if (watcher == nullptr) continue;
            seen.push_back({one.id, ends.address, watcher->sessions.state(ends.both)});
            watched.emplace(one.id, one);
        }
    }
    if (closing) {
        for (const auto& one : seen)
            if (all || one.peer == Peer::Stranger) shutDown(watched.at(one.id));
        return now + kLookSoon;
    }
    if (for_silence)
        for (auto& one : seen)
            if (one.peer == Peer::HasSession) one.silent_for = silenceOf(watched.at(one.id).fd);

    const auto verdict = core_.look(seen, now, [&](std::uint64_t id) {
        const std::lock_guard lock(mutex_);
        const auto& ends = ends_.at(id);
        const auto* watcher = watcherOf(ends);
        if (watcher == nullptr || watcher->sessions.state(ends.both) != Peer::Stranger) return false;
        shutDown(watched.at(id));
        return true;
    });
    {
        const std::lock_guard lock(mutex_);
        for (const auto id : verdict.silent) {
            const auto& ends = ends_.at(id);
            const auto* watcher = watcherOf(ends);
            if (watcher == nullptr) continue;
            if (watcher->sessions.end_silent) {
                watcher->sessions.end_silent(ends.both);
            } else {
                shutDown(watched.at(id));
            }
        }
    }
    for (const auto& note : verdict.notes) note_(note);
    return now + (verdict.strangers ? Duration(kLookSoon) : Duration(kLook));
}

}  // namespace axon::transport
