// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstddef>

#include "common/rate_limit.hpp"
#include "front_end_server/ports/core_settings.hpp"

namespace axon::front_end_server {

/// What all sessions of one user may do together at this server; a session without a user has one for itself.
/// Threads: each member says what guards it.
struct UserShare {
    explicit UserShare(const FrontEndCoreSettings& settings)
        : messages(settings.user_messages_per_second), bytes(settings.user_bytes_per_second) {}

    RateLimit messages, bytes;
    std::atomic<std::size_t> held{0};  // entities; changed under the core's mutex
    // Guarded by the core's mutex:
    std::size_t sessions = 0;
    std::size_t surplus = 0;  // of these, those beyond the most, which may only watch and stop
};

}  // namespace axon::front_end_server
