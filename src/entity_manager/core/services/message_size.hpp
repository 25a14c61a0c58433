// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <string>

#include "common/frame.hpp"
#include "common/refusal.hpp"

namespace axon::entity_manager {

/// Bytes of one message to the robot application. Some are left for a stop generation that grows while a task
/// waits.
inline constexpr std::size_t kMessageMax = kFrameMax - 64;

/// TOO_LARGE: the link has no larger frames, and what cannot be sent would never be answered.
inline Refusal checkSize(std::size_t bytes) {
    if (bytes <= kMessageMax) return {};
    return {RefusalCode::TooLarge,
            "With all parameters it has " + std::to_string(bytes) +
                " bytes, and the robot application takes at most " + std::to_string(kMessageMax) +
                " at once. Shorten the parameters, or upload a resource.",
            {}};
}

}  // namespace axon::entity_manager
