// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/lane_socket.hpp"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/uio.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <memory>
#include <system_error>

namespace axon::direct::lane {
namespace {

constexpr std::size_t kPiecesMax = 128;
// Signs of life on the signal lane do not show that this connection still carries anything.
constexpr int kIdleS = 15;  // then the kernel asks whether the other end is there
constexpr int kProbesS = 5;
constexpr int kProbes = 3;
constexpr int kUnreadMs = 30'000;  // bytes that the other end's kernel has not taken

bool later(int error) {
    return error == EAGAIN || error == EWOULDBLOCK || error == EINTR;
}

}  // namespace

void prepare(int socket) {
    const auto set = [socket](int level, int option, int value) {
        ::setsockopt(socket, level, option, &value, sizeof value);
    };
    set(IPPROTO_TCP, TCP_NODELAY, 1);
    set(SOL_SOCKET, SO_KEEPALIVE, 1);
    set(IPPROTO_TCP, TCP_KEEPIDLE, kIdleS);
    set(IPPROTO_TCP, TCP_KEEPINTVL, kProbesS);
    set(IPPROTO_TCP, TCP_KEEPCNT, kProbes);
    set(IPPROTO_TCP, TCP_USER_TIMEOUT, kUnreadMs);
}

LaneSocket::LaneSocket(Descriptor socket) : socket_(std::move(socket)) {
    prepare(socket_.get());
}

Result<Descriptor> LaneSocket::connectTo(const std::string& endpoint) {
    const auto colon = endpoint.rfind(':');
    auto host = endpoint.substr(0, colon == std::string::npos ? 0 : colon);
    if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
    const auto port = colon == std::string::npos ? std::string() : endpoint.substr(colon + 1);
    addrinfo hints{};
    hints.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV;  // nothing is looked up, which would wait
    hints.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    std::uint16_t number = 0;  // getaddrinfo() takes others, too
    const auto [rest, wrong] = std::from_chars(port.data(), port.data() + port.size(), number);
    if (host.empty() || wrong != std::errc{} || rest != port.data() + port.size() ||
        ::getaddrinfo(host.c_str(), port.c_str(), &hints, &found) != 0)
        return Refusal{
            RefusalCode::Malformed, "'" + endpoint + "' is no address of four numbers and a port", {}};
    const std::unique_ptr<addrinfo, void (*)(addrinfo*)> at(found, ::freeaddrinfo);
    Descriptor socket(::socket(at->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    if (socket.open() && (::connect(socket.get(), at->ai_addr, at->ai_addrlen) == 0 || errno == EINPROGRESS))
        return socket;
    return Refusal{RefusalCode::NotConnected, endpoint + ": " + std::generic_category().message(errno), {}};
}

std::optional<std::size_t> writeTo(int socket, std::span<const std::string_view> pieces) {
    std::array<iovec, kPiecesMax> parts;
    std::size_t count = 0;
    for (const auto piece : pieces) {
        if (piece.empty()) continue;
        if (count == parts.size()) break;
        parts[count++] = {const_cast<char*>(piece.data()), piece.size()};
    }
    msghdr message{};
    message.msg_iov = parts.data();
    message.msg_iovlen = count;
    const auto sent = ::sendmsg(socket, &message, MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent >= 0) return static_cast<std::size_t>(sent);
    if (later(errno)) return 0;
    return std::nullopt;
}

LaneSocket::Read LaneSocket::read(std::span<char> room) {
    const auto came = ::recv(socket_.get(), room.data(), room.size(), MSG_DONTWAIT);
    Read read;
    if (came > 0) {
        read.bytes = static_cast<std::size_t>(came);
        read.more = read.bytes == room.size();
    } else if (came == 0) {
        read.end = Read::End::Closed;
    } else if (errno == EINTR) {
        read.more = true;
    } else if (!later(errno)) {
        read.end = Read::End::Lost;
        read.error = errno;
    }
    return read;
}

void LaneSocket::shut() {
    ::shutdown(socket_.get(), SHUT_RDWR);
}

}  // namespace axon::direct::lane
