// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <vector>

#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/core/turn/turn.hpp"

namespace axon::entity_manager {

/// Tells the holder the records of these services, which have changed, and with them those of the composites
/// that show what is theirs.
void tellServices(Turn& turn, const ServiceProfiler& profiler, const std::vector<int>& services);

}  // namespace axon::entity_manager
