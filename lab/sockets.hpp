// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "common/descriptor.hpp"

namespace axon::lab {

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
