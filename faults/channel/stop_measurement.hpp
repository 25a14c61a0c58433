// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>

#include "channel/two_sides.hpp"

namespace axon::faults {

/// How a stop travels in one row of the figures.
struct Sending {
    std::string name;
    bool options =
        false;  ///< the signal lane's socket options on both ends; otherwise TCP_NODELAY alone, as Ice has it
    bool datagrams =
        false;  ///< beside TCP, by the product's own sender, schedule and sentry; the first counts
};

struct Workload {
    std::size_t stops = 2000;
    std::size_t flows = 100;  ///< connections, each with isolated stops of its own
    /// Small messages ahead of the first stop, as heartbeats are: the kernel needs them to find its
    /// time-outs.
    std::size_t heartbeats = 40;
    Duration heartbeat = std::chrono::milliseconds{50};
    /// Between two stops of a flow, from half to one and a half times this.
    Duration pause = std::chrono::seconds{1};
    /// After the last stop; what has not come then never arrives.
    Duration patience = std::chrono::seconds{20};
};

struct Figures {
    std::size_t n = 0, never = 0;
    double p50_ms = 0, p99_ms = 0, max_ms = 0;  ///< one way, of all n; never arrived is infinite
    double copies = 0;                          ///< datagrams sent for each stop
};

/// Sends stops from left to right and measures each from its call of send to its first arrival. Blocks.
/// Throws std::runtime_error when the connections could not be made.
Figures measureStops(const TwoSides& sides, const Sending& sending, const Workload& workload,
                     std::uint64_t seed);

}  // namespace axon::faults
