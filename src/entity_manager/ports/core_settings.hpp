// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

#include "common/clock.hpp"

namespace axon::entity_manager {

/// Settings of one Entity Manager that its behaviour depends on (docs/reference/configuration.md).
struct EntityManagerCoreSettings {
    std::string application;  ///< name of the robot application it is for
    Duration server_watchdog_busy = std::chrono::milliseconds{250};  ///< 50 ms to 2 s
    Duration server_watchdog_idle = std::chrono::seconds{10};
    Duration lease_grace =
        std::chrono::seconds{5};  ///< how long a lease outlives the loss of its holder; 0 = not at all
    std::size_t task_queue_bound = 64;
    std::uint64_t resource_bytes_max = 1ULL << 30U;  ///< of one upload
    std::uint64_t resource_window = 512 * 1024;      ///< bytes a client may send ahead
    Duration answer_within =
        std::chrono::seconds{10};  ///< what the robot application is asked; then TIMED_OUT
    Duration profiles_within =
        std::chrono::seconds{3};  ///< after the link is up; then what has not been uploaded is missing
    std::string uuid = {};        ///< to take where the state has none; empty: a random one
};

/// What has been dropped without an answer, because there is nobody to answer or because the answer would be
/// a flood.
struct CoreCounters {
    std::uint64_t unexpected = 0;  ///< facts without a row, and reports of tasks that are not known
    std::uint64_t malformed = 0;  ///< messages that could not be read, or whose header says what they are not
    std::uint64_t anonymous = 0;  ///< messages without a sender
    std::uint64_t undelivered =
        0;  ///< texts, raw data and samples that nobody held or watched the entity for
    std::uint64_t raw_refused = 0;    ///< raw data of somebody who may not send it
    std::uint64_t peer_refusals = 0;  ///< messages to other entities that did not arrive
    std::uint64_t unrecorded = 0;     ///< entries that the journal did not take, and refusals above its rate
};

}  // namespace axon::entity_manager
