// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <dirent.h>

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "common/clock.hpp"
#include "common/descriptor.hpp"
#include "transport/ice/connection_limits_core.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/timer_thread.hpp"

namespace axon::transport {

/// Closes connections to endpoints of this process that exceed ConnectionBounds, on a thread of its own that
/// looks at the process's descriptors: ten times a second while anybody is there who has no session, else
/// once. Ice then ends the connection as one that was lost. The adapters that are watched have an ACM that
/// looks twice a second (listen()): Ice remembers each connection that has ended until then, and for a minute
/// a flood of them would cost as much memory as if they were open.
///
/// Where in the flow: beside the adapters; messages never come here. Threads: any. Failure: where the
/// descriptors cannot be read nothing is closed, and the log says so once. It has three descriptors of its
/// own, so that it works when there are none left.
class ConnectionLimits {
  public:
    using Peer = ConnectionLimitsCore::Peer;
    using Note = std::function<void(const std::string& line)>;
    /// Who has connected to these endpoints, by both ends of each connection (bothEnds()); called on this
    /// object's thread.
    struct Sessions {
        std::function<Peer(const std::string& ends)> state;
        /// Nothing has come from a peer that has a session; it is to be ended. Null: its connection is simply
        /// closed.
        std::function<void(const std::string& ends)> end_silent = nullptr;
    };

    /// The bounds are made to fit into the number of descriptors that this process may have
    /// (raiseDescriptorLimit() before).
    ConnectionLimits(const Clock& clock, Note note, const ConnectionBounds& bounds = {});
    ~ConnectionLimits();

    /// These endpoints are watched as long as what is returned lives, whose end waits while `sessions` are
    /// asked. This object outlives it. An endpoint with an empty host, or a name, is that port of every
    /// address that nobody else watches.
    [[nodiscard]] std::shared_ptr<void> watch(std::vector<Endpoint> endpoints, Sessions sessions);
    /// The process ends: nobody who is silent is to hold that up. From now on each connection is closed at
    /// the next look, but those of sessions one second later.
    void close();

  private:
    struct Ends {
        Endpoint local;       // port 0 where it is no connection of TCP, or its other end has gone
        std::string both;     // bothEnds()
        std::string address;  // of the peer, "127.0.0.1"
    };
    struct Open {
        int fd;
        std::uint64_t id;
    };
    struct Watched {
        std::vector<Endpoint> endpoints;
        Sessions sessions;
    };
    TimePoint look();
    bool readDescriptors(std::vector<Open>& open);
    static Ends endsOf(int fd);
    const Watched* watcherOf(const Ends& ends) const;
    void shutDown(const Open& connection);

    const Clock& clock_;
    const Note note_;
    const std::unique_ptr<DIR, int (*)(DIR*)> table_;
    // Of the thread alone:
    ConnectionLimitsCore core_;
    Descriptor null_,
        spare_;  // the spare one becomes the copy of a connection, and then again one of nothing
    std::unordered_map<std::uint64_t, Ends> ends_;
    TimePoint silence_due_{};
    bool unreadable_told_ = false;

    std::mutex mutex_;
    std::map<std::uint64_t, Watched> watched_;  // guarded by mutex_
    std::uint64_t watches_ = 0;                 // guarded by mutex_
    TimePoint closed_at_ = TimePoint::max();    // guarded by mutex_

    TimerThread thread_;  // last: it uses the others
};

}  // namespace axon::transport
