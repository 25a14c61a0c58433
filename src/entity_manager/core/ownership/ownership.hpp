// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstddef>
#include <optional>
#include <string>
#include <utility>

#include "common/refusal.hpp"
#include "entity_manager/core/journal/journal_writer.hpp"
#include "entity_manager/core/ownership/hand_over.hpp"
#include "entity_manager/core/ownership/wait_list.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/lease_book.hpp"
#include "entity_manager/core/turn/turn.hpp"

namespace axon::entity_manager {

/// Who has the entity, who wants it, and how it passes from one to the next: the lease and its reservation,
/// the wait list, the question to the holder, the grant that waits until the robot stands still, and the
/// grace of a holder that was lost (ADR 0007, ADR 0012).
///
/// Whatever the way, a check-out ends in grantWhenStanding(): a robot that has not confirmed its last stop is
/// handed over to nobody. Each check-out is answered once with a grant or a refusal, and meanwhile with its
/// place. What the end or the loss of a lease means for robot and tasks are rows of the state table.
class Ownership final : public Owner {
  public:
    struct Settings {
        Duration grace;                        ///< for which a lost holder may come back; 0 = none
        std::uint64_t resource_bytes_max = 0;  ///< told with a grant
    };
    /// What it asks of other owners.
    class Others {
      public:
        virtual ~Others() = default;
        /// Whether a task goes on to its end while its client is lost.
        virtual bool finishesAlone() const = 0;
        /// The holder is lost: ClientLost, or ClientSpared where all that runs may go on without it.
        virtual void loseHolder(Incident& lost) = 0;
        /// What has begun goes on without its client no longer: ClientLost, where there is anything.
        virtual void endSpared(const std::string& why) = 0;
        /// Fires CheckOutGranted or LeaseResumed, after which the holder's tasks have their client again.
        virtual void granted(Incident& granted) = 0;
        /// A profile that was kept while the entity was held, before the next who waits is given the entity.
        virtual void takeKeptProfiles() = 0;
    };
    /// `profiler`: whose services a grant tells. Throws std::runtime_error where the storage is damaged.
    Ownership(Turn& turn, Others& others, JournalWriter& journal, Storage& storage, RandomSource& random,
              const ServiceProfiler& profiler, const Settings& settings);

    const LeaseBook& lease() const { return lease_; }
    std::size_t waiting() const { return wait_list_.size(); }
    /// By whom it was taken from the last holder, and why, until it is granted again.
    const std::string& taken() const { return taken_; }
    /// When the holder was lost that is away, or was last.
    TimePoint lostAt() const { return lost_at_; }

    void offerDatagrams(std::string endpoint) { datagram_endpoint_ = std::move(endpoint); }
    void offerDirect(std::string data, std::string signal) {
        direct_endpoint_ = std::move(data);
        direct_signal_endpoint_ = std::move(signal);
    }

    // Actions of the state table.

    void considerCheckOut(const Incident& incident);
    void considerHandOver(const Incident& incident);
    /// To the holder.
    void sendGrant(proto::CheckOutPhase phase);
    /// Its holder was lost; a second loss changes nothing.
    void orphan(const Incident& incident);
    void end(const Incident& incident);
    /// What the incident's own client waits for, where it is about one; what anybody waits for.
    void dismissWaiting(const Incident& incident);
    void refuse(const Incident& incident, const Refusal& refusal);
    /// The answer to a check-out; noted where it is a refusal.
    void reply(const Sender& to, const std::string& request_id, proto::CheckOutPhase phase,
               const Refusal& refusal);

    // What follows by itself.

    /// After each event: a grant that has waited, a grace that is over, who is next, and who has come nearer.
    void passOn();
    void onTimer() override;
    TimePoint nextDeadline() const override;

  private:
    /// A granted check-out that waits until the robot has confirmed its last stop.
    struct WaitingGrant {
        Claim claim;
        proto::CheckOutPhase phase;
        TimePoint until;
    };

    const Sender* holder() const { return lease_.held() ? &lease_.held()->holder : nullptr; }
    void take(const Incident& incident, Claim claim);
    void reserve(const Incident& incident, const Claim& claim);
    void commit(const Incident& incident, const Claim& claim);
    void abort(const Incident& incident);
    void resume(const Incident& incident);
    Refusal mayTake(const Claim& claim) const;
    bool waitsForStandstill(const Claim& claim, proto::CheckOutPhase phase);
    bool mustWaitForStandstill() const;
    void grantWhenStanding(Claim claim, proto::CheckOutPhase phase);
    void takeOver(const Claim& claim, proto::CheckOutPhase phase, const Refusal& why);
    void askHolder(const Claim& claim, bool waits, const std::string& reason);
    void tellQuestion(const HandOver::Question& question, bool withdrawn);
    void decideHandOver(const HandOver::Question& question, bool accepted, const std::string& said);
    bool mayEndGrace() const;
    void endWaits();
    /// `kept`: what the holder, who was asked, has said.
    void sendPlace(const Claim& claim, std::size_t place, const std::string& kept = {});
    void sendLeaseEnded(const LeaseBook::Held& held, const Refusal& reason);
    void dropWaitingGrant(const Refusal& reason);

    Turn& turn_;
    Others& others_;
    JournalWriter& journal_;
    const ServiceProfiler& profiler_;
    const Settings settings_;

    LeaseBook lease_;
    std::optional<WaitingGrant> waiting_grant_;
    WaitList wait_list_;
    HandOver hand_over_;
    Refusal orphan_reason_;  ///< why the lease is orphaned
    TimePoint lost_at_{};    ///< when it became so
    std::string taken_;

    std::string datagram_endpoint_;                         ///< told with a grant
    std::string direct_endpoint_, direct_signal_endpoint_;  ///< likewise
};

}  // namespace axon::entity_manager
