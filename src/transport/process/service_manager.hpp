// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once

namespace axon::transport {

/// Tells the service manager that this process is ready, if it was started by one that asks for that:
/// systemd, by a unit with Type=notify, which names its socket in the environment variable NOTIFY_SOCKET.
/// `systemctl start` returns then. Without the variable nothing happens.
///
/// For the mains of daemons. Does not block for longer than it takes the service manager to read. A socket
/// that cannot be reached is logged as a warning, and the program goes on.
void tellServiceManagerReady();

}  // namespace axon::transport
