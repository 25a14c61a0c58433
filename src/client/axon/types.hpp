// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <stop_token>
#include <string>
#include <variant>
#include <vector>

#include "axon/refusal.hpp"
#include "axon/states.hpp"

/// What the client library tells of entities, services, tasks and stops, and what it is told. Plain values:
/// copy them, keep them; nothing in them changes of its own accord.
namespace axon::client {

using Seconds = std::chrono::duration<double>;

/// One value of a parameter. An int64 is accepted where a double is asked for.
using Value = std::variant<std::int64_t, double, std::string, bool>;
std::string toText(const Value& value);

/// A parameter given to a task or set on a service: more than one value only for a "multiple" parameter.
/// With `from_text` the values are strings that are read by the parameter's declared type (a command line).
struct Argument {
    std::string name;
    std::vector<Value> values;
    std::string units;  ///< optional; refused with WRONG_UNITS when it is not the profile's
    bool from_text = false;
};

/// What a parameter is for.
enum class ParameterKind : std::uint8_t {
    Input,    ///< what a task works with: given with the task, or set beforehand
    Output,   ///< a result of a task, of the robot application
    Config,   ///< a setting of the service
    Feedback  ///< what the robot application tells while a task runs
};
/// The word of the profile: "INPUT", "OUTPUT", "CONFIG", "FEEDBACK".
const char* toString(ParameterKind kind);

/// What the values of a parameter are.
enum class DataType : std::uint8_t {
    Unknown,  ///< the entity does not say
    Integer,
    Double,
    Text,
    Boolean
};
/// The word of the profile: "INT", "DBL", "STR", "BOOL"; "" for Unknown.
const char* toString(DataType type);

struct Parameter {
    std::string name;
    ParameterKind kind = ParameterKind::Input;
    DataType data_type = DataType::Unknown;
    std::string units, descr;
    bool ready = false, required = false, savable = false, multiple = false;
    std::vector<Value> values, choices;
    std::optional<double> minimum, maximum;
};

struct Resource {
    std::string name, descr;
    bool ready = false, required = false, savable = false;
    std::uint64_t size = 0;  ///< bytes
};

enum class ServiceKind : std::uint8_t {
    Simple,    ///< carried out by the robot application
    Composite  ///< the services of Service::parts, one after the other
};
/// The word of the profile: "SMPL", "CMPLX".
const char* toString(ServiceKind kind);

struct Service {
    std::string name, global_id;
    ServiceKind kind = ServiceKind::Simple;
    std::string descr, notes;
    bool active = true, executing = false, blocking = true, pausable = false;
    std::string inactive_reason;  ///< why it is switched off, where the robot application has said it
    std::vector<Parameter> parameters;
    std::vector<Resource> resources;
    std::vector<std::string> missing;  ///< what must be set or uploaded before it can run
    std::vector<std::string> parts;    ///< of a composite one, in order, by name or global id
};

/// What everybody may see of an entity.
struct Entity {
    std::string id;  ///< UUID
    /// False until its robot application has uploaded valid profiles to its Entity Manager: then `name` is
    /// that of the application, `category`, `type` and `descr` are empty, and `reason` says what is missing.
    bool ready = true;
    std::string name, category, type, descr;
    double x_mm = 0, y_mm = 0, z_mm = 0;
    EntityState state = EntityState::UNAV;
    bool latched = false;
    std::int32_t stop_generation = 0;
    Sender holder;                        ///< id empty when free
    std::string reason;                   ///< of UNAV, INIT and ERR; in IDLE from whom it was taken, and why
    bool orphaned = false;                ///< the holder is lost, and may still come back
    int waiting = 0;                      ///< how many wait for it
    std::optional<Seconds> stop_latency;  ///< of the servers' own last drill: to the application and back
};

/// Which entities a list has: those that are ready, or also those that are not (Entity::ready).
enum class Listed : std::uint8_t { Ready, All };

/// How near a dead-man came to its end.
struct WatchdogMargin {
    std::string hop;         ///< who watches whom
    Seconds timeout{0};      ///< the robot is stopped after so long a silence
    Seconds longest_gap{0};  ///< the longest silence of the last minute
};

/// What is not as an entity's profiles or its users mean it to be, for people.
struct EntityFinding {
    std::string message, fix;  ///< what is the matter, and what to do about it
};

/// What an entity tells of itself when it is asked.
struct Details {
    std::vector<Service> services;
    std::vector<WatchdogMargin> watchdogs;
    std::vector<EntityFinding> findings;
};

enum class TaskState : std::uint8_t {
    Queued = 1,
    Dispatched,
    Running,
    Paused,
    Succeeded,
    Failed,
    Stopped,
    Cancelled,
    Refused,
    Unknown
};
inline bool isFinal(TaskState state) {
    return state >= TaskState::Succeeded;
}
const char* toString(TaskState state);

struct TaskReport {
    std::string id;  ///< UUID text of the task
    std::string entity, service;
    TaskState state = TaskState::Queued;
    double progress = -1;  ///< 0 to 1; negative = not known
    std::string feedback;
    std::map<std::string, std::vector<Value>> results;
    Refusal reason;         ///< why it failed, was stopped, refused …
    bool accepted = false;  ///< the Entity Manager has taken it: it waits there for its turn, or has begun
};

/// What became of a stop, stage by stage (docs/explanation/safety.md, "What a receipt says"). Times since
/// the call, on the client's clock; a stage that has not answered within the deadline has no time.
struct Receipt {
    std::string entity, name;
    std::int32_t stop_generation = 0;
    EntityState state = EntityState::UNAV;
    std::optional<Seconds> server, manager, callback_returned, standstill;
    bool no_application =
        false;  ///< no robot application is linked, and none is missing: there was nothing to stop
    /// Why nobody can tell that the robot was stopped: its application was linked and fell silent, or its
    /// connection was closed without a good-bye. Empty = it is not so. An application that comes back within
    /// the deadline is given the stop, and confirms it.
    std::string application_lost;
    std::optional<Seconds> application_lost_for;  ///< at the time of the receipt
    std::string fault;  ///< the application's stop callback threw this; it is called again until it returns
    Seconds precision{0};  ///< of the times: the step of a laboratory's time (AXON_CLOCK), in which nothing
                           ///< shorter can be told
    /// The robot was moving, and its application reports when it stands still.
    bool standstill_follows = false;
    int tasks_ended = 0;    ///< of CheckOut::reset() and clear(): the running ones
    int tasks_removed = 0;  ///< of CheckOut::clear(): those that waited
    /// The EM and, where there is an application, its stop callback have answered.
    bool confirmed() const { return manager && (callback_returned || no_application); }
    /// Nothing more is expected of this robot.
    bool atRest() const { return confirmed() && (standstill || !standstill_follows); }
};

/// What a drill measured of one entity: one entry for each try, in order; no time = it never arrived.
struct DrillReport {
    std::string entity, name;
    std::vector<std::optional<Seconds>> manager;  ///< the Entity Manager's answer, back at this client
    std::vector<std::optional<Seconds>>
        callback;                 ///< the Entity Interfacer's, where its stop callback begins
    bool no_application = false;  ///< in the last try there was no robot application to answer
};

/// What becomes of the wishes of others for an entity that this client holds.
struct HandOverPolicy {
    Seconds answer_within{30};  ///< at most 600
    bool yield = false;         ///< silence hands over; otherwise it refuses
    bool refuse = false;        ///< nobody is asked: the library refuses at once, in this client's name
};

/// Somebody asks for an entity that this client holds.
struct HandOverRequest {
    std::string by, reason;
    Seconds answer_within{0};  ///< from when it is told, or asked for by CheckOut::handOverRequest()
    bool yield = false;        ///< what silence means
    bool withdrawn = false;    ///< who asked has gone, or the time was up: nothing is left to answer
};

/// How a check-out that cannot be had at once is coming along.
struct Waiting {
    std::string entity;   ///< UUID; empty where several are waited for
    int place = 0;        ///< in the Entity Manager's wait list, 1 = next; 0 where there is none
    std::string message;  ///< for people
};

/// How to check out. As it is: now or not at all.
struct CheckOutOptions {
    /// Wait so long for what is held by others; without a value do not wait. One entity: in the Entity
    /// Manager's wait list, first come, first served. Several, or a query: until all are free at once. With
    /// `ask`: for the holder's answer, and in the list when that is no.
    std::optional<Seconds> wait;
    /// Each change while it waits. On the library's callback thread.
    std::function<void(const Waiting&)> on_waiting;
    /// Ask the holder to hand it over (one entity, by name). Ends with the grant or HAND_OVER_REFUSED.
    bool ask = false;
    /// Take what is held from its holder: admins only. The robot is stopped first, and the holder told.
    bool force = false;
    std::string reason;        ///< for the holder, with `ask` and `force`
    HandOverPolicy hand_over;  ///< of the lease that this makes
    std::stop_token give_up;   ///< ends the wait with CANCELLED
};

/// One sample of a stream. `json` is the sample's content as JSON text; `raw` the serialized
/// axon.proto.StreamSample.
struct Sample {
    std::string entity, stream;
    std::uint64_t sequence = 0;
    std::string json, raw;
};

}  // namespace axon::client
