// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "common/clock.hpp"

namespace axon::transport {

/// What connections to a process's own ports may cost it. Ice bounds none of this.
struct ConnectionBounds {
    /// Without a session. This machine counts as one address.
    std::size_t strangers_of_one_address = 1024;
    std::size_t strangers = 4096;  ///< of all addresses
    Duration to_log_in = std::chrono::seconds{10};
    /// Of a session's connection, which its peer keeps alive by Ice's heartbeats.
    Duration silence = std::chrono::seconds{60};

    /// Bounds of at most a quarter of this many descriptors, so that the rest is left to sessions.
    ConnectionBounds fittingInto(std::size_t descriptors) const;
};

/// Decides which connections are closed: those that have had no session for too long, the oldest of those
/// without one where there are too many of an address (or in all: of the address that has most), and those of
/// sessions over which nothing has come for too long. No I/O but what `Close` does; not thread-safe. For
/// ConnectionLimits, and for the data port of direct paths.
class ConnectionLimitsCore {
  public:
    enum class Peer : std::uint8_t {
        Stranger,
        Exempt,  ///< its log-in is under way, which is bounded elsewhere, or it is a router
        HasSession
    };
    struct Seen {
        std::uint64_t id = 0;  ///< of the connection, never used again
        std::string address;   ///< of the peer, without its port
        Peer peer = Peer::Stranger;
        Duration silent_for{};
    };
    struct Verdict {
        std::vector<std::uint64_t> silent;  ///< of sessions
        std::vector<std::string>
            notes;               ///< for the log: at once, and then what has come together in ten seconds
        bool strangers = false;  ///< some are left: look again soon
    };

    explicit ConnectionLimitsCore(ConnectionBounds bounds) : bounds_(bounds) {}

    /// Closes the connection of a stranger. Called in look(), once at most for each connection, and must not
    /// call look(). False: the peer is no stranger any more; its connection stays open and is looked at
    /// again.
    using Close = std::function<bool(std::uint64_t id)>;
    /// `connections`: all connections. One that was closed, or is said to be silent, may still be among them
    /// in the next calls; it is not closed or reported again.
    Verdict look(const std::vector<Seen>& connections, TimePoint now, const Close& close);

  private:
    struct Known {
        TimePoint since;
        std::uint64_t number = 0;  // in the order of their coming
        bool closed = false;
        bool there = false;
    };
    void tell(Verdict& verdict, TimePoint now);

    const ConnectionBounds bounds_;
    std::unordered_map<std::uint64_t, Known> known_;
    std::uint64_t count_ = 0;
    std::map<std::pair<std::string, std::string>, std::size_t> untold_;  // closed: by reason and address
    TimePoint tell_from_{};
};

}  // namespace axon::transport
