// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "common/clock.hpp"
#include "common/liveness.hpp"
#include "common/rate_limit.hpp"
#include "common/routed.hpp"
#include "common/snapshot.hpp"
#include "front_end_server/clients/held_statuses.hpp"
#include "front_end_server/clients/its_entities.hpp"
#include "front_end_server/clients/user_share.hpp"
#include "front_end_server/ports/core_settings.hpp"
#include "front_end_server/ports/ports.hpp"

namespace axon::front_end_server {

// Of who does not hold the entity, since its Entity Manager must read a message before it can tell whose it
// is: in one message, more than a chunk of an upload; in a second, less than a slow link to a robot carries.
inline constexpr std::size_t kStrangersBytes = 128 * 1024U;
inline constexpr std::uint32_t kStrangersBytesPerSecond = 1024 * 1024U;
inline constexpr std::uint32_t kListsPerSecond = 4;  // of all entities, for one client

/// What the server knows of one client: the ways to it, how fast it sends, when it was heard last, and which
/// entities know of it.
///
/// Threads: each member says what guards it; the functions are called from any. States are those
/// of FrontEndCore.
class Client {
  public:
    Client(Sender its_sender, std::string its_token, std::shared_ptr<ClientOutbox> its_data,
           const FrontEndCoreSettings& settings, TimePoint now, std::string its_user = {},
           std::shared_ptr<UserShare> its_share = nullptr, bool is_surplus = false, Duration phase = {},
           std::string why_it_only_watches = {})
        : me(std::move(its_sender)),
          token(std::move(its_token)),
          user(std::move(its_user)),
          data(std::move(its_data)),
          connection(data->connection()),
          share(its_share ? std::move(its_share) : std::make_shared<UserShare>(settings)),
          surplus(is_surplus),
          only_watches(std::move(why_it_only_watches)),
          rate(settings.messages_per_second),
          drill_rate(settings.drills_per_second),
          liveness(settings.watchdog_busy, settings.watchdog_idle, now),
          statuses(phase),
          next_heartbeat(now + settings.heartbeat_idle) {}

    // Constant after construction.
    const Sender me;
    const std::string token;
    const std::string user;  // who logged in; empty where nobody has a name
    const std::shared_ptr<ClientOutbox> data;
    const void* const connection;            // of data; others may come by it, too
    const std::shared_ptr<UserShare> share;  // with the other sessions of the user
    const bool surplus;                      // beyond the sessions that the user may have
    const std::string only_watches;          // why, where it is surplus and its user may do more

    RateLimit rate, drill_rate, bytes{kStrangersBytesPerSecond}, lists{kListsPerSecond};
    Snapshot<std::shared_ptr<ClientOutbox>> signal;  // null inside until attach()
    Liveness liveness;                               // hears without a lock; changed under the core's mutex
    std::atomic<std::size_t> told{0};                // entities, when it joined
    ItsEntities entities;
    HeldStatuses statuses;
    std::atomic<bool> gone{false};  // what it sends is passed on no more, but for stops

    // Guarded by the core's mutex.
    TimePoint next_heartbeat;
    std::int64_t heartbeats = 0;
    TimePoint warn_again;

    /// The signal lane, or the only one there is.
    std::shared_ptr<ClientOutbox> signalOutbox() const {
        const auto own = *signal.load();
        return own ? own : data;
    }
};

}  // namespace axon::front_end_server
