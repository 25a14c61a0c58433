// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "common/routed.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// Whether this stop or loss latches the robot, where its row of the state table says that such a one does
/// (ADR 0022). `holder`: who holds the robot; null = nobody.
bool mustLatch(const Incident& incident, const Sender* holder);

/// Whether the robot is stopped, where the row of the incident says that such a one stops it: always, but in
/// an Entity Manager with a planted bug.
bool mustStop(const Incident& incident);

/// Whether the robot is latched: nothing moves it before somebody has rearmed it.
///
/// It also keeps in the Storage what the next life goes by: the latch, and whether somebody holds the robot.
/// A life that comes after a latch, or after one that was broken off under a holder, begins latched. Threads:
/// the core's strand. Nothing here but the constructor and beginFirstLife() waits for the disk.
class Latch {
  public:
    /// For an entity that is new: it has neither been stopped nor held.
    static void beginFirstLife(Storage& storage);

    /// `parts_lost`: the state folder is not complete, so nobody knows what an earlier life has kept.
    Latch(Storage& storage, bool parts_lost);

    bool isSet() const { return set_; }
    void set() { set_ = true; }
    /// Somebody has rearmed the robot.
    void release() { set_ = false; }
    /// Somebody is granted the robot: from now on the Storage says so.
    void granted();
    /// Call it after the effects of an event, so that none of them waits for the disk: a rearm that the disk
    /// loses leaves the latch. `held`: somebody holds the robot.
    void keep(bool held);

  private:
    Storage& storage_;
    bool set_kept_;   ///< as the storage has it
    bool free_kept_;  ///< likewise; false from the moment at which somebody is granted the robot
    bool set_;
};

}  // namespace axon::entity_manager
