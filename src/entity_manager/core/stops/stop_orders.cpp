// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/stops/stop_orders.hpp"

#include <cstdint>
#include <optional>
#include <string>

#include "common/planted_bug.hpp"
#include "entity_manager/core/stops/latch.hpp"

namespace axon::entity_manager {

namespace {

/// Of the stops that the signal thread has passed on.
bool mustBeNoted() {
    return !AXON_PLANTED(StopNotInTheJournal);
}

}  // namespace

void StopOrders::giveReason(Incident& request) {
    const auto isNow = [&](StopCause cause, const std::string& said) {
        request.cause = cause;
        if (!said.empty()) request.reason = {RefusalCode::Stopped, named(request.head->sender) + said, {}};
    };
    if (request.event == Event::Release) isNow(StopCause::Released, " released the entity.");
    if (request.event == Event::Clear) isNow(StopCause::Clear, " cleared all tasks.");
    if (request.event == Event::Reset) isNow(StopCause::Reset, {});
}

void StopOrders::stop(Incident& incident) {
    if (!mustStop(incident)) return;
    incident.generation = ledger_.order(incident.cause, incident.event != Event::Reset);
    others_.stopReachesTasks(incident.event != Event::Reset);
    note(incident);
}

void StopOrders::arrived(const Incident& incident) {
    ledger_.arrived(incident.generation);
    others_.stopReachesTasks(true);
    if (mustBeNoted()) note(incident);
}

void StopOrders::note(const Incident& incident) {
    journal_.note({.kind = JournalRecord::Kind::Stopped,
                   .generation = incident.generation,
                   .who = incident.head != nullptr ? named(incident.head->sender) : std::string(),
                   .client = incident.head != nullptr ? incident.head->sender.id : std::string(),
                   .code = toString(incident.cause),
                   .text = incident.reason.message});
}

void StopOrders::deliver() {
    if (!ledger_.owed()) return;
    Incident again{Event::LinkUp};
    again.cause = StopCause::LinkLost;
    again.reason = {RefusalCode::Stopped, "It was stopped while its application was lost.", {}};
    stop(again);
}

void StopOrders::acknowledge(const Incident& incident) {
    std::optional<StopLedger::Ended> ended;
    if (incident.event == Event::Reset || incident.event == Event::Clear) {
        const auto tasks = others_.taskCounts();
        ended.emplace();
        ended->tasks = static_cast<std::uint32_t>(tasks.begun);
        if (incident.event == Event::Clear) ended->removed = static_cast<std::uint32_t>(tasks.waiting);
    }
    if (ledger_.acknowledge(*incident.head, incident.cause, incident.generation, others_.robotMoves(), ended))
        deliver();
}

}  // namespace axon::entity_manager
