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

/// All that can happen to an Entity Manager. Facts have happened and change the state; requests are
/// somebody's wish and are answered. Which is which: isRequest().
enum class Event : std::uint8_t {
    // facts of the link to the robot application
    LinkUp,
    LinkDown,   ///< without a good-bye: silent, closed, or the application has stopped itself
    LinkEnded,  ///< in order: the application has stopped its robot and said so
    ProfileUploaded,
    KeptProfileTaken,  ///< uploaded while the entity was held, and taken at the release
    ProfilesGood,
    ProfilesBad,
    TaskGranted,
    TaskEnded,
    LastTaskEnded,
    ApplicationBusy,
    ApplicationReady,
    // facts of the server and of clients
    ServerUp,
    ServerReturned,  ///< while the lease of its client runs on, orphaned
    ServerDown,
    ClientLost,
    ClientSpared,  ///< lost, and all that runs may go on without it for a while
    ClientEnded,
    CheckOutGranted,
    LeaseResumed,  ///< by its holder, in the grace
    LeaseExpired,  ///< the grace is over
    TakenOver,     ///< by an administrator, or because the holder hands over
    // requests
    CheckOut,
    HandOver,
    Release,
    SetParam,
    Resource,
    Task,
    Pause,
    Resume,
    Cancel,
    Rearm,
    Text,
    Raw,
    Status,
    Watch,
    // commands: requests of higher precedence (thesis 3.3.1)
    Stop,
    Reset,
    Clear,
    // collaboration
    CollaborativeTask,     ///< a client asks for the run of a global service
    CollaborationBegun,    ///< this entity is its master
    CollaborationRequest,  ///< a master invites
    CollaborationJoined,   ///< this entity is its slave
    CollaborationEnded,    ///< nothing runs any more
    CollaborationStopped,  ///< by its master
    MasterLost,            ///< the master of the run in which it takes part is silent
    RunHistory,
    // the operator of the daemon
    Quit,
};
inline constexpr std::size_t kEvents = static_cast<std::size_t>(Event::Quit) + 1;
inline constexpr std::size_t kStates = static_cast<std::size_t>(EntityState::ERR) + 1;

/// What the machine does about an event, in the order of the row. EntityManagerCore::Machine has one function
/// each.
enum class Action : std::uint8_t {
    AwaitProfiles,
    DeliverStops,
    ConsiderProfiles,
    ReportProfiles,
    SeekServer,
    Register,
    LeaveServer,
    ConsiderCheckOut,
    SendGrant,
    StopApplication,
    Latch,
    Unlatch,
    Acknowledge,
    VoidQueue,
    EndTasks,
    LoseTasks,
    SpareTasks,
    HaltTasks,
    DispatchNext,
    CancelTask,
    PauseTask,
    ResumeTask,
    AdmitTask,
    AskParameter,
    CarryResource,
    SuspendUploads,
    AbandonRequests,
    OrphanLease,
    EndLease,
    DismissWaiting,
    ConsiderHandOver,
    ConsiderRun,
    ConsiderInvitation,
    LeaveCollaboration,
    TellRunHistory,
    PassText,
    PassRaw,
    AnswerStatus,
    NoteWatch,
    TellStatus,
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
