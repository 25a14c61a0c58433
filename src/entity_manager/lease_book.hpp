// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "entity_manager/ports.hpp"

namespace axon::entity_manager {

/// Who holds the entity, and the fence against everybody else (architecture, section 6).
///
/// Where in the flow: EntityManagerCore asks it before it obeys a command. States: free, reserved (for a
/// check-out of several entities that is about to commit, or one that waits for the robot to stand still),
/// held. Threads: the core's strand. Failure: refusals; a Storage that cannot save the epoch makes the
/// constructor throw.
///
/// The epoch counts the starts of this Entity Manager and the number the check-outs since; both only grow, so
/// a lease of an earlier check-out or an earlier life is always recognised.
class LeaseBook {
  public:
    struct Held {
        LeaseNumber number;
        Id128 key;  ///< known to the EM and the holder
        Sender holder;
        std::string request_id;  ///< of the check-out, so that a repeated request is known
    };
    struct Reservation {
        Sender by;
        std::string request_id;
        TimePoint until;
    };

    LeaseBook(Storage& storage, RandomSource& random);

    const std::optional<Held>& held() const { return held_; }
    const std::optional<Reservation>& reservation() const { return reservation_; }

    /// Whether this sender may take or reserve now: PERMISSION_DENIED, ALREADY_HELD, RESERVED.
    Refusal mayTake(const Sender& sender, const std::string& request_id) const;
    /// Whether the reservation of this request stands: EXPIRED where it does not.
    Refusal mayCommit(const Sender& sender, const std::string& request_id) const;
    /// After mayTake(): nobody else may take before `until`.
    void reserve(const Sender& sender, const std::string& request_id, TimePoint until);
    /// After mayTake() or mayCommit(): a new lease, saved before it is used.
    const Held& grant(const Sender& sender, const std::string& request_id);

    void dropReservation() { reservation_.reset(); }
    /// Whether a reservation has run out at `now`; it is gone then.
    bool expire(TimePoint now);
    /// `code` is what a command under the ended lease is told from now on.
    void end(RefusalCode code, std::string why);

    /// Whether the sender is the holder and gives the command under the present lease: NOT_HOLDER,
    /// OLDER_LEASE, WRONG_EPOCH, or how the lease ended.
    Refusal check(const Sender& sender, LeaseNumber under) const;

    LeaseNumber last() const { return last_; }

  private:
    RandomSource& random_;
    LeaseNumber last_;  ///< highest ever given
    std::optional<Held> held_;
    std::optional<Reservation> reservation_;
    RefusalCode end_code_ = RefusalCode::Ok;
    std::string end_why_;
    std::string last_holder_;
};

}  // namespace axon::entity_manager
