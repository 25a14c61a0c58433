// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/task.pb.h>

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <vector>

#include "axon/global.hpp"
#include "client/core/core_context.hpp"
#include "client/core/requests.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"

namespace axon::proto {
class GlobalServices;
class RunEvent;
class RunHistory;
}  // namespace axon::proto

namespace axon::client {

/// A global service to be carried out, or to be checked.
struct RunOrder {
    const GlobalService& service;
    std::map<int, std::string> players;  ///< role → UUID
    std::string master;                  ///< UUID, one of the players
    bool check_only = false;
    std::int64_t asked_at_ms = 0;  ///< of the calendar, since 1970 in UTC
};

/// The runs of global services that this client has asked for, their newest reports, and what the server
/// offers. Part of SessionCore.
///
/// A run shares the fate of its master's lease: Unknown when that is lost, asked after when it is resumed. A
/// report never leaves a final state. Of those that are over the newest SessionCoreSettings::runs_kept can
/// still be asked for.
class Runs {
  public:
    explicit Runs(const CoreParts& parts) : parts_(parts) {}

    /// Refused here: NOT_CONNECTED, NOT_HOLDER, WRONG_STATE for leases of more than one root, MALFORMED for
    /// roles without a player or a master without a role, WRONG_TYPE for an output that the input it feeds
    /// can never take. All else comes as reports of the run.
    Result<Id128> run(const RunOrder& order);
    /// As of a task (Tasks::control).
    void control(const Id128& run, proto::TaskAction action, Done done);
    /// Nothing for a run that is not, or no longer, known.
    std::optional<RunReport> report(const Id128& run) const;
    /// What the front-end server offers.
    void fetchServices(GlobalServicesDone done);
    /// Runs of which the entity was the master; no lease needed. `most` = 0: all that it keeps.
    void fetchRecords(const std::string& entity, int most, RunRecordsDone done);

    // Those that are not final, as of Tasks.
    bool anyOpen() const { return !open_.empty(); }
    std::vector<Id128> open(const Held& master) const;
    void finishAll(const Held& master, const Refusal& unknown);
    void finishUnheld(const Refusal& unknown);
    void awaitEnds(const Held& master);
    /// The lease of their master was resumed.
    void askAfter(const Held& master);

    void onServices(const proto::GlobalServices& services);
    void onEvent(const std::string& entity, const proto::RunEvent& event);
    void onHistory(const std::string& entity, const proto::RunHistory& history);
    /// By a reply of this entity.
    void onRefused(Id128 run, const std::string& entity, const Refusal& why);
    /// Ids by value: callers may name them by the very key that goes away.
    void finish(Id128 run, RunState state, const Refusal& why);
    /// The request for it was not answered in time.
    void onDue(Id128 run);
    void onAskAfterDue(Id128 request);

  private:
    struct Entry {
        Held master;
        RunReport report;
        std::uint64_t sequence = 0;  // of the last event
    };
    /// WRONG_TYPE names every result of a step that a later one cannot take for its type or units.
    Refusal misfits(const RunOrder& order) const;
    void awaitEnd(Id128 run);
    /// What is new of it, to the observer and to who waits for its state.
    void tell(Id128 run);
    void sendHistoryRequest(Id128 request, const Held& master);

    const CoreParts& parts_;
    std::unordered_map<Id128, Entry> runs_;
    std::set<Id128> open_;  // those of runs_ that are not final
    std::deque<Id128> finished_;
};

}  // namespace axon::client
