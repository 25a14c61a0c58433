// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/task.pb.h>

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "axon/types.hpp"
#include "client/core/core_context.hpp"
#include "client/core/requests.hpp"
#include "common/ids.hpp"

namespace axon::proto {
class EntityStatus;
}

namespace axon::client {

/// The tasks that this client has asked for, and their newest reports. Part of SessionCore.
///
/// A report never leaves a final state. A task that nobody answers for becomes Unknown, and is cancelled
/// where that is possible. Of those that are over the newest SessionCoreSettings::tasks_kept can still be
/// asked for.
class Tasks {
  public:
    explicit Tasks(const CoreParts& parts) : parts_(parts) {}

    /// The id of the new task; its refusal, should it be refused here, is told to the observer like any
    /// other.
    Id128 run(const Held& held, std::string_view service, const std::vector<Argument>& arguments,
              Duration not_after);
    /// PAUSE is done when the task is paused, RESUME when it runs, CANCEL when it has ended.
    void control(const Id128& task, proto::TaskAction action, Done done);
    /// Nothing for a task that is not, or no longer, known.
    std::optional<TaskReport> report(const Id128& task) const;
    bool contains(const Id128& task) const { return tasks_.contains(task); }

    // Those that are not final.
    bool anyOpen() const { return open_count_ > 0; }
    std::vector<Id128> open(const Held& held) const;
    void finishAll(const Held& held, const Refusal& unknown);
    /// Tasks under leases that are no longer held: nobody can ask about them.
    void finishUnheld(const Refusal& unknown);
    /// The lease was released: until they are final, or the time is up and they become Unknown.
    void awaitEnds(const Held& held);
    /// The lease was resumed.
    void askAfter(const Held& held);

    void onEvent(const std::string& entity, const proto::TaskEvent& event);
    /// Ids by value: callers may name them by the very key that goes away.
    void finish(Id128 task, TaskState state, const Refusal& why);
    /// Whether the status was the answer to askAfter().
    bool onAnswer(Id128 request, const proto::EntityStatus& status);
    /// The request for it was not answered in time.
    void onDue(Id128 task);
    void onAskAfterDue(Id128 request);

  private:
    struct Entry {
        Held held;
        TaskReport report;
    };
    void awaitEnd(Id128 task, const Entry& entry);
    void noteFinal(Id128 task);

    const CoreParts& parts_;
    std::unordered_map<Id128, Entry> tasks_;
    std::size_t open_count_ = 0;
    std::map<Held, std::set<Id128>> open_;  // those of tasks_ that are not final
    std::deque<Id128> finished_;
};

}  // namespace axon::client
