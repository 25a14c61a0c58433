// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstddef>
#include <string>
#include <utility>

#include "common/routed.hpp"
#include "entity_manager/core/presence/readiness.hpp"
#include "entity_manager/core/services/task_memory.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/turn.hpp"

namespace axon::entity_manager {

/// How the entity is, put together from all who know a part of it.
///
/// Servers get the short form, which they pass on to every client, and may compare it with the one before. A
/// client that asks gets the long one: with the tasks, the margins of the watchdogs, its services if it wants
/// them, and, where it is the holder, how the tasks of its lease have ended. Nothing is kept here. Threads:
/// the core's strand.
class StatusReport {
  public:
    /// What it asks of other owners.
    class Others {
      public:
        virtual ~Others() = default;
        /// How many clients are in the wait list.
        virtual std::size_t waitingClients() const = 0;
        /// By whom an entity that is free was taken from the last holder, and why; empty where it was not.
        virtual const std::string& takenFromHolder() const = 0;
        /// The services as they are now, and what is wrong with their values and profiles.
        virtual void describeServices(proto::EntityStatus& status) = 0;
        /// Tasks and watchdogs.
        virtual void describeWork(proto::EntityStatus& status) const = 0;
    };
    /// `entity`: its UUID.
    StatusReport(Turn& turn, Others& others, const Readiness& readiness, const TaskMemory& memory,
                 std::string entity)
        : turn_(turn), others_(others), readiness_(readiness), memory_(memory), entity_(std::move(entity)) {}

    EntityStatus forServers() const;
    /// Action of the state table: the answer to a request for the status.
    void answer(const Incident& incident);

  private:
    Turn& turn_;
    Others& others_;
    const Readiness& readiness_;
    const TaskMemory& memory_;
    const std::string entity_;
};

}  // namespace axon::entity_manager
