// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/refusal.hpp"
#include "common/routed.hpp"

namespace axon::entity_manager {

/// All that can happen to an Entity Manager: events.def. Facts have happened and change the state; requests
/// are somebody's wish and are answered.
enum class Event : std::uint8_t {
#define AXON_FACT(name) name,
#define AXON_REQUEST(name, needs, wish, is, refuse) name,
#include "entity_manager/core/turn/events.def"
#undef AXON_FACT
#undef AXON_REQUEST
};
inline constexpr std::size_t kEvents = 0
#define AXON_FACT(name) +1
#define AXON_REQUEST(name, needs, wish, is, refuse) +1
#include "entity_manager/core/turn/events.def"
#undef AXON_FACT
#undef AXON_REQUEST
    ;
inline constexpr std::size_t kStates = kEntityStates.size();

/// What is done about an event, in the order of the row: actions.def.
enum class Action : std::uint8_t {
#define AXON_ACTION(name, call) name,
#include "entity_manager/core/turn/actions.def"
#undef AXON_ACTION
};

/// Where a row leads.
struct Next {
    enum class Kind : std::uint8_t { Stay, To, Previous };
    Kind kind = Kind::Stay;
    EntityState state = EntityState::UNAV;  ///< for To

    bool operator==(const Next&) const = default;
};

/// One row: in this state, at this event, the state changes first and then the actions run.
struct Row {
    EntityState state;
    Event event;
    std::vector<Action> actions;
    Next next;
};

/// What a request must prove before its row runs (ADR 0007), besides who sends it
/// (common/rights.hpp).
struct Needs {
    bool stop_generation = false;  ///< the sender has seen the newest stop
    bool not_latched = false;
};

/// The state machine as data: the single source of the code's behaviour, of the test that walks every pair,
/// and of docs/design/state-machine.md. Immutable; any thread.
std::span<const Row> stateTable();
/// The row of the pair, or null: then refusalFor() is the answer.
const Row* findRow(EntityState state, Event event);
/// The typed refusal of a pair that has no row. `reason` is that of UNAV, INIT and ERR.
Refusal refusalFor(EntityState state, Event event, const std::string& reason = {});
Needs needsOf(Event event);
bool isRequest(Event event);

const char* toString(Event event);
const char* toString(Action action);
/// The token of the table in the documentation: "stay", "IDLE", "previous".
std::string toString(const Next& next);

/// The transitions as a Mermaid diagram, and the whole page with the table of all pairs.
std::string stateDiagram();
std::string stateMachinePage();

}  // namespace axon::entity_manager
