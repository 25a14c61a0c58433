// SPDX-License-Identifier: GPL-2.0-or-later
// What becomes of running tasks when their client is lost (docs/adr/0014-client-loss-policy.md).
#include <algorithm>
#include <chrono>

#include "common/planted_bug.hpp"
#include "entity_manager/machine.hpp"
#include "messages/text.hpp"

namespace axon::entity_manager {

namespace {

/// How long the robot application may take to report that a held task is paused.
constexpr Duration kPauseWithin = std::chrono::seconds{1};

}  // namespace

/// What holds for the task as it is now; whatever is in doubt stops.
proto::OnClientLoss EntityManagerCore::Machine::lossPolicyOf(const Active& active) const {
    const bool begins = !active.answered && active.phase != Active::Phase::Paused;
    return begins || active.halted ? proto::STOP_TASK : lossPolicyOfParts(active);
}

/// What the profile says of the present part: the strictest of its service and of the composites around it.
proto::OnClientLoss EntityManagerCore::Machine::lossPolicyOfParts(const Active& active) const {
    auto strictest = proto::FINISH_TASK;
    for (const auto position : active.order().way) {
        const auto& service = profiler_.record(position);
        if (service.on_client_loss() == proto::FINISH_TASK && service.max_duration_s() <= 0)
            return proto::STOP_TASK;
        strictest = std::min(strictest, service.on_client_loss());
        // Who comes back resumes the whole.
        if (strictest == proto::HOLD_TASK && !profiler_.record(active.task.plan.service).is_pausable())
            return proto::STOP_TASK;
    }
    return strictest == proto::HOLD_TASK && settings_.lease_grace <= Duration::zero() ? proto::STOP_TASK
                                                                                      : strictest;
}

/// How long the present part may go on alone, from now on; the whole no longer than its own allows.
TimePoint EntityManagerCore::Machine::finishesUntil(const Active& active) const {
    auto most = profiler_.record(active.order().service).max_duration_s();
    for (const auto position : active.order().way)
        most = std::min(most, profiler_.record(position).max_duration_s());
    const auto until =
        clock_.now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(most));
    return active.finish_until ? std::min(until, *active.finish_until) : until;
}

/// Of several that run side by side the strictest counts: a stop cannot leave one of them out.
bool EntityManagerCore::Machine::survivesClientLoss() const {
    // A step of a run is of more than one robot: nobody would tell the others.
    return state_ == EntityState::BUSY && !teamwork_.takesPart() && link_up_ && connected() && !latched_ &&
           !application_busy_ && !active_.empty() && stops_.allHandled() &&
           std::all_of(active_.begin(), active_.end(),
                       [this](const Active& active) { return lossPolicyOf(active) != proto::STOP_TASK; });
}

void EntityManagerCore::Machine::loseHolder(Incident& incident) {
    incident.event = survivesClientLoss() ? Event::ClientSpared : Event::ClientLost;
    fire(incident);
}

void EntityManagerCore::Machine::spareTasks() {
    for (auto& active : active_) {
        if (lossPolicyOf(active) == proto::FINISH_TASK) {
            active.finish_until =
                clock_.now() + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(
                                   profiler_.record(active.task.plan.service).max_duration_s()));
            active.alone_until = AXON_PLANTED(FinishWithoutEnd) ? TimePoint::max() : finishesUntil(active);
            continue;
        }
        active.hold = true;
        if (active.phase == Active::Phase::Paused || AXON_PLANTED(HeldTaskGoesOn)) continue;
        active.alone_until = clock_.now() + kPauseWithin;
        proto::EmToEi pause;
        pause.mutable_pause()->set_task_id(active.sent->bytes());
        pause.mutable_pause()->set_stop_generation(stops_.generation());
        back_end_.send(pause);
    }
}

/// Its client is back and answers for it again. What was held stays paused until the client resumes it.
void EntityManagerCore::Machine::attendTasks() {
    for (auto& active : active_) {
        active.alone_until.reset();
        active.finish_until.reset();
    }
}

/// A task without its client has changed between running and paused.
void EntityManagerCore::Machine::watchHeld(Active& active) {
    if (!orphaned() || lossPolicyOf(active) != proto::HOLD_TASK || AXON_PLANTED(HeldTaskGoesOn)) return;
    if (active.phase == Active::Phase::Paused)
        active.alone_until.reset();
    else if (!active.alone_until)
        active.alone_until = clock_.now() + kPauseWithin;
}

bool EntityManagerCore::Machine::finishesAlone() const {
    return std::any_of(active_.begin(), active_.end(), [this](const Active& active) {
        return active.alone_until && !active.halted && lossPolicyOfParts(active) == proto::FINISH_TASK;
    });
}

/// The loss of the client, as late as the policy of the task has allowed.
void EntityManagerCore::Machine::endSpared(const std::string& why) {
    if (active_.empty()) return;
    Incident lost{Event::ClientLost};
    lost.cause = StopCause::ClientLost;
    lost.reason = {RefusalCode::ClientLost, why, {}};
    fire(lost);
}

void EntityManagerCore::Machine::expireSpared() {
    const auto late = std::find_if(active_.begin(), active_.end(), [this](const Active& active) {
        return active.alone_until && clock_.now() >= *active.alone_until;
    });
    if (late == active_.end()) return;
    const auto service = inQuotes(late->task.service);
    endSpared(lossPolicyOfParts(*late) == proto::FINISH_TASK
                  ? "The client was lost, and " + service +
                        " has gone on without it for as long as max_duration allows."
                  : "The client was lost, and the robot application has not paused " + service + '.');
}

}  // namespace axon::entity_manager
