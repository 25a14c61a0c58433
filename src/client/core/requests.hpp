// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/task.pb.h>

#include <compare>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <type_traits>
#include <unordered_map>
#include <utility>
#include <variant>
#include <vector>

#include "axon/global.hpp"
#include "axon/types.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::client {

using Done = std::function<void(Result<void>)>;
using DetailsDone = std::function<void(Result<Details>)>;
using GlobalServicesDone = std::function<void(Result<GlobalServices>)>;
using RunRecordsDone = std::function<void(Result<std::vector<RunRecord>>)>;

/// What a client asks for and waits for, one type for each kind. settle() tells whoever asked that it is
/// done, or why it is not, and returns what that says of the lease. What has an answer of its own is told it
/// by whoever takes the request.
namespace request {

/// Somebody waits for the answer.
template <class Answer>
struct Asked {
    Result<void> settle(const Result<void>& result) const {
        if constexpr (std::is_void_v<Answer>) {
            done(result);
        } else {
            done(result.refusal());
        }
        return result;
    }
    std::function<void(Result<Answer>)> done;
};
/// The answer is told otherwise: in the reports of a task or run, or as the fate of a lease.
struct Reported {
    static Result<void> settle(const Result<void>& result) { return result; }
};

/// The lease is over here already: whatever comes back, it is done. Only silence is told
/// (SessionCore::onRequestDue).
struct Release {
    Result<void> settle(const Result<void>&) const {
        done({});
        return {};
    }
    Done done;
};
/// What the entity answers with a Reply and nothing else: a parameter's new value, a rearming. A new message
/// of this sort needs no type of its own.
struct Confirmed : Asked<void> {};
/// A task or a run is to pause, to go on or to end.
struct Control : Asked<void> {
    /// What its new state says to the request; nothing while it is under way. `noun`: "task" or "run".
    template <class State>
    std::optional<Result<void>> answerTo(State state, const std::string& noun) const {
        if (isFinal(state)) {
            const bool unknown = state == State::Unknown;
            if (action == proto::CANCEL && !unknown) return Result<void>{};
            return Refusal{unknown ? RefusalCode::OutcomeUnknown : RefusalCode::WrongState,
                           "The " + noun + " has ended meanwhile: " + toString(state) + ".",
                           {}};
        }
        const bool reached = (action == proto::PAUSE && state == State::Paused) ||
                             (action == proto::RESUME && state == State::Running);
        return reached ? std::optional(Result<void>{}) : std::nullopt;
    }
    proto::TaskAction action = proto::TASK_ACTION_UNSPECIFIED;
};
/// What an entity tells of itself.
struct FetchDetails : Asked<Details> {};
/// A resource on its way; its credits are no answer, but make it wait longer.
struct Upload : Asked<void> {};
/// The first event of a task; of one whose lease was released, the last.
struct StartTask : Reported {};
/// An orphaned lease: until its Entity Manager has said whether it still is one, or its time is up.
struct ResumeLease : Reported {};
/// What became of the tasks of a lease that was resumed.
struct AskAfterTasks : Reported {
    std::vector<Id128> tasks;
};
/// The first event of a run; of one whose master was released, the last.
struct StartRun : Reported {};
/// What became of the runs whose master was resumed: asked again until it says so.
struct AskAfterRuns : Reported {
    std::vector<Id128> runs;
    TimePoint until;  ///< when it is given up
};
/// Of the front-end server, which is no entity.
struct FetchGlobalServices : Asked<GlobalServices> {};
/// The runs of which an entity was the master.
struct FetchRunRecords : Asked<std::vector<RunRecord>> {};

// What most requests do when their ground is gone, and which are different.

/// Otherwise OUTCOME_UNKNOWN when the connection is lost.
template <class One>
inline constexpr bool kOutlivesConnection = std::is_same_v<One, ResumeLease>;
/// Otherwise refused when the lease ends under which it was asked.
template <class One>
inline constexpr bool kOutlivesLease =
    std::is_same_v<One, Release> || std::is_same_v<One, StartTask> || std::is_same_v<One, StartRun>;
/// Otherwise refused when the entity leaves.
template <class One>
inline constexpr bool kOutlivesEntity =
    std::is_same_v<One, StartTask> || std::is_same_v<One, StartRun> || std::is_same_v<One, ResumeLease>;

/// In the order in which they are answered when an entity leaves or the connection is lost.
using Kind = std::variant<Release, Confirmed, Control, FetchDetails, Upload, StartTask, ResumeLease,
                          AskAfterTasks, StartRun, AskAfterRuns, FetchGlobalServices, FetchRunRecords>;

template <class One, std::size_t at = 0>
constexpr std::size_t indexOf() {
    if constexpr (std::is_same_v<One, std::variant_alternative_t<at, Kind>>) {
        return at;
    } else {
        return indexOf<One, at + 1>();
    }
}

}  // namespace request

/// The requests of a session that wait for an answer: who asked whom for what, and until when.
///
/// Each is found by its number and kind, by the sequence number of its message, by its entity and by its
/// deadline, and is answered exactly once: it is out of all of these before whoever asked is told. Threads:
/// none of its own, not thread-safe.
class Requests {
  public:
    struct Key {
        std::size_t kind;  ///< request::indexOf
        Id128 id;
        auto operator<=>(const Key&) const = default;
    };
    struct Pending {
        std::string entity;
        LeaseNumber lease = {};     ///< under which it was asked; {0, 0} = none
        std::int64_t sequence = 0;  ///< of its message; 0 = it is not told apart by that
        TimePoint deadline = {};    ///< left out = after the time-out
        request::Kind what = {};

        template <class One>
        One& as() {
            return std::get<One>(what);
        }
    };
    /// `refused`: a request under a lease was refused, which may mean that the lease is gone.
    using Refused = std::function<void(const std::string& entity, LeaseNumber under, const Refusal& why)>;

    Requests(const Clock& clock, Duration timeout, Refused refused)
        : clock_(clock), timeout_(timeout), refused_(std::move(refused)) {}

    template <class One>
    static Key keyOf(Id128 id) {
        return {request::indexOf<One>(), id};
    }
    // Ids and keys by value: callers may name them by the very key that goes away.
    void await(Id128 id, Pending pending);
    bool contains(const Key& key) const { return pending_.contains(key); }
    /// Null if it does not, or no longer, wait. Change its deadline with postpone(), its sequence with
    /// resend().
    Pending* find(Key key);
    template <class One>
    Pending* find(Id128 id) {
        return find(keyOf<One>(id));
    }
    /// To be answered by whoever takes it.
    std::optional<Pending> take(Key key);
    template <class One>
    std::optional<Pending> take(Id128 id) {
        return take(keyOf<One>(id));
    }
    /// Whether it waited.
    bool settle(Key key, const Result<void>& result);
    template <class One>
    bool settle(Id128 id, const Result<void>& result) {
        return settle(keyOf<One>(id), result);
    }
    void postpone(Key key, TimePoint deadline);
    /// Its message has been sent again, under this number.
    void resend(Key key, std::int64_t sequence);

    std::vector<Key> all() const;
    std::vector<Key> of(const std::string& entity) const;
    std::optional<Key> bySequence(std::int64_t sequence) const;
    /// One whose time is up.
    std::optional<Key> due(TimePoint now) const;
    TimePoint nextDeadline() const {
        return deadlines_.empty() ? TimePoint::max() : deadlines_.begin()->first;
    }
    std::size_t size() const { return pending_.size(); }

    /// Calls `use` with the request's own type.
    template <class Use>
    static auto visit(Pending& pending, Use&& use) {
        return std::visit(std::forward<Use>(use), pending.what);
    }

  private:
    const Clock& clock_;
    const Duration timeout_;
    const Refused refused_;
    std::map<Key, Pending> pending_;
    // Of pending_:
    std::set<std::pair<TimePoint, Key>> deadlines_;
    std::unordered_map<std::int64_t, Key> by_sequence_;
    std::unordered_map<std::string, std::set<Key>> of_entity_;
};

}  // namespace axon::client
