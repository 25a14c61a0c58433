// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/ids.hpp"
#include "common/refusal.hpp"
#include "common/result.hpp"
#include "entity_manager/core/journal/journal_writer.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/core/services/task_memory.hpp"
#include "entity_manager/core/tasks/active_task.hpp"
#include "entity_manager/core/tasks/task_queue.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/ports.hpp"
#include "entity_manager/ports/stop_generations.hpp"

namespace axon::entity_manager {

/// The entity's tasks from the request to the end: what waits, what has begun, and what has ended here while
/// the robot application still has to say that its handler has returned.
///
/// A task is accepted once, in order of arrival dispatched when nothing excludes it and all that must be on
/// the disk is there, and ended once: noted, remembered and told to who asked for it. Nothing is dispatched
/// while latched, before the last stop is confirmed, or under another stop generation than the newest. What
/// goes on while its client is lost is judged here too (ADR 0014); whether a loss stops the robot is a row of
/// the state table. Threads: the core's strand.
class Tasks final : public Owner {
  public:
    struct Settings {
        std::size_t queue_bound;
        Duration answer_within;  ///< for the robot application to grant or deny a task
        Duration grace;          ///< for which a lost client may come back; 0 = none
    };
    /// What it asks of other owners.
    class Others {
      public:
        virtual ~Others() = default;
        /// Whether the entity takes part in a run.
        virtual bool takesPart() const = 0;
        /// Whether it takes tasks of a master alone: also before the run that it leads has begun.
        virtual bool isReserved() const = 0;
        /// What a task tells. True: it was a step of a run, and its master has been told, or will be.
        virtual bool tellStep(proto::TaskEvent& event) = 0;
        /// For resources that have come since without a word; the answer may come later.
        virtual void lookAgain() = 0;
        /// A file that a task had for itself, unless another is being put in its place.
        virtual void removeResource(const std::string& service, const std::string& resource) = 0;
    };
    Tasks(Turn& turn, Others& others, JournalWriter& journal, BackEndPort& back_end, ResourceStore& store,
          StopGenerations& stop_generations, RandomSource& random, ServiceProfiler& profiler,
          TaskMemory& memory, Settings settings);

    // Actions of the state table.

    /// A client's task.
    void consider(const Incident& incident);
    void refuse(const Incident& incident, const Refusal& refusal);
    /// OK, or why it is not accepted. `sent_at_us`: by the clock of who asks.
    Refusal admit(const proto::TaskRequest& request, std::int64_t sent_at_us);
    /// Pause, resume and cancel.
    void control(const Incident& incident);
    void dispatchNext();
    /// This side ends them. `linger`: the robot application still has to say that their handlers have
    /// returned.
    void end(const Incident& incident, proto::TaskState state, bool linger);
    void voidQueue(const Incident& incident);
    /// A reset: what has begun ends, and the queue goes on.
    void halt();
    /// The client is lost, and what has begun goes on without it.
    void spare();

    // The robot application.

    void answered(const proto::TaskAnswer& answer);
    void updated(proto::TaskEvent& update);
    void applicationIs(const proto::StatusNote& note);
    /// Busy by its own account.
    bool applicationBusy() const { return application_busy_; }
    void applicationStopped() { application_busy_ = false; }
    /// The link has come or gone: nothing is left to be waited for.
    void linkChanged() {
        lingering_.clear();
        application_busy_ = false;
    }
    /// It has not been told yet whether the robot is busy.
    void linkIsNew() { busy_told_ = false; }

    // A stop, and the client.

    /// What waits is valid after a stop that does not void it; unless one is under way that does.
    void restamp();
    /// A new value of a CONFIG parameter, to the application and to all that has been accepted.
    void reconfigure(int service, const proto::Param& param);
    /// TOO_LARGE where what has been accepted could not be sent with it.
    Refusal leavesRoom(int service, const proto::Param& param) const;
    /// Whether all that has begun may go on without its client. Of several that run side by side the
    /// strictest counts: a stop cannot leave one of them out.
    bool survivesClientLoss() const;
    /// Whether one goes on to its end while its client is lost.
    bool finishesAlone() const;
    /// The loss of the client, as late as the policy of the tasks has allowed.
    void endSpared(const std::string& why);
    /// Its client is back and answers for them again. What was held stays paused until the client resumes it.
    void attend();
    /// To a holder that was away since `lost_at`: how the tasks of its lease have ended, again.
    void tellFinals(TimePoint lost_at);

    // What is.

    std::size_t begun() const { return active_.size(); }
    std::size_t waiting() const { return queue_.size(); }
    /// Granted ones: what has only been dispatched does not make BUSY.
    bool anyRuns() const;
    /// As far as is known: the robot application has been told to beat fast.
    bool robotMoves() const { return busy_told_; }
    void describe(proto::EntityStatus& status) const;

    // Time.

    /// After every event, and after dispatchNext(): how fast the link has to beat, and what a loss would
    /// mean.
    void settle();
    void onTimer() override;
    TimePoint nextDeadline() const override;
    void shutDown();

  private:
    /// A task whose end has been told to the client, and of which the robot application has not yet said that
    /// its handler has returned. Nothing that excludes it is dispatched before.
    struct Lingering {
        Id128 id;  ///< that the application knows
        int service;
        bool blocking;
    };

    bool mayStart() const;
    bool isOvertakenByAStop(const Task& task) const;
    bool admissible(const Task& task) const;
    Result<bool> prepare(Task& task);
    Refusal missingFiles(const Task& task);
    void refusePrepared(const Refusal& refusal);
    void tellHeldUp();
    void dispatch(Task task);
    void sendPart(ActiveTask& active);
    std::size_t dispatchBytes(const ServiceProfiler::Plan& plan, std::size_t from) const;
    ActiveTask* findActive(const Id128& id);
    ActiveTask* findSent(const Id128& id);
    void granted(ActiveTask& active);
    bool goOn(std::size_t at, proto::TaskEvent& event);
    void continueParts();
    void controlBetweenParts(ActiveTask& active);
    void endTask(std::size_t at, proto::TaskEvent event);
    void endTask(std::size_t at, proto::TaskState state, const Refusal& reason);
    /// It is gone from active_.
    void taskGone();
    void leaveService(const Task& task, bool clear);
    void markExecuting(const Task& task);
    bool lingeringEnded(const Id128& id);
    /// To who asked for the task: the holder, or the master of the run of which it is a step.
    void tellTask(proto::TaskEvent& event);
    void sendTask(const Task& task, proto::TaskState state, const Refusal& reason);
    /// The one way in which an accepted task ends: noted, remembered, and told to the holder.
    void concludeTask(const Task& task, proto::TaskEvent& event);
    void watchHeld(ActiveTask& active);
    void expireQueue();
    void expireAnswers();
    void expireSpared();
    bool grace() const { return settings_.grace > Duration::zero(); }
    proto::OnClientLoss lossPolicyOf(const ActiveTask& active) const {
        return active.lossPolicy(profiler_, grace());
    }
    proto::OnClientLoss lossPolicyOfParts(const ActiveTask& active) const {
        return active.lossPolicyOfParts(profiler_, grace());
    }
    TimePoint finishesUntil(const ActiveTask& active) const {
        return active.finishesUntil(profiler_, turn_.now());
    }

    Turn& turn_;
    Others& others_;
    JournalWriter& journal_;
    BackEndPort& back_end_;
    ResourceStore& store_;
    StopGenerations& stop_generations_;
    RandomSource& random_;
    ServiceProfiler& profiler_;
    TaskMemory& memory_;
    const Settings settings_;
    TaskQueue queue_;
    std::vector<ActiveTask> active_;
    std::vector<Lingering> lingering_;
    bool application_busy_ = false;  ///< by its own account (setStatus)
    bool busy_told_ = false;
};

}  // namespace axon::entity_manager
