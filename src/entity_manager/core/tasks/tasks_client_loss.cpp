// SPDX-License-Identifier: GPL-2.0-or-later
// What becomes of running tasks when their client is lost (docs/adr/0014-client-loss-policy.md).
#include <algorithm>
#include <chrono>

#include "common/planted_bug.hpp"
#include "entity_manager/core/tasks/tasks.hpp"
#include "messages/text.hpp"

namespace axon::entity_manager {

namespace {

/// How long the robot application may take to report that a held task is paused.
constexpr Duration kPauseWithin = std::chrono::seconds{1};

}  // namespace

bool Tasks::survivesClientLoss() const {
    // A step of a run is of more than one robot: nobody would tell the others.
    return turn_.state() == EntityState::BUSY && !others_.takesPart() && turn_.linked() &&
           turn_.connected() && !turn_.latched() && !application_busy_ && !active_.empty() &&
           turn_.stops().all_handled &&
           std::all_of(active_.begin(), active_.end(),
                       [this](const ActiveTask& active) { return lossPolicyOf(active) != proto::STOP_TASK; });
}

void Tasks::spare() {
    for (auto& active : active_) {
        if (lossPolicyOf(active) == proto::FINISH_TASK) {
            active.finish_until =
                turn_.now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(
                                  profiler_.record(active.task.plan.service).max_duration_s()));
            active.alone_until = AXON_PLANTED(FinishWithoutEnd) ? TimePoint::max() : finishesUntil(active);
            continue;
        }
        active.hold = true;
        if (active.phase == ActiveTask::Phase::Paused || AXON_PLANTED(HeldTaskGoesOn)) continue;
        active.alone_until = turn_.now() + kPauseWithin;
        proto::EmToEi pause;
        pause.mutable_pause()->set_task_id(active.sent->bytes());
        pause.mutable_pause()->set_stop_generation(turn_.stops().generation);
        turn_.toApplication(pause);
    }
}

void Tasks::attend() {
    for (auto& active : active_) {
        active.alone_until.reset();
        active.finish_until.reset();
    }
}

/// A task without its client has changed between running and paused.
void Tasks::watchHeld(ActiveTask& active) {
    if (!turn_.orphaned() || lossPolicyOf(active) != proto::HOLD_TASK || AXON_PLANTED(HeldTaskGoesOn)) return;
    if (active.phase == ActiveTask::Phase::Paused)
        active.alone_until.reset();
    else if (!active.alone_until)
        active.alone_until = turn_.now() + kPauseWithin;
}

bool Tasks::finishesAlone() const {
    return std::any_of(active_.begin(), active_.end(), [this](const ActiveTask& active) {
        return active.alone_until && !active.halted && lossPolicyOfParts(active) == proto::FINISH_TASK;
    });
}

void Tasks::endSpared(const std::string& why) {
    if (active_.empty()) return;
    Incident lost{Event::ClientLost};
    lost.cause = StopCause::ClientLost;
    lost.reason = {RefusalCode::ClientLost, why, {}};
    turn_.fire(lost);
}

void Tasks::expireSpared() {
    const auto late = std::find_if(active_.begin(), active_.end(), [this](const ActiveTask& active) {
        return active.alone_until && turn_.now() >= *active.alone_until;
    });
    if (late == active_.end()) return;
    const auto service = inQuotes(late->task.service);
    endSpared(lossPolicyOfParts(*late) == proto::FINISH_TASK
                  ? "The client was lost, and " + service +
                        " has gone on without it for as long as max_duration allows."
                  : "The client was lost, and the robot application has not paused " + service + '.');
}

}  // namespace axon::entity_manager
