// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <chrono>

#include "axon/client.hpp"
#include "common/clock.hpp"

namespace axon::client {

/// Converts a time of the public header. The result is from zero to a day, because sums with a longer time
/// could overflow.
inline Duration toDuration(Seconds seconds) {
    return std::chrono::duration_cast<Duration>(std::clamp(seconds, Seconds{0}, Seconds{86400}));
}

/// How long a request of this client waits for its answer.
inline Duration timeoutOf(const Options& options) {
    return std::max<Duration>(toDuration(options.timeout), std::chrono::milliseconds{1});
}

/// No thread sleeps longer than this; a time far away is a wait_until that may overflow.
inline constexpr Duration kLongestSleep = std::chrono::hours{1};

}  // namespace axon::client
