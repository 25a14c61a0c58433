// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "common/clock.hpp"
#include "common/liveness.hpp"
#include "common/routed.hpp"
#include "common/snapshot.hpp"
#include "entity_server/drills/drills.hpp"
#include "entity_server/ports/ports.hpp"
#include "entity_server/publishing/record.hpp"
#include "entity_server/sessions/holder_log.hpp"
#include "entity_server/sessions/send_limits.hpp"

namespace axon::entity_server {

/// What the server knows of one session of an Entity Manager: the ways to it, which entity it is, what that
/// one may send, when it was heard last and when it is to hear from the server.
///
/// Heartbeats are sent at 16 times in each period, which are the same for all sessions with that period, so
/// that the timer wakes for many at once; and each session has its turn of the sixteen, so that many that
/// joined, or began to move, together are not served all at once for ever. Threads: each member says what
/// guards it, and the functions for heartbeats and warnings are called under the core's mutex, once
/// registered. States are those of EntityServerCore. Failure: none.
class Session {
  public:
    Session(std::uint64_t its_number, std::string its_token, std::shared_ptr<EntityOutbox> its_data,
            std::uint32_t messages_per_second, std::string its_user = {})
        : number(its_number),
          token(std::move(its_token)),
          data(std::move(its_data)),
          user(std::move(its_user)),
          limits(messages_per_second) {}

    // Constant after construction.
    const std::uint64_t number;
    const std::string token;
    const std::shared_ptr<EntityOutbox> data;
    const std::string user;  // who logged in; empty where nobody has a name

    // Written once, before `registered` is; read by others only after it.
    std::shared_ptr<EntityOutbox> signal;
    std::string entity;
    std::shared_ptr<Drills::Subject> drill;
    std::atomic<bool> registered{false};

    Snapshot<std::string> name;    // of its newest registration
    Snapshot<std::string> holder;  // by its newest status

    SendLimits limits;
    Liveness liveness;  // hears without a lock; judged under the core's mutex, once registered

    // Guarded by the core's mutex.
    RecordRef record;
    std::uint64_t revision = 0;  // of its entry in DueSessions; older entries are void
    HolderLog holder_log;
    bool gone = false;

    EntityOutbox& outbox(Lane lane) const { return lane == Lane::Signal ? *signal : *data; }
    Duration period() const {
        const auto& registration = record->registration;
        return std::chrono::milliseconds{liveness.busy() ? registration.heartbeat_busy_ms
                                                         : registration.heartbeat_idle_ms};
    }
    /// Heartbeats begin, or their period has changed.
    void restartHeartbeats(TimePoint now) { next_heartbeat_ = inTurn(now); }
    /// The number of one that is sent now though it is not due.
    std::int64_t extraHeartbeat() { return ++heartbeats_; }
    /// The number of the one that is due; none where it is too early.
    std::optional<std::int64_t> dueHeartbeat(TimePoint now) {
        if (next_heartbeat_ > now) return {};
        // From when it was due, so that late ones keep apart. Catching up after a pause would only send a
        // burst.
        const auto beat = turnBefore(next_heartbeat_ + period());
        next_heartbeat_ = beat > now ? beat : inTurn(now);
        return ++heartbeats_;
    }
    TimePoint nextHeartbeat() const { return next_heartbeat_; }
    /// How late its sign of life is, or was; none where nobody needs to be told, or was told lately.
    std::optional<Liveness::Gap> warning(TimePoint now) {
        if (now < warn_again_) return {};
        const auto gap = liveness.longest(now);
        if (gap.part() < Liveness::kWarnFrom) return {};
        warn_again_ = now + Liveness::kWarnAgain;
        return gap;
    }

  private:
    static constexpr int kTurns = 16;

    /// The last of the sixteen times that is not after `latest`.
    TimePoint turnBefore(TimePoint latest) const {
        return latest - latest.time_since_epoch() % (period() / kTurns);
    }
    /// Within a period from now.
    TimePoint inTurn(TimePoint now) const {
        return turnBefore(now + period() * static_cast<int>(number % kTurns + 1) / kTurns);
    }

    TimePoint next_heartbeat_;
    std::int64_t heartbeats_ = 0;
    TimePoint warn_again_;
};
using SessionRef = std::shared_ptr<Session>;

}  // namespace axon::entity_server
