// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <compare>
#include <cstdint>
#include <string>

#include "axon/global.hpp"
#include "axon/types.hpp"
#include "common/ids.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"

namespace axon::client {

/// One granted check-out: the lease's number makes the difference between now and an earlier time.
struct Held {
    std::string entity;
    LeaseNumber lease;

    auto operator<=>(const Held&) const = default;
};

/// What a lease offers besides the way through the servers. Called from inside the core.
class LeaseOffers {
  public:
    virtual ~LeaseOffers() = default;
    /// Stops of this lease may be sent to `endpoint` as datagrams, keyed by `key`; empty = not, or no longer.
    virtual void onDatagrams(const Held& /*held*/, const std::string& /*endpoint*/,
                             const std::string& /*key*/) {}
    /// A direct path of this lease may be opened at these endpoints ("host:port"), by its key; empty = not,
    /// or no longer.
    virtual void onDirect(const Held& /*held*/, const std::string& /*data_endpoint*/,
                          const std::string& /*signal_endpoint*/, const std::string& /*key*/) {}
};

/// What the core reports to its owner. Called from inside the core: implementations must neither call back
/// into it nor wait.
class SessionObserver : public LeaseOffers {
  public:
    /// Called for entities that are ready. One that becomes ready is reported as joined.
    virtual void onEntity(Presence presence, const Entity& entity) = 0;
    virtual void onTask(const TaskReport& report) = 0;
    virtual void onRun(const RunReport& /*report*/) {}
    virtual void onText(const Held& held, const std::string& text) = 0;
    virtual void onRaw(const Held& held, const std::string& bytes) = 0;
    virtual void onService(const Held& held, const Service& service) = 0;
    /// Not called for a lease that this client released itself.
    virtual void onLost(const Held& held, const Refusal& why) = 0;
    /// The connection is lost, or the entity has left, and the lease is not (yet): onResumed or onLost will
    /// follow.
    virtual void onOrphaned(const Held&, const std::string& /*reason*/) {}
    virtual void onResumed(const Held&) {}
    virtual void onHandOver(const Held&, const HandOverRequest&) {}
    virtual void onSample(Sample sample) = 0;
    /// Send of the resource from `offset` up to `limit`.
    virtual void onTransferCredit(const Id128& transfer, std::uint64_t offset, std::uint64_t limit) = 0;
    /// What the servers say to people.
    virtual void onServerText(int code, const std::string& text) = 0;
};

}  // namespace axon::client
