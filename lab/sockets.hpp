// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <unistd.h>

#include <string>
#include <utility>

namespace axon::lab {

/// Owns a file descriptor; -1 is none.
class Descriptor {
  public:
    explicit Descriptor(int fd = -1) : fd_(fd) {}
    ~Descriptor() { reset(); }
    Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
    Descriptor& operator=(Descriptor&& other) noexcept {
        std::swap(fd_, other.fd_);
        return *this;
    }
    int get() const { return fd_; }
    explicit operator bool() const { return fd_ >= 0; }
    void reset() {
        if (fd_ >= 0) ::close(fd_);
        fd_ = -1;
    }

  private:
    int fd_;
};

/// All of these: non-blocking, and std::system_error in terms of the program's options.
Descriptor listenOn(const std::string& address, int port);
/// Of a listening socket.
int portOf(const Descriptor& socket);
/// Whoever connected, without delay of small packets; none if nobody did.
Descriptor acceptFrom(const Descriptor& listener);

/// A pseudo-terminal in raw mode: bytes written to the path arrive at the descriptor. The other side is kept
/// open, so that it survives its clients.
struct Terminal {
    Descriptor master;
    Descriptor slave;
    std::string path;
};
Terminal openTerminal();
/// The speed in baud that a client has set on it; 0 for one that no serial line has.
int speedOf(const Terminal& terminal);

[[noreturn]] void failWithErrno(const std::string& what);

}  // namespace axon::lab
