// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <optional>
#include <string>
#include <string_view>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// For people: the name, or the id of who has none.
std::string named(const Sender& sender);

/// What happens when a holder is asked to hand over and does not answer.
struct HandOverPolicy {
    Duration answer_within = std::chrono::seconds{30};
    bool yield = false;  ///< silence hands over; otherwise it refuses
};

/// Somebody's wish to have the entity, kept for as long as it waits.
struct Claim {
    Sender client;
    std::string request_id;
    std::string root;  ///< of the lease that it leads to: 16 bytes of the client's choice, or empty
    HandOverPolicy hand_over = {};
};

/// Who holds the entity, and the fence against everybody else (ADR 0007).
///
/// Where in the flow: EntityManagerCore asks it before it obeys a command. States: free, held, orphaned (held
/// by a client that was lost; only its key resumes it), each with or without a reservation: for a check-out
/// of several entities that is about to commit, or one that waits for the robot to stand still. Of a held
/// entity only an administrator's reservation exists. Threads: the core's strand. Failure: refusals; a
/// Storage that cannot save the epoch makes the constructor throw.
///
/// The epoch counts the starts of this Entity Manager and is saved before the first lease of a life; the
/// number counts the check-outs since. Both only grow, so a lease of an earlier check-out or an earlier life
/// is always recognised.
class LeaseBook {
  public:
    struct Held {
        LeaseNumber number;
        Id128 key;  ///< known to the EM and the holder
        Sender holder;
        std::string request_id;  ///< of the check-out, so that a repeated request is known
        std::string root;
        HandOverPolicy hand_over;
        std::optional<TimePoint> grace_until;  ///< orphaned
        std::string taken_by;                  ///< for people: who took it, whoever has resumed it since
    };
    struct Reservation {
        Sender by;
        std::string request_id;
        TimePoint until;
    };

    LeaseBook(Storage& storage, RandomSource& random);
    /// Whether an earlier life has left its epoch.
    static bool isStored(Storage& storage);

    const std::optional<Held>& held() const { return held_; }
    bool orphaned() const { return held_ && held_->grace_until; }
    const std::optional<Reservation>& reservation() const { return reservation_; }
    bool reservedFor(const Sender& sender, const std::string& request_id) const;

    /// Whether this sender may take or reserve now: PERMISSION_DENIED, ALREADY_HELD, RESERVED.
    Refusal mayTake(const Sender& sender, const std::string& request_id) const;
    /// Whether the reservation of this request stands: EXPIRED where it does not.
    Refusal mayCommit(const Sender& sender, const std::string& request_id) const;
    /// Whether this number and key are those of the present lease: PERMISSION_DENIED, and what check() says.
    /// The time it takes does not tell how much of the key is right.
    Refusal mayResume(LeaseNumber number, std::string_view key) const;

    /// After mayTake(), or by an administrator: nobody else may take before `until`.
    void reserve(const Sender& sender, const std::string& request_id, TimePoint until);
    /// After mayTake() or mayCommit(), of what is free: a new lease, above all earlier ones.
    const Held& grant(const Claim& claim);
    /// The holder was lost. A second loss does not prolong the grace.
    void orphan(TimePoint until);
    /// After mayResume(): the same lease has this holder from now on.
    void resume(const Sender& sender, const std::string& request_id);
    void setHandOver(HandOverPolicy policy);

    void dropReservation() { reservation_.reset(); }
    /// Whether a reservation has run out at `now`; it is gone then.
    bool expire(TimePoint now);
    /// `code` is what a command under the ended lease is told from now on.
    void end(RefusalCode code, std::string why);

    /// Whether the sender is the holder and gives the command under the present lease: NOT_HOLDER,
    /// OLDER_LEASE, WRONG_EPOCH, CLIENT_LOST (orphaned), or how the lease ended.
    Refusal check(const Sender& sender, LeaseNumber under) const;

    LeaseNumber last() const { return last_; }

  private:
    Refusal checkNumber(LeaseNumber under) const;
    std::string nameOfHolder() const { return held_ ? named(held_->holder) : std::string(); }
    std::string whoHolds() const;

    RandomSource& random_;
    LeaseNumber last_;  ///< highest ever given
    std::optional<Held> held_;
    std::optional<Reservation> reservation_;
    RefusalCode end_code_ = RefusalCode::Ok;
    std::string end_why_;
    std::string last_holder_;
};

}  // namespace axon::entity_manager
