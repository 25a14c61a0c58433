// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/core/tasks/task_queue.hpp"

namespace axon::entity_manager {

/// For people: "part 2 of 3, Turning".
std::string partText(const ServiceProfiler& profiler, const Task& task, std::size_t part);

/// A task that has begun: the robot application has been given it, or, of a composite, one part after the
/// other. To the application each part is a task of its own; to everybody else the whole is one task
/// (docs/reference/profiles.md). A plain value with what follows from it; `profiler` is that of the entity.
struct ActiveTask {
    enum class Phase : std::uint8_t { Dispatched, Running, Paused };

    const ServiceProfiler::Order& order() const { return task.plan.parts[part]; }
    bool lastPart() const { return part + 1 == task.plan.parts.size(); }
    std::string partText(const ServiceProfiler& profiler) const {
        return entity_manager::partText(profiler, task, part);
    }
    /// Of the whole, 0 to 1: the parts that are done, and the present one as far as it says (`of_part`). Of a
    /// simple task what it says itself.
    double progress(double of_part = -1) const;
    /// Of a composite: makes what the application has said of the present part a word about the whole.
    void nameAsWhole(const ServiceProfiler& profiler, proto::TaskEvent& event) const;
    void keepResults(const ServiceProfiler& profiler, const proto::TaskEvent& event);
    /// The end of the whole, with the results of all parts. What the application has said of it, if anything,
    /// has been through nameAsWhole().
    void endAsWhole(const ServiceProfiler& profiler, proto::TaskEvent& event) const;

    // Without its client (ADR 0014). `grace`: a lost client may come back.
    /// What holds for the task as it is now; whatever is in doubt stops.
    proto::OnClientLoss lossPolicy(const ServiceProfiler& profiler, bool grace) const;
    /// What the profile says of the present part: the strictest of its service and of the composites around
    /// it.
    proto::OnClientLoss lossPolicyOfParts(const ServiceProfiler& profiler, bool grace) const;
    /// How long the present part may go on alone, from now on; the whole no longer than its own allows.
    TimePoint finishesUntil(const ServiceProfiler& profiler, TimePoint now) const;

    Task task;
    Phase phase = Phase::Dispatched;  ///< of the whole
    bool halted = false;              ///< by a reset: its end lets the queue go on
    bool cancelled = false;           ///< asked for: no further part begins
    bool hold = false;                ///< a pause was asked for: no further part begins before it is resumed
    std::size_t part = 0;             ///< the present one
    std::optional<Id128> sent;        ///< the id under which the application has it; none between two parts
    bool answered = false;            ///< the application has granted it
    TimePoint answer_until{};         ///< while it has not
    std::optional<TimePoint> alone_until;   ///< without its client: then it is stopped
    std::optional<TimePoint> finish_until;  ///< likewise, of the whole, whatever its parts are allowed
    std::vector<proto::Param> results;      ///< of the parts of a composite, "Part.Name", the newest of each
};

}  // namespace axon::entity_manager
