// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "common/clock.hpp"
#include "transport/connection_limits_core.hpp"
#include "transport/timer_thread.hpp"

namespace axon::transport {

/// Closes connections to ports of this process that exceed ConnectionBounds, on a thread of its own that
/// looks at the process's descriptors: ten times a second while anybody is there who has no session, else
/// once. Ice then ends the connection as it ends one that was lost. The ports' adapters have no ACM
/// (listen()): Ice remembers each connection that has ended for up to a minute for it, and a flood of them
/// costs as much memory as if they were open.
///
/// Where in the flow: beside the adapters; messages never come here. Threads: any.
class ConnectionLimits {
  public:
    /// Whether the peer at this address and port ("127.0.0.1:50122") has a session over this connection.
    /// Called on this object's thread.
    using HasSession = std::function<bool(const std::string& peer)>;
    using Note = std::function<void(const std::string& line)>;

    ConnectionLimits(const Clock& clock, Note note, ConnectionBounds bounds = {});

    /// From now on the connections to these ports (portsOf()), until unwatch(): has_session is not called
    /// after that.
    void watch(const std::vector<std::uint16_t>& ports, const HasSession& has_session);
    void unwatch(const std::vector<std::uint16_t>& ports);

  private:
    struct Connection {
        std::uint16_t port = 0;  // of this process
        std::string peer, address;
    };
    struct Open {
        int fd;
        std::uint64_t id;
    };
    TimePoint look();
    static std::vector<Open> openSockets();
    static Connection endsOf(int fd);

    const Clock& clock_;
    const Note note_;
    // Of the thread alone:
    ConnectionLimitsCore core_;
    std::unordered_map<std::uint64_t, Connection> connections_;
    TimePoint silence_due_{};

    std::mutex mutex_;
    std::map<std::uint16_t, HasSession> watched_;  // guarded by mutex_

    TimerThread thread_;  // last: it uses the others
};

}  // namespace axon::transport
