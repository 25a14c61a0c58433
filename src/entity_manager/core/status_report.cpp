// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/status_report.hpp"

#include <cstdint>

namespace axon::entity_manager {

EntityStatus StatusReport::forServers() const {
    EntityStatus status;
    status.entity = entity_;
    status.state = turn_.state();
    status.latched = turn_.latched();
    status.stop_generation = static_cast<std::int32_t>(turn_.stops().generation);
    if (const auto* held = turn_.held()) {
        status.holder = held->holder;
        status.held = held->number;
    }
    status.orphaned = turn_.orphaned();
    status.waiting = static_cast<std::int32_t>(others_.waitingClients());
    status.reason =
        status.state == EntityState::IDLE ? others_.takenFromHolder() : readiness_.whyNot(status.state);
    return status;
}

void StatusReport::answer(const Incident& incident) {
    const auto& asked = incident.body->status_request();
    proto::ToClient message;
    auto& status = *message.mutable_status();
    status.set_state(static_cast<proto::EntityState>(static_cast<int>(turn_.state()) + 1));
    status.set_latched(turn_.latched());
    status.set_stop_generation(turn_.stops().generation);
    const auto* held = turn_.held();
    if (held != nullptr) status.set_holder(named(held->holder));
    status.set_orphaned(turn_.orphaned());
    status.set_waiting(static_cast<std::uint32_t>(others_.waitingClients()));
    status.set_reason(readiness_.whyNot(turn_.state()));
    status.set_request_id(asked.request_id());
    if (asked.with_services()) others_.describeServices(status);
    others_.describeWork(status);
    if (held != nullptr && held->holder.id == incident.head->sender.id)
        for (auto& ended : memory_.finals(held->number)) status.add_ended()->Swap(&ended);
    turn_.tell(incident.head->sender, kMsgStatus, message);
}

}  // namespace axon::entity_manager
