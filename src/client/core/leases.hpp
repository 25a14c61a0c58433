// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/profile.pb.h>

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "axon/types.hpp"
#include "client/core/core_context.hpp"
#include "client/core/requests.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::proto {
class CheckOutReply;
class HandOverRequest;
class LeaseEnded;
}  // namespace axon::proto

namespace axon::client {

/// What proves that a lease is ours.
struct LeaseTicket {
    std::string entity;
    LeaseNumber lease;
    std::string key;  ///< 16 bytes

    std::string toText() const;
    /// MALFORMED for what toText() has not written.
    static Result<LeaseTicket> parse(std::string_view text);
};

struct Lease {
    LeaseNumber number;
    std::string key, root;
    std::string name;  ///< the entity's, for when it is not known
    proto::ServicesProfile services;
    Duration grace{};
    std::uint64_t resource_bytes_max = 0;  ///< 0 = not known
    HandOverPolicy policy;
    std::string asked_by;  ///< request id of `question`
    std::optional<HandOverRequest> question;
    TimePoint answer_until{};  ///< of `question`
    bool orphaned = false;
    bool left = false;  ///< orphaned because the entity has left or waits for us, not by the connection
    TimePoint expires;  ///< while orphaned
    TimePoint loss_due = TimePoint::max();  ///< when a loss that nobody has told of counts
    Id128 resume;                           ///< of the request that is to resume it, while orphaned
};

/// What this client holds: the leases, how they are handed over, and how they outlive a lost connection. Part
/// of SessionCore.
///
/// States of a lease: held ─► orphaned (the connection is lost, or the entity has left, or says that its
/// Entity Manager waits for us) ─► held again, when its Entity Manager has resumed it by its key; or over,
/// from either. One that has neither grace nor permission to be resumed is over with the connection.
class Leases {
  public:
    explicit Leases(const CoreParts& parts) : parts_(parts) {}

    // What is held.
    std::vector<Held> held() const;
    bool any() const { return !leases_.empty(); }
    /// Null if it is not, or no longer, held under this lease.
    const Lease* find(const Held& held) const;
    /// Null when it is not held.
    const Lease* of(const std::string& entity) const;
    bool holds(const Held& held) const { return find(held) != nullptr; }
    /// Held, and waiting for the connection or the Entity Manager's word that it still is.
    bool orphaned(const Held& held) const;
    /// NOT_CONNECTED, NOT_HOLDER; OK when commands may be given under it now.
    Refusal ready(const Held& held) const;
    std::optional<HandOverRequest> question(const Held& held) const;
    Result<LeaseTicket> ticket(const Held& held) const;
    Result<std::vector<Service>> services(const Held& held) const;
    Result<Service> service(const Held& held, std::string_view name_or_global_id) const;
    /// Of one upload to this entity; 0 = it has not told.
    std::uint64_t resourceBytesMax(const Held& held) const;
    /// Of every lease of this session; of a resumed one, when that was the first. 16 bytes.
    const std::string& root();

    // What the user wants.
    Result<void> answerHandOver(const Held& held, bool accept, std::string_view reason);
    Result<void> setHandOverPolicy(const Held& held, const HandOverPolicy& policy);
    /// The lease is given up at once, whatever the answer.
    void release(const Held& held, Done done);

    // Events.
    /// Nothing is kept when there will be no other connection.
    void onDisconnected(const Refusal& lost, bool was_connected, bool for_good);
    /// The entity has left; its Entity Manager may only have lost the server for a moment.
    void onLeft(const std::string& entity, const Refusal& why);
    void onStatus(const EntityStatus& status);
    void onService(const std::string& entity, const proto::Service& service);
    void onHandOver(const std::string& entity, const proto::HandOverRequest& request);
    void onLeaseEnded(const std::string& entity, const proto::LeaseEnded& ended);
    /// Whether it was the answer to one of sendResume().
    bool onResumeReply(const std::string& entity, Id128 request, const proto::CheckOutReply& reply);
    void onResumeDue(Id128 request);
    /// The servers do not know its entity (yet): it is asked again when that joins.
    void onResumeRefused(Id128 request, const std::string& entity);
    /// A refusal that may say that the lease is no longer ours.
    void onRefusal(const std::string& entity, LeaseNumber under, const Refusal& refusal);

    // For check-outs.
    void grant(const std::string& entity, const proto::CheckOutReply& reply, const HandOverPolicy& policy);
    /// Ends it here, with all that was asked for under it. `tell`: the program does not know it, and what ran
    /// is Unknown. The entity by value: callers name it by the key that goes away.
    void end(std::string entity, const Refusal& why, bool tell);
    void sendRelease(const Held& held);
    /// A lease whose Entity Manager has waited for us for a second is lost, and resumed.
    void onTimer();
    TimePoint nextDeadline() const { return loss_due_; }
    /// Where the lease of this entity is orphaned.
    void sendResume(const std::string& entity);
    void sendResumes();

  private:
    Refusal notHolder(const Held& held) const;
    bool mayOutlive(const Lease& lease) const;
    void expectLoss(Lease& lease, bool waits);
    void orphan(const std::string& entity, bool left, const std::string& reason);
    void endReleases(const std::string& entity, const std::function<bool(LeaseNumber)>& which);

    const CoreParts& parts_;
    std::map<std::string, Lease> leases_;  // by entity
    std::string root_;
    TimePoint loss_due_ = TimePoint::max();  // the first of all leases
};

}  // namespace axon::client
