// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <chrono>

#include "common/clock.hpp"

namespace axon {

/// How often a front-end server sends heartbeats to a client one of whose entities is BUSY: five times within
/// `watchdog`, the time after which that server gives a busy client up. Never more often than every 50 ms and
/// at least every 200 ms, because a busy client gives a server up after a second, whatever the
/// server's watchdog is.
constexpr Duration heartbeatToBusyClient(Duration watchdog) {
    using std::chrono::milliseconds;
    return std::clamp<Duration>(watchdog / 5, milliseconds{50}, milliseconds{200});
}

}  // namespace axon
