// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/collaboration.pb.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"

namespace axon::collaboration {

inline constexpr int kStepsMax = 1'000;
inline constexpr int kParticipantsMax = 256;
inline constexpr int kProblemsMax = 50;

/// No other state follows a final one.
inline bool isFinal(proto::TaskState state) {
    return state >= proto::TASK_SUCCEEDED;
}

/// Stands for `count` problems that are not reported one by one.
proto::Problem andMore(int count);

/// Times that a master keeps.
struct Pace {
    /// A participant that is silent for this long is lost. It is sent five heartbeats within this time, or
    /// within its own watchdog time if that is shorter.
    Duration watchdog = std::chrono::milliseconds{250};
    /// For the answer to an invitation, and for the first word about a step that was ordered.
    Duration answer_within = std::chrono::seconds{5};
    /// The time that a step has to end or to pause when it is told to, and a step of the compensation to
    /// begin when its participant can. After it, all participants are stopped.
    Duration end_within = std::chrono::seconds{10};
    /// The shortest time between events that report only steps. An event costs the master about as much as an
    /// order.
    Duration event_period = std::chrono::milliseconds{10};
};

/// The period of the heartbeats between two peers with these watchdog times: a fifth of the shorter one, but
/// never less than the shortest configurable watchdog allows. `other_ms` is the peer's; 0 = not known.
Duration beatPeriod(Duration own, std::uint32_t other_ms);

/// Whether this reason means that somebody ended the run on purpose, or that the responsible client or server
/// has gone. Every other reason is a failure.
bool isStop(const Refusal& reason);

/// One run of a global service, as its master sees it (thesis 3.3.1 COLLAB; docs/adr/0019-collaboration.md):
/// whom it asked, which steps are under way, what becomes of the rest when one fails.
///
/// Where in the flow: inside the Entity Manager of the master. The client's request and what the participants
/// say go in; orders to participants and events for the client come out. The master's own entity is a
/// participant like the others, so it makes no difference which of them is the master. States: checking →
/// running ⇄ paused | held → (stopping → compensating) → one of the final ones. Threads: one strand. Time is
/// given with each call. Bounded: kStepsMax, kParticipantsMax. Failure: refusals, and the final state.
class Collaboration {
  public:
    /// One message to a participant, in the order in which they are to be sent.
    struct Order {
        std::size_t participant;
        proto::FromMaster message;
    };

    /// What is wrong with the request itself, whoever the participants are; empty = it can be carried out by
    /// `self` as the master. `root` is that of the master's own lease.
    static std::vector<proto::Problem> problemsOf(const proto::CollaborationRequest& request,
                                                  const std::string& self, const std::string& root);

    /// After problemsOf(). Nobody hears of it before begin(). `by` is the client's name.
    Collaboration(proto::CollaborationRequest request, std::string self, std::string by, RandomSource& random,
                  Pace pace, TimePoint now);
    /// Invites everybody; once, and not when it is over.
    void begin(TimePoint now);

    // From a participant (UUID of an entity); of others nothing is believed.
    void hear(const std::string& entity, const proto::FromSlave& message, TimePoint now);
    /// The server could not deliver to it, or it has taken its leave without saying so.
    void lose(const std::string& entity, const Refusal& reason, TimePoint now);

    // From the client; a refusal changes nothing.
    /// WRONG_STATE; NOT_PAUSABLE names the steps that cannot be paused.
    Refusal pause(TimePoint now);
    /// Of a paused run, and of a held one: then what failed or was cancelled is tried again.
    Refusal resume(TimePoint now);
    /// What runs is cancelled, and the run ends when it has ended.
    Refusal cancel(TimePoint now);
    /// The master itself takes part no more: everybody is stopped, and the run is over.
    void abandon(proto::RunState outcome, const Refusal& reason, TimePoint now);

    void onTimer(TimePoint now);
    TimePoint nextDeadline() const;

    bool over() const { return state_ >= proto::RUN_SUCCEEDED; }
    proto::RunState state() const { return state_; }
    const std::string& id() const { return request_.run_id(); }
    Duration beatEvery(std::size_t participant) const { return members_[participant].beat_every; }
    const proto::CollaborationRequest& request() const { return request_; }
    const proto::Participant& participant(std::size_t index) const {
        return request_.participants(static_cast<int>(index));
    }
    bool isSelf(std::size_t index) const { return participant(index).entity() == self_; }

    std::vector<Order> takeOrders() { return std::exchange(orders_, {}); }
    /// What has changed since the last one; nothing when nothing has, or only steps and it is not their time
    /// yet.
    std::optional<proto::RunEvent> takeEvent(TimePoint now);
    /// As it is now.
    proto::RunRecord record(TimePoint now) const;

  private:
    enum class Want : std::uint8_t { Run, Pause, End };
    struct Step {
        const proto::GlobalStep* declared = nullptr;
        std::size_t participant = 0;
        proto::StepStatus status;
        std::string task_id;   ///< of the present try; empty = not ordered
        double ordered_s = 0;  ///< since the launch
        Want want = Want::Run;
        Want told = Want::Run;  ///< the last that its participant was told
        bool pausable = false;
        bool changed = true;    ///< since the last event
        bool heard = false;     ///< of this try
        bool given_up = false;  ///< nothing was heard of it: UNKNOWN, and it may run all the same
        TimePoint answer_until{};
        TimePoint obey_until{};  ///< while another thing is wanted of it than that it runs
        bool active() const { return !task_id.empty() && status.state() < proto::TASK_SUCCEEDED; }
        /// Its participant may be busy with it.
        bool open() const { return active() || given_up; }
    };
    struct Member {
        enum class Stage : std::uint8_t { Invited, In, Out };
        Stage stage = Stage::Out;  ///< until begin()
        std::uint32_t stop_generation = 0;
        TimePoint heard{};
        Duration beat_every{};
        TimePoint beat_at{};
        TimePoint begin_until{};  ///< of a compensation: while none of its steps runs
    };

    std::optional<std::size_t> indexOf(const std::string& entity) const;
    proto::FromMaster& send(std::size_t participant);
    void enter(proto::RunState state);
    void answered(std::size_t participant, const proto::InvitationAnswer& answer, TimePoint now);
    void reported(std::size_t participant, const proto::StepReport& report, TimePoint now);
    void depart(std::size_t participant, const Refusal& reason, TimePoint now);
    void beginLevel(TimePoint now);
    void order(Step& step, TimePoint now);
    void attend(Step& step, TimePoint now);
    void ask(Step& step, Want want, TimePoint now);
    void wantOfAll(Want want, TimePoint now, bool pause_where_possible = false);
    /// When a step that does not do what it was told, or does not begin, ends the run; max() = it does.
    TimePoint patienceWith(const Step& step) const;
    void fail(const Step* step, const Refusal& reason, TimePoint now);
    void advance(TimePoint now);
    void compensate(TimePoint now);
    void endAll(bool stop, const Refusal& reason);
    void conclude(proto::RunState state, bool stop, const Refusal& reason);
    void giveUp(Step& step, TimePoint now);
    void note(proto::Problem found);
    bool anyOpen() const;
    bool anyChanged() const;
    std::string titled(const Step& step, const std::string& message) const;
    std::size_t firstCompensation() const {
        return static_cast<std::size_t>(request_.service().steps_size());
    }
    double progress() const;
    double since(TimePoint now) const;

    const proto::CollaborationRequest request_;
    const std::string self_, by_;
    RandomSource& random_;
    const Pace pace_;
    TimePoint launched_;

    proto::RunState state_ = proto::RUN_CHECKING;
    std::vector<Step> steps_;      ///< the compensation's after the service's
    std::vector<Member> members_;  ///< as in the request
    std::vector<std::int32_t> levels_;
    std::size_t level_ = 0;
    Refusal reason_;
    proto::RunState outcome_ = proto::RUN_UNSPECIFIED;  ///< of what is stopping or compensating
    bool compensates_ = false;                          ///< once all that runs has ended
    TimePoint end_until_{};
    TimePoint event_at_{};  ///< not before this, of steps alone
    std::uint64_t beat_ = 0;
    std::optional<TimePoint> ended_;
    std::vector<proto::Problem> problems_;  ///< the first kProblemsMax
    int more_problems_ = 0;
    bool changed_ = true;  ///< more than steps
    std::uint64_t sequence_ = 0;
    std::vector<Order> orders_;
};

}  // namespace axon::collaboration
