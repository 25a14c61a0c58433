// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "axon/types.hpp"
#include "client/core/core_context.hpp"
#include "client/core/entity_query.hpp"
#include "client/core/leases.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::client {

/// The check-outs that are on their way: one order each, of one entity or of several. Part of SessionCore.
///
/// One entity is asked for (TAKE), perhaps queued, then granted. Several are reserved, then committed; where
/// one refuses, what was reserved is given back. A query first asks candidates what they can do, and takes
/// another where it loses a race. Orders that wait for several are parked until all are free. Each is
/// answered exactly once.
class CheckOuts {
  public:
    using Done = std::function<void(Result<std::vector<Held>>)>;

    explicit CheckOuts(const CoreParts& parts) : parts_(parts) {}

    /// Returns the number for giveUp(). The core ignores `options.give_up`, which the owner handles.
    /// `options.on_waiting` must not call back into the core.
    Id128 checkOut(const std::vector<std::string>& names, const CheckOutOptions& options, Done done);
    Id128 checkOut(const std::vector<std::string>& names, Done done) {
        return checkOut(names, {}, std::move(done));
    }
    Id128 checkOut(const EntityQuery& query, const CheckOutOptions& options, Done done);
    /// A lease of another session of the same user, by its key.
    void resume(const LeaseTicket& ticket, Done done);
    void giveUp(Id128 check_out);

    // Events.
    void onDisconnected(const Refusal& lost);
    void onReply(const Header& head, const proto::CheckOutReply& reply);
    /// By the servers. Whether it was a message of a check-out.
    bool onRefused(std::int64_t sequence, const std::string& entity, const Refusal& why);
    void onLeft(const std::string& entity, const Refusal& why);
    /// A status has come: what was waited for may be free.
    void wakeParked();
    void onTimer();
    TimePoint nextDeadline() const { return due_.empty() ? TimePoint::max() : due_.begin()->first; }

  private:
    struct Party {
        std::string entity;
        std::int64_t sequence = 0;
        bool answered = false;  // in the present phase
        bool refused = false;
        bool granted = false;
        LeaseNumber lease;
    };
    enum class Stage : std::uint8_t {
        Looking,     // for what the candidates of a query can do
        Asked,       // TAKE, RESERVE or RESUME_LEASE is under way
        Queued,      // in a wait list, or the holder is being asked
        Parked,      // several: until all are free
        Committing,  // several: COMMIT is under way
    };
    struct Order {
        CheckOutOptions options;
        std::vector<std::string> wanted;   // UUIDs …
        std::optional<EntityQuery> query;  // … or this
        std::optional<LeaseTicket> resume;
        Stage stage = Stage::Asked;
        Id128 request;  // of the present attempt; the entities know it by this
        bool several = false;
        std::vector<Party> parties;                           // of the present attempt
        TimePoint due = TimePoint::max();                     // in due_
        TimePoint until = TimePoint::max();                   // it waits no longer
        std::set<std::string> passed_over;                    // of a query: refused in this round
        std::map<std::string, std::set<std::string>> offers;  // of a query: names of services
        std::size_t looking = 0;
        Refusal last;
        int place = -1;
        std::string told;
        std::string kept;  // by the holder that was asked: what it said
        Done done;
    };
    using Orders = std::map<Id128, Order>;

    Id128 begin(Order order, Done done);
    /// Asks for what is wanted, or for what of the query is there now.
    void attempt(Id128 id);
    /// Asks candidates of a query for their services. False when nothing is left to be asked.
    bool look(Id128 id);
    Assignment choose(const Order& order, bool optimistic, std::vector<std::string>& chosen) const;
    bool wantedAreFree(const Order& order) const;
    Refusal lacking(const Order& order, const Assignment& assignment) const;
    void park(Id128 id, const Refusal& why, bool soon);
    void schedule(Id128 id, TimePoint due);
    void onDue(Id128 id);
    void onPartyRefused(Id128 id, const std::string& entity, const Refusal& why);
    void onWaiting(Id128 id, int place);
    void tellWaiting(Order& order, Waiting waiting);
    void advance(Id128 id);
    void fail(Id128 id, Refusal why);
    /// Takes back what the present attempt has asked for.
    void endAttempt(Order& order, const Refusal& why);
    void forgetAttempt(Order& order);
    Order take(Orders::iterator found);
    void sendRequest(Order& order, Party& party, int phase);
    std::string holderOf(const std::string& entity) const;

    const CoreParts& parts_;
    Orders orders_;
    std::unordered_map<Id128, Id128> attempts_;  // request → of which of orders_
    std::set<Id128> parked_;                     // those of orders_ that wait for entities to be free
    std::set<std::pair<TimePoint, Id128>> due_;  // of orders_
    std::unordered_map<std::int64_t, Id128> by_sequence_;  // of messages → of which of orders_
};

}  // namespace axon::client
