// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/stops/latch.hpp"

#include <utility>

#include "common/planted_bug.hpp"

namespace axon::entity_manager {

namespace {

/// There while nobody has stopped the robot since the last rearm. Its absence is the latch: a file can be
/// deleted on a full disk, and what is in doubt is latched.
constexpr const char* kRearmedKey = "rearmed";
/// Its absence means that somebody holds the entity, as with kRearmedKey.
constexpr const char* kFreeKey = "free";
constexpr const char* kThere = "1";

/// The server's stop on behalf of a client that leaves in an orderly way is not a call for help.
bool leavesInOrder(const Incident& incident, const Sender* holder) {
    return incident.cause == StopCause::Released && holder != nullptr && incident.head != nullptr &&
           holder->id == incident.head->sender.id;
}

bool mustComeUpLatched(bool was_latched, bool was_held, bool parts_lost) {
    // A person stopped the robot, and that this process was killed since is no word of a person.
    if (was_latched) return true;
    // The last life was broken off while somebody held the robot, which has stopped by itself: a loss like
    // the others.
    if (was_held && !AXON_PLANTED(LatchForgotten)) return true;
    return parts_lost;
}

bool mustBeKept(bool set, bool set_kept) {
    return set != set_kept && !AXON_PLANTED(LatchNotKept);
}

}  // namespace

bool mustLatch(const Incident& incident, const Sender* holder) {
    return !leavesInOrder(incident, holder) && !AXON_PLANTED(LatchForgotten);
}

bool mustStop([[maybe_unused]] const Incident& incident) {
    return !(AXON_PLANTED(LostServerDoesNotStop) && incident.event == Event::ServerDown);
}

void Latch::beginFirstLife(Storage& storage) {
    storage.save(kRearmedKey, kThere);
    storage.save(kFreeKey, kThere);
}

Latch::Latch(Storage& storage, bool parts_lost)
    : storage_(storage),
      set_kept_(storage.load(kRearmedKey) != kThere),
      free_kept_(storage.load(kFreeKey) == kThere),
      set_(mustComeUpLatched(set_kept_, !free_kept_, parts_lost)) {}

void Latch::granted() {
    // Not read from the journal, whose line may be lost with a full disk: a deletion is not.
    if (std::exchange(free_kept_, false)) storage_.forget(kFreeKey);
}

/// That the robot is free comes last: wherever the power is lost before, the next life finds it held or
/// latched.
void Latch::keep(bool held) {
    if (mustBeKept(set_, set_kept_)) {
        set_kept_ = set_;
        if (set_)
            storage_.forget(kRearmedKey);
        else
            storage_.keep(kRearmedKey, kThere);
    }
    if (!free_kept_ && !held) {
        free_kept_ = true;
        storage_.keep(kFreeKey, kThere);
    }
}

}  // namespace axon::entity_manager
