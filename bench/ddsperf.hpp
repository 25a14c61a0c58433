// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "placement.hpp"

namespace axon::bench {

/// One second of CycloneDDS's own benchmark, as it prints it: halves of round trips. (It does not say so, but
/// as many round trips as it counts, of twice the mean that it prints, fill the second in which they follow
/// each other without a pause.)
struct DdsperfSecond {
    double mean_us = 0, p50_us = 0, p99_us = 0, max_us = 0;
    long count = 0;  ///< round trips
};

/// "[PID] TIME HOST:PID size N mean …us min …us 50% …us 90% …us 99% …us max …us cnt N"; nothing for another
/// line.
std::optional<DdsperfSecond> readDdsperf(const std::string& line);

/// `ddsperf ping` and `ddsperf pong`, two processes on loopback, tightly one round trip after the other. So
/// many seconds after the first one with round trips, in which they find each other; fewer when it ends.
/// Placed as what is measured beside it: ping sends. Throws std::runtime_error with the log when there are
/// none.
std::vector<DdsperfSecond> pingPong(const std::filesystem::path& folder, std::size_t bytes, int seconds,
                                    const Placement& placement);

}  // namespace axon::bench
