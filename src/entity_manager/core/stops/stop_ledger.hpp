// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "common/planted_bug.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/ports.hpp"
#include "entity_manager/ports/stop_generations.hpp"

namespace axon::entity_manager {

inline constexpr const char* kGenerationKey =
    "stop_generation";  ///< in the Storage, of how far lives have counted

/// Which stops were ordered, commanded to the robot application and confirmed by it; how far each has come,
/// and who is told so (safety.md, "What a receipt says").
///
/// It owns the strand's stop generation. StopGenerations gives every stop its generation on the signal
/// thread, which passes the stop on at once. The strand hears of it later, so for a moment StopGenerations is
/// ahead (`allHandled()` is false), and the answer of the application may overtake the news. It also owns
/// what is known of an application that was lost, because a receipt tells that when nobody can confirm the
/// stop.
///
/// Not here: the latch and what a stop does to tasks and lease, which are rows of the state table.
class StopLedger {
  public:
    /// `storage` has how far earlier lives have counted: this one begins above. Throws std::runtime_error
    /// where that value is damaged.
    StopLedger(Turn& turn, Storage& storage, StopGenerations& stop_generations, BackEndPort& back_end);

    // Generations.

    /// All stops up to this one have been handled by the strand.
    std::uint32_t generation() const { return generation_; }
    /// A command counts only if its sender had seen at least this one.
    std::uint32_t required() const { return required_; }
    /// Whether the strand has handled every stop that the signal thread has passed on.
    bool allHandled() const { return stop_generations_.generation() == generation_; }
    /// OK, or why a command whose sender had seen generation `seen` is not carried out.
    Refusal whyNot(std::int32_t seen) const;
    /// Whether the application has confirmed every stop, those included that the strand has not handled yet.
    bool standing() const { return !oneIsUnderWay() && confirmed_ >= commanded_; }
    /// Somebody has rearmed the robot.
    void rearmed();

    // The application.

    void linkUp();
    /// Call it before the link counts as down: `reason` is kept only where it was up.
    void linkDown(const std::string& reason, LinkEnd end);
    /// Whether a stop was ordered that no application has carried out. It is to be stopped once more when one
    /// links: it has stopped by itself when its link ended, but another process may be in its place.
    bool owed() const;
    /// Whether the application that is linked now is one that was lost.
    bool cameBack() const { return came_back_; }

    // Stops.

    /// Raises a stop of the Entity Manager's own and commands it. `voids`: commands that were sent before
    /// count no longer. Its generation.
    std::uint32_t order(StopCause cause, bool voids);
    /// A stop that the signal thread has raised and commanded has come to the strand.
    void arrived(std::uint32_t generation) { handled(generation, false, true); }
    /// What is told of a reset or a clear beside its stages.
    struct Ended {
        std::uint32_t tasks = 0;
        std::uint32_t removed = 0;
    };
    /// Opens its receipt and tells the first stage, to whoever asked for the stop and to the holder. `busy`:
    /// a task runs. True: it came before the application was linked, which has to be stopped once more
    /// (owed()).
    bool acknowledge(const Header& head, StopCause cause, std::uint32_t generation, bool busy,
                     std::optional<Ended> ended);
    /// A copy of a stop: its receipt is told again. `runs`: a task runs, which a copy from before the rearm
    /// must not seem to have stopped.
    void repeated(const Header& head, StopCause cause, std::uint32_t generation, bool runs);
    /// The application's answer, which may be ahead of the news of its stop.
    void answered(const proto::StopDone& done);
    /// Takes up answers that were ahead. Call after every event.
    void settle();

    /// A drill measures the way of a stop and changes nothing.
    void drill(const Header& head, std::uint32_t number);

  private:
    /// A stop and how far it has come. Kept beyond its last stage, for whoever asks again because a receipt
    /// was lost.
    struct Open {
        /// Nothing that is still to come changes what it says.
        bool over() const { return receipt.stage() >= proto::StopReceipt::STANDSTILL; }
        proto::StopReceipt receipt;
        std::vector<Sender> to;
        std::uint32_t drill = 0;  ///< its number, where it is one
        bool of_server = false;   ///< a drill of the entity server itself, which reads no payload
        bool moving = false;      ///< the robot was, as far as is known, when the stop came
        TimePoint at{};
    };
    /// An application that was linked and of which nobody knows whether it has stopped its robot.
    struct Lost {
        proto::StopReceipt::Absence how;
        std::string reason;
        TimePoint since;
    };

    /// A stop that the signal thread has passed on is still on its way to the strand.
    bool oneIsUnderWay() const { return !allHandled() && !AXON_PLANTED(StopsUnderWayOverlooked); }
    /// A command came too late: its sender, who had seen this generation, had not yet seen a stop that
    /// counts.
    bool isOutdated(std::uint32_t seen) const;
    /// Whether this answer takes an open stop a stage further. Counts one that tells of a standstill too
    /// early.
    bool mayAdvance(const Open& open, const proto::StopDone& done);
    void handled(std::uint32_t generation, bool own, bool voids);
    void stopDone(const proto::StopDone& done);
    void drillDone(std::uint32_t number);
    void faulted(const proto::StopDone& done);
    void forgetADrill();
    bool moving(bool busy) const;
    proto::StopReceipt receiptOf(const Header& head, StopCause cause, std::uint32_t generation) const;
    /// Its stage as it is now, to all who are told of it.
    void tellStage(const Open& open);
    void tellReceipt(const Open& open, proto::StopReceipt receipt);
    void describeAbsence(proto::StopReceipt& receipt) const;

    Turn& turn_;
    Storage& storage_;
    StopGenerations& stop_generations_;
    BackEndPort& back_end_;

    std::uint32_t generation_;
    std::uint32_t required_;
    std::uint32_t reserved_ =
        0;  ///< a next life begins here: no generation above it is told before it is raised
    std::vector<std::uint32_t>
        early_;                  ///< own stops above generation_, while one of the signal thread is under way
    std::uint32_t rearmed_ = 0;  ///< stops up to this one were rearmed after
    std::uint32_t commanded_ = 0;        ///< newest stop that the application must have been told
    std::uint32_t confirmed_ = 0;        ///< newest stop whose callback has returned
    std::uint32_t link_generation_ = 0;  ///< stops up to this one the linked application has never been sent
    std::vector<proto::StopDone> early_answers_;  ///< to stops above generation_
    std::deque<Open> stops_;                      ///< the newest, oldest first

    std::uint32_t drill_ = 0;       ///< newest drill that was heard of here
    std::uint32_t link_drill_ = 0;  ///< drills up to this one the linked application has never been sent
    std::deque<Open> drills_;
    std::vector<std::uint32_t> early_drills_;  ///< answered above drill_

    std::optional<Lost> lost_;
    bool link_kept_ = false;  ///< as the storage has it: an application has linked, and has not said good-bye
    bool came_back_ = false;
};

}  // namespace axon::entity_manager
