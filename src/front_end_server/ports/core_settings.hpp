// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

#include "common/clock.hpp"
#include "common/neighbours.hpp"
#include "common/rate_limit.hpp"

namespace axon::front_end_server {

struct FrontEndCoreSettings {
    /// Of one of several front-end servers in processes of their own (isServerName); empty: it is the only
    /// one, with the only entity server beside it.
    std::string name;
    Neighbours::Timeouts entity_servers;
    Duration watchdog_busy = std::chrono::milliseconds{250};  ///< safety.md, "Watchdogs"
    Duration watchdog_idle = std::chrono::seconds{10};
    Duration heartbeat_idle = std::chrono::seconds{2};
    std::size_t clients_max = 4096;
    std::size_t clients_remembered = 1024;  ///< that are gone, and might be granted an entity late
    std::uint32_t messages_per_second =
        100'000;  ///< control messages of one client, and signals; above is a flood
    // Of one user, in all sessions at this server; of a session without a user, alone. Stops are not counted.
    std::size_t user_sessions = 256;
    std::size_t user_check_outs = 1024;
    std::uint32_t user_messages_per_second = 200'000;
    std::uint32_t user_bytes_per_second = 512 * 1024 * 1024;  ///< droppable data included
    /// Entities that one client may drill in a second; what begins within is carried out, and the next
    /// refused.
    std::uint32_t drills_per_second = kDrillsPerSecond;
};

}  // namespace axon::front_end_server
