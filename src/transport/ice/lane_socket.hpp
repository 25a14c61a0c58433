// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

namespace axon::transport {

/// The descriptor of the socket under a TCP connection of Ice, which does not give it away: the one of this
/// process whose two addresses are the connection's. -1 if there is none (it was closed, or is not TCP).
int socketOf(const Ice::Connection& connection);

/// Sets the signal lane's socket options (datagrams/signal_socket.hpp) on this connection, once, at its
/// set-up. An option that the kernel does not have is logged once and left out. False when the socket was
/// not found. Any thread.
bool prepareSignalLane(const Ice::Connection& connection);

}  // namespace axon::transport
