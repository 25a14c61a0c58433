// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/sockets.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <termios.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <system_error>

namespace axon::lab {

void failWithErrno(const std::string& what) {
    throw std::system_error(errno, std::generic_category(), what);
}

Descriptor listenOn(const std::string& address, int port) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(port));
    if (::inet_pton(AF_INET, address.c_str(), &to.sin_addr) != 1) {
        errno = EINVAL;
        failWithErrno(fmt::format("--listen {}: expected an IPv4 address such as 127.0.0.1", address));
    }
    Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    if (!socket.open()) failWithErrno("socket");
    const int one = 1;
    ::setsockopt(socket.get(), SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    if (::bind(socket.get(), reinterpret_cast<sockaddr*>(&to), sizeof to) != 0 ||
        ::listen(socket.get(), 16) != 0) {
        failWithErrno(
            fmt::format("cannot listen on {}:{}; another laboratory may be running; fix: choose another "
                        "--port, or 0 for a free one",
                        address, port));
    }
    return socket;
}

int portOf(const Descriptor& socket) {
    sockaddr_in bound{};
    socklen_t size = sizeof bound;
    if (::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&bound), &size) != 0)
        failWithErrno("getsockname");
    return ntohs(bound.sin_port);
}

Descriptor acceptFrom(const Descriptor& listener) {
    Descriptor client(::accept4(listener.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (client.open()) {
        const int one = 1;
        ::setsockopt(client.get(), IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    }
    return client;
}

Terminal openTerminal() {
    Terminal terminal;
    terminal.master = Descriptor(::posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
    if (!terminal.master.open() || ::grantpt(terminal.master.get()) != 0 ||
        ::unlockpt(terminal.master.get()) != 0)
        failWithErrno("--pty: the system gives no pseudo-terminal");
    std::array<char, 128> path{};
    if (::ptsname_r(terminal.master.get(), path.data(), path.size()) != 0) failWithErrno("--pty");
    terminal.path = path.data();
    terminal.slave = Descriptor(::open(path.data(), O_RDWR | O_NOCTTY | O_CLOEXEC));
    termios settings{};
    if (!terminal.slave.open() || ::tcgetattr(terminal.slave.get(), &settings) != 0)
        failWithErrno("--pty " + terminal.path);
    ::cfmakeraw(&settings);
    ::tcsetattr(terminal.slave.get(), TCSANOW, &settings);
    return terminal;
}

int speedOf(const Terminal& terminal) {
    termios settings{};
    if (::tcgetattr(terminal.slave.get(), &settings) != 0) return 0;
    switch (::cfgetospeed(&settings)) {
        case B9600:
            return 9600;
        case B19200:
            return 19200;
        case B38400:
            return 38400;
        case B57600:
            return 57600;
        case B115200:
            return 115200;
        default:
            return 0;
    }
}

}  // namespace axon::lab
