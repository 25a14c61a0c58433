// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstdint>

#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "entity_manager/core/turn/state_table.hpp"
#include "entity_manager/core/turn/turn.hpp"

namespace axon::entity_manager {

/// One event on its way through a row of the state table, and what the row's actions go by.
struct Incident {
    Event event;
    const Header* head = nullptr;     ///< of who asked, where somebody did
    proto::ToEntity* body = nullptr;  ///< of a client's message
    StopCause cause = StopCause::Unspecified;
    std::uint32_t generation = 0;  ///< of the stop, once it is known
    Refusal reason;                ///< what those are told who lose a task or a lease
    proto::CheckOutPhase phase = proto::CHECK_OUT_UNSPECIFIED;  ///< of a check-out that is granted
};

inline void Turn::fire(Event event) {
    Incident incident{event};
    fire(incident);
}

}  // namespace axon::entity_manager
