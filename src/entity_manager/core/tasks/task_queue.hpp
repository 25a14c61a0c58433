// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/result.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/ports/later.hpp"

namespace axon::entity_manager {

/// An accepted task: all its checks are behind it. That of a composite service is one task with several
/// parts.
struct Task {
    Id128 id;
    std::string service;  ///< its name in the profile
    bool blocking = true;
    ServiceProfiler::Plan plan;
    std::uint32_t generation =
        0;  ///< stop generation under which it was accepted; it is void under any other
    std::optional<TimePoint> not_after;

    // Once nothing but the disk is in its way.
    std::optional<Later<std::vector<std::string>>> looked;  ///< for its files: those that are not there
    std::optional<Later<bool>> noted;                       ///< its entry in the journal
    std::optional<TimePoint> tell_at;                       ///< then its client is told that it waits
    bool preparing() const { return looked.has_value(); }
};

/// The tasks that wait, in the order of their arrival.
///
/// Threads: the core's strand. Bounded: mayPush() refuses with QUEUE_FULL.
class TaskQueue {
  public:
    explicit TaskQueue(std::size_t bound) : bound_(bound) {}

    /// QUEUE_FULL, without taking anything.
    Refusal mayPush() const;
    /// After mayPush().
    void push(Task task);

    bool empty() const { return waiting_.empty(); }
    std::size_t size() const { return waiting_.size(); }
    const std::deque<Task>& waiting() const { return waiting_; }
    std::deque<Task>& waiting() { return waiting_; }
    Task& front() { return waiting_.front(); }
    const Task& front() const { return waiting_.front(); }
    Task pop();
    std::optional<Task> remove(const Id128& id);
    /// All of them, in order; the queue is empty then.
    std::deque<Task> clear();
    /// Those whose time has passed, in order.
    std::vector<Task> expire(TimePoint now);
    std::optional<TimePoint> nextExpiry() const;
    /// After a stop that does not void the queue: what waits is valid under this generation.
    void restamp(std::uint32_t generation);

  private:
    std::size_t bound_;
    std::deque<Task> waiting_;
};

}  // namespace axon::entity_manager
