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

/// Global services: what several entities do together (docs/reference/profiles.md), and the runs of them.
namespace axon::client {

/// An input of a step that an earlier one gives as its output.
struct ParameterSource {
    std::string parameter, step, output;
};

struct GlobalStep {
    int role = 0;                ///< which participant
    std::string category, type;  ///< of who may play the role: ROBOT or MACHINE, MOBILE or STATIONARY
    std::string service_global_id;
    int preced = 0;                    ///< equal numbers run at the same time
    std::string name;                  ///< what later steps call it; empty = nothing
    std::vector<Argument> parameters;  ///< as texts: only the entity knows their types
    std::vector<ParameterSource> sources;
};

/// What happens to the others when a step fails. A stop stops all of them in any case.
enum class OnFailure : std::uint8_t {
    StopAll,
    HoldOthers,  ///< steps that can be paused are, the others are stopped; then the operator decides
    Compensate,  ///< all are stopped, then the steps of the compensation run
};
const char* toString(OnFailure on_failure);

struct GlobalService {
    std::string name, descr;
    std::string file;  ///< of the server, without its folder
    OnFailure on_failure = OnFailure::StopAll;
    std::vector<GlobalStep> steps, compensation;
};

/// One file of the server's folder. What has errors offers no services.
struct GlobalFile {
    std::string name;
    std::vector<std::string> findings;  ///< "file:line: severity: element: what was expected: how to mend it"
    bool bad = false;                   ///< there is an error among them
};

struct GlobalServices {
    std::vector<GlobalService> services;
    std::vector<GlobalFile> files;
};

/// Role → entity: a name as Client::find takes it.
using Bindings = std::map<int, std::string>;

/// Why one entity cannot play a role.
struct Unfit {
    std::string entity, name;  ///< UUID, name
    Refusal why;               ///< a sentence without its subject: "is held by ana@lab, and was stopped"
    int distance = 0;          ///< how far it is from being able: 1 a rearm, … 8 another kind of entity
};

/// What was found for one role.
struct RoleOutlook {
    int role = 0;
    std::string wanted;             ///< "ROBOT/MOBILE with drive, look"
    std::string kind;               ///< "ROBOT/MOBILE"
    std::vector<std::string> able;  ///< names of those that could play it now
    std::vector<Unfit> unfit;       ///< nearest first
    std::string entity, name;       ///< who plays it: UUID, name; empty = nobody
};

/// Who could play which role of a global service, found by Client::propose().
struct Proposal {
    std::vector<RoleOutlook> roles;          ///< in order of their numbers
    std::vector<std::string> nobody_offers;  ///< services that no entity has, of whatever kind
    Refusal why;                             ///< role by role, one line each; OK when every role is played

    bool complete() const { return why.ok(); }
};

enum class RunState : std::uint8_t {
    Checking = 1,  ///< the participants are asked whether they can and may
    Running,
    Paused,
    Held,      ///< a step failed, the others were held: resume tries it again, cancel ends the run
    Stopping,  ///< a step failed: everybody is being stopped
    Compensating,
    Succeeded,  ///< the states from here on are final; of a check: it would be possible
    Failed,
    Stopped,
    Cancelled,
    Refused,  ///< nothing has moved
    Unknown   ///< the master was lost while it ran
};
inline bool isFinal(RunState state) {
    return state >= RunState::Succeeded;
}
const char* toString(RunState state);

/// How far a step is.
struct StepReport {
    int step = 0;  ///< position in the service from 0; those of the compensation after the steps
    bool compensation = false;
    std::string called;        ///< its name in the service; empty = none
    std::string entity, name;  ///< UUID, name
    std::string service;       ///< global id
    int preced = 0;
    std::optional<TaskState> state;  ///< none: its turn has not come
    double progress = -1;            ///< 0 to 1; negative = not known
    std::string feedback;
    std::map<std::string, std::vector<Value>> parameters, results;
    Refusal reason;
    std::optional<Seconds> began, ended;  ///< since the launch
    int tries = 1;                        ///< above 1: after a hold it was tried again
};

/// Why a run is not possible.
struct RunProblem {
    int step = -1;       ///< as in StepReport; -1 = no single one
    std::string entity;  ///< name
    Refusal refusal;
};

struct RunReport {
    std::string id;       ///< UUID text of the run
    std::string service;  ///< name of the global service
    std::string master;   ///< UUID
    bool check = false;   ///< only whether it would be possible
    RunState state = RunState::Checking;
    double progress = 0;            ///< of the whole, 0 to 1
    Seconds elapsed{0};             ///< since the launch, by the master's clock
    std::vector<StepReport> steps;  ///< in order of their positions
    std::vector<RunProblem> problems;
    Refusal reason;  ///< why it failed, was stopped, refused …
};

/// Who played a role.
struct Participant {
    int role = 0;
    std::string entity, name;  ///< UUID, name
};

/// What became of a run; kept by its master.
struct RunRecord {
    std::string id;
    GlobalService service;
    std::string by;      ///< the client
    std::string master;  ///< UUID
    std::vector<Participant> participants;
    std::chrono::system_clock::time_point asked_at;  ///< by the client's clock
    Seconds duration{0};
    RunState state = RunState::Unknown;
    Refusal reason;
    std::vector<StepReport> steps;
};

struct RunHistory {
    std::vector<RunRecord> runs;  ///< newest first
    /// Entities that were asked and have not answered: names, and why.
    std::vector<std::pair<std::string, Refusal>> silent;
};

}  // namespace axon::client
