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

/// The values that the client library takes and returns: entities, services, tasks, stops and their options.
/// They are plain values. A program may copy and keep them; the library never changes a value that it has
/// returned.
namespace axon::client {

using Seconds = std::chrono::duration<double>;

/// One value of a parameter. An int64 is accepted where a double is expected.
using Value = std::variant<std::int64_t, double, std::string, bool>;
std::string toText(const Value& value);

/// A parameter that is given to a task or set on a service. Only a "multiple" parameter takes more than one
/// value. With `from_text` every value is a string, as from a command line, and is parsed by the declared
/// type of the parameter.
struct Argument {
    std::string name;
    std::vector<Value> values;
    std::string units;  ///< optional; refused with WRONG_UNITS if it differs from the profile
    bool from_text = false;
};

/// What a parameter is for.
enum class ParameterKind : std::uint8_t {
    Input,    ///< an input of a task, given with the task or set beforehand
    Output,   ///< a result of a task, from the robot application
    Config,   ///< a setting of the service
    Feedback  ///< reported by the robot application while a task runs
};
/// The word in the profile: "INPUT", "OUTPUT", "CONFIG", "FEEDBACK".
const char* toString(ParameterKind kind);

/// The type of the values of a parameter.
enum class DataType : std::uint8_t {
    Unknown,  ///< the entity does not say which
    Integer,
    Double,
    Text,
    Boolean
};
/// The word in the profile: "INT", "DBL", "STR", "BOOL"; "" for Unknown.
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
    Composite  ///< the services in Service::parts, one after the other
};
/// The word in the profile: "SMPL", "CMPLX".
const char* toString(ServiceKind kind);

struct Service {
    std::string name, global_id;
    ServiceKind kind = ServiceKind::Simple;
    std::string descr, notes;
    bool active = true, executing = false, blocking = true, pausable = false;
    std::string inactive_reason;  ///< why it is not active; empty if the robot application gave no reason
    std::vector<Parameter> parameters;
    std::vector<Resource> resources;
    std::vector<std::string> missing;  ///< parameters and resources to set or upload before it can run
    std::vector<std::string> parts;    ///< of a composite service, in order: name or global id
};

/// The part of an entity's state that every client may see.
struct Entity {
    std::string id;  ///< UUID
    /// False until the robot application has uploaded valid profiles to its Entity Manager. While it is
    /// false, `name` is the name of the application, `category`, `type` and `descr` are empty, and `reason`
    /// says what is missing.
    bool ready = true;
    std::string name, category, type, descr;
    double x_mm = 0, y_mm = 0, z_mm = 0;
    EntityState state = EntityState::UNAV;
    bool latched = false;
    std::int32_t stop_generation = 0;
    Sender holder;                        ///< its id is empty if nobody holds the entity
    std::string reason;                   ///< of UNAV, INIT and ERR; in IDLE: from whom it was taken, and why
    bool orphaned = false;                ///< the holder is lost and may still come back
    int waiting = 0;                      ///< number of clients in its wait list
    std::optional<Seconds> stop_latency;  ///< to the application and back, in the server's own last drill
};

/// Which entities a list contains: only those that are ready (Entity::ready), or all.
enum class Listed : std::uint8_t { Ready, All };

/// How close a watchdog came to tripping.
struct WatchdogMargin {
    std::string hop;         ///< who watches whom
    Seconds timeout{0};      ///< the watchdog stops the robot after this much silence
    Seconds longest_gap{0};  ///< the longest silence in the last minute
};

/// Something about an entity that differs from its profiles or from what its users expect. For people.
struct EntityFinding {
    std::string message, fix;  ///< what is wrong, and what to do about it
};

/// What an entity reports about itself on request.
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
    Refusal reason;         ///< why it failed, was stopped, was refused …
    bool accepted = false;  ///< the Entity Manager has accepted it: it is queued there, or has begun
};

/// The result of a stop for one entity, stage by stage (docs/explanation/safety.md, "What a receipt says").
/// Times count from the call, on the client's clock. A stage that has not answered within the deadline has no
/// time.
struct Receipt {
    std::string entity, name;
    std::int32_t stop_generation = 0;
    EntityState state = EntityState::UNAV;
    std::optional<Seconds> server, manager, callback_returned, standstill;
    /// No robot application is linked and none was lost, so there was nothing to stop.
    bool no_application = false;
    /// Why nobody can confirm that the robot was stopped: its application was linked and fell silent, or its
    /// connection was closed without a good-bye. Empty = no application was lost. An application that comes
    /// back within the deadline receives the stop and confirms it.
    std::string application_lost;
    std::optional<Seconds> application_lost_for;  ///< at the time of the receipt
    std::string fault;     ///< what the stop callback threw; it is called again until it returns
    Seconds precision{0};  ///< of the times: the step of a laboratory's clock (AXON_CLOCK); 0 = real time
    /// The robot was moving, and its application will report when it stands still.
    bool standstill_follows = false;
    int tasks_ended = 0;    ///< running tasks that CheckOut::reset() or clear() has ended
    int tasks_removed = 0;  ///< queued tasks that CheckOut::clear() has removed
    /// True if the Entity Manager has answered and, if there is an application, its stop callback has
    /// returned.
    bool confirmed() const { return manager && (callback_returned || no_application); }
    /// True if the stop is confirmed and no report of a standstill is outstanding.
    bool atRest() const { return confirmed() && (standstill || !standstill_follows); }
};

/// What a drill has measured for one entity: one entry per try, in order. An entry without a time means that
/// the answer never arrived.
struct DrillReport {
    std::string entity, name;
    std::vector<std::optional<Seconds>> manager;  ///< the Entity Manager's answer, back at this client
    std::vector<std::optional<Seconds>>
        callback;                 ///< the Entity Interfacer's, where its stop callback begins
    bool no_application = false;  ///< there was no robot application to answer the last try
};

/// How requests of other clients for an entity that this client holds are answered.
struct HandOverPolicy {
    Seconds answer_within{30};  ///< how long the program has to answer, at most 600 s
    bool yield = false;         ///< without an answer: true hands the entity over, false refuses
    bool refuse = false;        ///< the library refuses every request at once and does not ask the program
};

/// Another client asks for an entity that this client holds.
struct HandOverRequest {
    std::string by, reason;
    Seconds answer_within{0};  ///< time left, from the callback or from CheckOut::handOverRequest()
    bool yield = false;        ///< without an answer: true hands the entity over, false refuses
    bool withdrawn = false;    ///< the other client has gone, or its time is up: no answer is expected
};

/// The progress of a check-out that waits.
struct Waiting {
    std::string entity;   ///< UUID; empty if the check-out waits for several entities
    int place = 0;        ///< in the Entity Manager's wait list, 1 = next; 0 = not in one
    std::string message;  ///< for people
};

/// Options of a check-out. The defaults grant it immediately or refuse it.
struct CheckOutOptions {
    /// How long to wait for entities that others hold. Without a value, do not wait. A check-out of one
    /// entity waits in the wait list of its Entity Manager, first come, first served. A check-out of several
    /// entities, or by a query, waits until all of them are free at the same time. With `ask`, it waits for
    /// the holder's answer, and then in the wait list if the answer is no.
    std::optional<Seconds> wait;
    /// Called on every change while the check-out waits, as all callbacks are (see Client).
    std::function<void(const Waiting&)> on_waiting;
    /// Ask the holder to hand the entity over. For one entity, by name. The check-out ends with the grant or
    /// with HAND_OVER_REFUSED.
    bool ask = false;
    /// Take the entities from their holders. For admins only. Each robot is stopped first, and its holder is
    /// told.
    bool force = false;
    std::string reason;        ///< shown to the holder, with `ask` and `force`
    HandOverPolicy hand_over;  ///< of the new lease
    std::stop_token give_up;   ///< a stop request ends the wait with CANCELLED
};

/// One sample of a stream. `raw` is the serialized axon.proto.StreamSample.
struct Sample {
    std::string entity, stream;
    std::uint64_t sequence = 0;
    std::string raw;
    /// The content as JSON text with the field names of axon.proto.StreamSample; "{}" if `raw` is not one.
    /// Rendered anew in each call, which takes milliseconds for a picture.
    std::string json() const;
};

}  // namespace axon::client
