// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <sys/types.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <tuple>

#include "channel/channel.hpp"
#include "common/descriptor.hpp"

namespace axon::faults {

/// This machine does not let us make namespaces or TUN devices; the message says what it refused.
class NotPermitted : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

enum class Side : std::uint8_t { Left, Right };

/// Two network namespaces that this process makes for itself, each with a loopback and one TUN device, and a
/// channel in between. They have no names and nothing to clean up: they end with the last process in them.
///
/// Threads: one carries packets, under SCHED_RR where permitted; construct it before any other thread exists,
/// because a process that has threads may not make itself a user namespace (needed only where it is not
/// root). A descriptor belongs to the namespace in which it was made: enter() a side, make sockets, and go
/// on.
class TwoSides {
  public:
    static constexpr const char* kLeft = "10.77.0.1";
    static constexpr const char* kRight = "10.77.0.2";

    /// Throws NotPermitted.
    TwoSides(const ChannelSettings& settings, std::uint64_t seed);
    ~TwoSides();
    TwoSides(const TwoSides&) = delete;
    TwoSides& operator=(const TwoSides&) = delete;

    /// The calling thread is on that side from now on.
    void enter(Side side) const;
    /// A shell command on that side, the leader of a process group of its own. AXON_CHANNEL_HERE and
    /// AXON_CHANNEL_THERE are its own and the other side's address.
    pid_t start(Side side, const std::string& command) const;

    struct Report {
        Channel::Counters to_right, to_left;
        std::uint64_t outages = 0;
    };
    /// Ends the carrying thread.
    Report finish();

  private:
    class Carrier;
    Descriptor namespaces_[2];
    Descriptor tuns_[2];
    std::unique_ptr<Carrier> carrier_;
};

}  // namespace axon::faults
