// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "axon/refusal.hpp"
#include "axon/types.hpp"

/// Global services, and runs of them.
///
/// A global service is a job for several entities: a list of steps, each of which is a service of one entity
/// (docs/reference/profiles.md). A *role* is a place in it that one entity fills. A *run* is one execution of
/// it. The entities in a run are its *participants*, and one of them, the *master*, orders the steps.
namespace axon::client {

/// Takes the input `parameter` of a step from the output `output` of an earlier step, `step`.
struct ParameterSource {
    std::string parameter, step, output;
};

struct GlobalStep {
    int role = 0;                ///< number of the role that carries the step out
    std::string category, type;  ///< of an entity that may play it: ROBOT or MACHINE, MOBILE or STATIONARY
    std::string service_global_id;
    int preced = 0;                    ///< order, ascending; steps with equal numbers run at the same time
    std::string name;                  ///< by which later steps refer to it; empty = none
    std::vector<Argument> parameters;  ///< as texts, because only the entity knows their types
    std::vector<ParameterSource> sources;
};

/// What happens to the other steps when a step fails. A stop of one participant always stops all of them.
enum class OnFailure : std::uint8_t {
    StopAll,
    HoldOthers,  ///< pauses the steps that can be paused and stops the others; then the operator decides
    Compensate,  ///< stops all steps, then runs the steps of the compensation
};
const char* toString(OnFailure on_failure);

struct GlobalService {
    std::string name, descr;
    std::string file;  ///< name of its file on the server, without the folder
    OnFailure on_failure = OnFailure::StopAll;
    std::vector<GlobalStep> steps, compensation;
};

/// One file in the server's folder of global services. A file with an error offers no services.
struct GlobalFile {
    std::string name;
    std::vector<std::string> findings;  ///< "file:line: severity: element: what was expected: how to fix it"
    bool bad = false;                   ///< at least one finding is an error
};

struct GlobalServices {
    std::vector<GlobalService> services;
    std::vector<GlobalFile> files;
};

/// Which entity plays which role: role number → name, in the forms that Client::find accepts.
using Bindings = std::map<int, std::string>;

/// An entity that cannot play a role now, and why.
struct Unfit {
    std::string entity, name;  ///< UUID, name
    Refusal why;               ///< the message is a predicate: "is held by ana@lab, and was stopped"
    /// How much is missing, so that the nearest candidate can be shown first. If several things are missing,
    /// the largest number counts.
    /// 1 = it is latched: rearm it. 2 = this client holds it, but it is busy. 3 = another client holds it.
    /// 4 = it is not available, or does not answer. 5 = a parameter or resource is missing. 6 = a service is
    /// not active. 7 = it does not offer a service. 8 = it is another kind of entity.
    int distance = 0;
};

/// The candidates for one role.
struct RoleOutlook {
    int role = 0;
    std::string wanted;             ///< what the role asks for: "ROBOT/MOBILE with drive, look"
    std::string kind;               ///< the kind of entity alone: "ROBOT/MOBILE"
    std::vector<std::string> able;  ///< names of the entities that could play it now
    std::vector<Unfit> unfit;       ///< the other entities, smallest distance first
    std::string entity, name;       ///< the entity that is proposed: UUID, name; empty = none
};

/// Which entity could play which role of a global service: the result of Client::propose(). Every role gets a
/// different entity, and as many roles as possible get one.
struct Proposal {
    std::vector<RoleOutlook> roles;          ///< in order of the role numbers
    std::vector<std::string> nobody_offers;  ///< services that no entity of any kind offers
    Refusal why;  ///< why roles have no entity, one line per role; OK = all have one

    /// True if every role has an entity.
    bool complete() const { return why.ok(); }
};

enum class RunState : std::uint8_t {
    Checking = 1,  ///< the master asks the participants whether they can and may take part
    Running,
    Paused,
    Held,      ///< a step failed and the others were held: resume tries it again, cancel ends the run
    Stopping,  ///< a step failed and all participants are being stopped
    Compensating,
    Succeeded,  ///< this state and all below are final; for a check: the run would be possible
    Failed,
    Stopped,
    Cancelled,
    Refused,  ///< nothing has moved
    Unknown   ///< the master was lost during the run
};
inline bool isFinal(RunState state) {
    return state >= RunState::Succeeded;
}
const char* toString(RunState state);

/// The progress of one step.
struct StepReport {
    int step = 0;  ///< position in the service, from 0; the compensation follows the steps
    bool compensation = false;
    std::string called;        ///< GlobalStep::name
    std::string entity, name;  ///< UUID, name
    std::string service;       ///< global id
    int preced = 0;
    std::optional<TaskState> state;  ///< no value = the step has not begun
    double progress = -1;            ///< 0 to 1; negative = not known
    std::string feedback;
    std::map<std::string, std::vector<Value>> parameters, results;
    Refusal reason;
    std::optional<Seconds> began, ended;  ///< since the launch
    int tries = 1;                        ///< above 1 if it was tried again after a hold
};

/// Why a run is not possible.
struct RunProblem {
    int step = -1;       ///< as in StepReport; -1 = the problem concerns no single step
    std::string entity;  ///< name
    Refusal refusal;
};

struct RunReport {
    std::string id;       ///< UUID text of the run
    std::string service;  ///< name of the global service
    std::string master;   ///< UUID
    bool check = false;   ///< from Client::checkGlobal(): nothing moves
    RunState state = RunState::Checking;
    double progress = 0;            ///< of the whole run, 0 to 1
    Seconds elapsed{0};             ///< since the launch, on the master's clock
    std::vector<StepReport> steps;  ///< in order of their positions
    std::vector<RunProblem> problems;
    Refusal reason;  ///< why it failed, was stopped, was refused …
};

/// The entity that played a role.
struct Participant {
    int role = 0;
    std::string entity, name;  ///< UUID, name
};

/// A past run and its result. The master keeps it.
struct RunRecord {
    std::string id;
    GlobalService service;
    std::string by;      ///< name of the client that asked for the run
    std::string master;  ///< UUID
    std::vector<Participant> participants;
    std::chrono::system_clock::time_point asked_at;  ///< on the client's clock
    Seconds duration{0};
    RunState state = RunState::Unknown;
    Refusal reason;
    std::vector<StepReport> steps;
};

struct RunHistory {
    std::vector<RunRecord> runs;  ///< newest first
    /// Entities that were asked and have not answered: name and reason.
    std::vector<std::pair<std::string, Refusal>> silent;
};

}  // namespace axon::client
