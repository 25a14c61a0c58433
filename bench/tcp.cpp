// SPDX-License-Identifier: GPL-2.0-or-later
#include "tcp.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <system_error>

namespace axon::bench::tcp {

namespace {

[[noreturn]] void fail(const char* what) {
    throw std::system_error(errno, std::generic_category(), what);
}

sockaddr_in loopback(std::uint16_t port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return address;
}

/// errno where it is not open.
Descriptor connectTo(std::uint16_t port) {
    Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    const auto address = loopback(port);
    if (socket.open() &&
        ::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
        const int error = errno;
        socket.reset();
        errno = error;
    }
    return socket;
}

}  // namespace

Connection::Connection(std::uint16_t port) : fd_(connectTo(port)) {
    if (!fd_.open()) fail("connect");
    prepare();
}
void Connection::prepare() const {
    const int on = 1;
    ::setsockopt(fd(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
}

void Connection::write(std::initializer_list<std::string_view> parts) const {
    std::array<iovec, 4> vectors{};
    std::size_t count = 0;
    for (const auto part : parts) vectors.at(count++) = {const_cast<char*>(part.data()), part.size()};
    std::size_t first = 0;
    while (first < count) {
        msghdr message{};
        message.msg_iov = &vectors[first];
        message.msg_iovlen = count - first;
        auto written = ::sendmsg(fd(), &message, MSG_NOSIGNAL);
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) fail("send");
        for (; first < count && static_cast<std::size_t>(written) >= vectors[first].iov_len; ++first)
            written -= static_cast<ssize_t>(vectors[first].iov_len);
        if (first < count) {
            vectors[first].iov_base = static_cast<char*>(vectors[first].iov_base) + written;
            vectors[first].iov_len -= static_cast<std::size_t>(written);
        }
    }
}

std::size_t Connection::read(char* to, std::size_t most, bool wait) const {
    for (;;) {
        const auto size = ::recv(fd(), to, most, wait ? 0 : MSG_DONTWAIT);
        if (size > 0) return static_cast<std::size_t>(size);
        if (size == 0) {
            errno = ECONNRESET;
            fail("the connection was closed");
        }
        if (errno == EAGAIN && !wait) return 0;
        if (errno != EINTR) fail("recv");
    }
}

void Connection::readAll(char* to, std::size_t size) const {
    for (std::size_t done = 0; done < size;) done += read(to + done, size - done, true);
}

bool listens(std::uint16_t port) {
    return connectTo(port).open();
}

Descriptor listen(std::uint16_t& port) {
    Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    auto address = loopback(0);
    socklen_t size = sizeof(address);
    if (!socket.open() || ::bind(socket.get(), reinterpret_cast<sockaddr*>(&address), size) != 0 ||
        ::listen(socket.get(), SOMAXCONN) != 0 ||
        ::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&address), &size) != 0)
        fail("listen");
    port = ntohs(address.sin_port);
    return socket;
}

void Inbox::take(const Connection& from, std::vector<char>& buffer, const Consume& consume) {
    // The rest goes before what is read: nothing else is copied.
    if (buffer.size() < 2 * rest_.size()) buffer.resize(2 * rest_.size());
    rest_.copy(buffer.data(), rest_.size());
    const auto size = from.read(buffer.data() + rest_.size(), buffer.size() - rest_.size(), false);
    if (size == 0) return;
    const std::string_view all(buffer.data(), rest_.size() + size);
    rest_.assign(all.substr(consume(all)));
}

}  // namespace axon::bench::tcp
