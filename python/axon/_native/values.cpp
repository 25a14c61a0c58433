// SPDX-License-Identifier: GPL-2.0-or-later
#include "bindings.hpp"

namespace axon::python {
namespace {

namespace py = pybind11;
using namespace client;

/// A plain value with its members as read-only attributes.
template <class T>
class Struct {
  public:
    Struct(py::module_& module, const char* name, const char* doc) : class_(module, name, doc) {}
    ~Struct() {
        class_.def("__repr__", [names = names_](const py::object& self) {
            std::string out = py::str(py::type::of(self).attr("__name__"));
            out += "(";
            for (std::size_t i = 0; i < names.size(); ++i) {
                if (i) out += ", ";
                out += names[i] + "=" + std::string(py::repr(self.attr(names[i].c_str())));
            }
            return text(out + ")");
        });
        py::list fields;
        for (const auto& name : names_) fields.append(name);
        class_.attr("_fields") = py::tuple(fields);
    }
    Struct(const Struct&) = delete;
    Struct& operator=(const Struct&) = delete;

    template <class Member>
    Struct& field(const char* name, Member member, const char* doc = "") {
        class_.def_property_readonly(
            name, [member](const T& self) { return readable(self.*member); }, doc);
        names_.emplace_back(name);
        return *this;
    }
    template <class Function>
    Struct& property(const char* name, Function function, const char* doc) {
        class_.def_property_readonly(name, function, doc);
        return *this;
    }
    py::class_<T>& bound() { return class_; }

  private:
    static py::str readable(const std::string& utf8) { return text(utf8); }
    static const auto& readable(const auto& value) { return value; }

    py::class_<T> class_;
    std::vector<std::string> names_;
};

}  // namespace

void bindValues(py::module_& module) {
    Struct<Refusal>(module, "Refusal", "Why something was not done. Its code is RefusalCode.OK if it was.")
        .field("code", &Refusal::code)
        .field("message", &Refusal::message, "For people: what was expected, and how to fix it.")
        .field("holder", &Refusal::holder,
               "Name of the present holder, if the entity is refused because of it.")
        .property(
            "ok", [](const Refusal& refusal) { return refusal.ok(); }, "True if it was not refused.");
    Struct<Sender>(module, "Sender", "A client or an entity, as others see it.")
        .field("id", &Sender::id, "UUID of a client's session, or of an entity.")
        .field("name", &Sender::name, "For people: user@host, or the name of the entity.")
        .field("role", &Sender::role);
    Struct<Parameter>(module, "Parameter", "A parameter of a service, as its profile declares it.")
        .field("name", &Parameter::name)
        .field("kind", &Parameter::kind)
        .field("data_type", &Parameter::data_type)
        .field("units", &Parameter::units, "Unit of its values, such as \"mm\"; empty if it has none.")
        .field("descr", &Parameter::descr)
        .field("ready", &Parameter::ready, "True if it has values.")
        .field("required", &Parameter::required, "True if a task needs it.")
        .field("savable", &Parameter::savable, "True if the Entity Manager keeps it.")
        .field("multiple", &Parameter::multiple, "True if it takes several values.")
        .field("values", &Parameter::values)
        .field("choices", &Parameter::choices, "The only values that it takes; empty = any.")
        .field("minimum", &Parameter::minimum, "Smallest value, in its unit.")
        .field("maximum", &Parameter::maximum, "Largest value, in its unit.");
    Struct<Resource>(module, "Resource", "A file that a service needs.")
        .field("name", &Resource::name)
        .field("descr", &Resource::descr)
        .field("ready", &Resource::ready, "True if it was uploaded.")
        .field("required", &Resource::required)
        .field("savable", &Resource::savable)
        .field("size", &Resource::size, "In bytes.");
    Struct<Service>(module, "Service", "A service of an entity.")
        .field("name", &Service::name)
        .field("global_id", &Service::global_id)
        .field("kind", &Service::kind)
        .field("descr", &Service::descr)
        .field("notes", &Service::notes)
        .field("active", &Service::active)
        .field("executing", &Service::executing)
        .field("blocking", &Service::blocking)
        .field("pausable", &Service::pausable)
        .field("inactive_reason", &Service::inactive_reason, "Why it is not active; empty if nobody said so.")
        .field("parameters", &Service::parameters)
        .field("resources", &Service::resources)
        .field("missing", &Service::missing, "Parameters and resources to set or upload before it can run.")
        .field("parts", &Service::parts, "Of a composite service, in order.");
    Struct<Entity>(module, "Entity", "The part of an entity's state that every client may see.")
        .field("id", &Entity::id, "Its UUID.")
        .field("ready", &Entity::ready, "False until its robot application has uploaded valid profiles.")
        .field("name", &Entity::name)
        .field("category", &Entity::category, "\"ROBOT\" or \"MACHINE\".")
        .field("type", &Entity::type, "\"MOBILE\" or \"STATIONARY\".")
        .field("descr", &Entity::descr)
        .field("x_mm", &Entity::x_mm, "Position in millimetres.")
        .field("y_mm", &Entity::y_mm, "Position in millimetres.")
        .field("z_mm", &Entity::z_mm, "Position in millimetres.")
        .field("state", &Entity::state)
        .field("latched", &Entity::latched, "True after a stop, until it is rearmed.")
        .field("stop_generation", &Entity::stop_generation)
        .field("holder", &Entity::holder, "Its id is empty if nobody holds the entity.")
        .field("reason", &Entity::reason, "Why it is not available, or from whom it was taken.")
        .field("orphaned", &Entity::orphaned, "True if its holder is lost and may still come back.")
        .field("waiting", &Entity::waiting, "Number of clients in its wait list.")
        .field("stop_latency", &Entity::stop_latency,
               "Seconds to the application and back, in the server's last drill.");
    Struct<WatchdogMargin>(module, "WatchdogMargin", "How close a watchdog came to tripping.")
        .field("hop", &WatchdogMargin::hop, "Who watches whom.")
        .field("timeout", &WatchdogMargin::timeout, "Seconds of silence after which it stops the robot.")
        .field("longest_gap", &WatchdogMargin::longest_gap,
               "Seconds of the longest silence in the last minute.");
    Struct<EntityFinding>(module, "EntityFinding", "Something that is wrong with an entity, for people.")
        .field("message", &EntityFinding::message)
        .field("fix", &EntityFinding::fix);
    Struct<Details>(module, "Details", "What an entity reports about itself on request.")
        .field("services", &Details::services)
        .field("watchdogs", &Details::watchdogs)
        .field("findings", &Details::findings);
    Struct<TaskReport>(module, "TaskReport", "The progress of a task, or its end.")
        .field("id", &TaskReport::id, "UUID of the task.")
        .field("entity", &TaskReport::entity)
        .field("service", &TaskReport::service)
        .field("state", &TaskReport::state)
        .field("progress", &TaskReport::progress, "0 to 1; negative = not known.")
        .field("feedback", &TaskReport::feedback)
        .field("results", &TaskReport::results)
        .field("reason", &TaskReport::reason, "Why it failed, was stopped, was refused …")
        .field("accepted", &TaskReport::accepted, "True once it is queued or has begun.")
        .property(
            "final", [](const TaskReport& report) { return isFinal(report.state); }, "True if it has ended.");
    Struct<Receipt>(
        module, "Receipt",
        "How far a stop has come, for one entity. Times are seconds since the call; None = not in time.")
        .field("entity", &Receipt::entity)
        .field("name", &Receipt::name)
        .field("stop_generation", &Receipt::stop_generation)
        .field("state", &Receipt::state)
        .field("server", &Receipt::server, "Seconds until the server had it.")
        .field("manager", &Receipt::manager, "Seconds until the Entity Manager had it.")
        .field("callback_returned", &Receipt::callback_returned,
               "Seconds until the robot's stop callback had returned.")
        .field("standstill", &Receipt::standstill, "Seconds until the robot stood still.")
        .field("no_application", &Receipt::no_application, "True if there is no robot application to stop.")
        .field("application_lost", &Receipt::application_lost,
               "Why nobody can confirm that the robot was stopped; empty = no application was lost.")
        .field("application_lost_for", &Receipt::application_lost_for, "Seconds since then.")
        .field("fault", &Receipt::fault, "What the stop callback threw.")
        .field("precision", &Receipt::precision, "Seconds; of the times. 0 = real time.")
        .field("standstill_follows", &Receipt::standstill_follows)
        .field("tasks_ended", &Receipt::tasks_ended)
        .field("tasks_removed", &Receipt::tasks_removed)
        .property(
            "confirmed", [](const Receipt& receipt) { return receipt.confirmed(); },
            "True if the Entity Manager has answered and the robot's stop callback, if any, has returned.")
        .property(
            "at_rest", [](const Receipt& receipt) { return receipt.atRest(); },
            "True if the stop is confirmed and no report of a standstill is outstanding.");
    Struct<DrillReport>(module, "DrillReport",
                        "What a drill has measured for one entity: seconds, one per try; None = no answer.")
        .field("entity", &DrillReport::entity)
        .field("name", &DrillReport::name)
        .field("manager", &DrillReport::manager, "Seconds until the Entity Manager's answer was back.")
        .field("callback", &DrillReport::callback, "Seconds until the robot application's answer was back.")
        .field("no_application", &DrillReport::no_application);
    Struct<HandOverPolicy>(module, "HandOverPolicy",
                           "How requests of others for an entity that this client holds are answered.")
        .field("answer_within", &HandOverPolicy::answer_within,
               "Seconds that the program has to answer, at most 600.")
        .field("yields", &HandOverPolicy::yield,
               "Without an answer: True hands the entity over, False refuses.")
        .field("refuse", &HandOverPolicy::refuse, "Every request is refused at once.")
        .bound()
        .def(py::init([](Seconds answer_within, bool yields, bool refuse) {
                 return HandOverPolicy{answer_within, yields, refuse};
             }),
             py::kw_only(), py::arg("answer_within") = Seconds(30), py::arg("yields") = false,
             py::arg("refuse") = false);
    Struct<HandOverRequest>(module, "HandOverRequest",
                            "Another client asks for an entity that this client holds.")
        .field("by", &HandOverRequest::by)
        .field("reason", &HandOverRequest::reason)
        .field("answer_within", &HandOverRequest::answer_within, "Seconds that are left.")
        .field("yields", &HandOverRequest::yield,
               "Without an answer: True hands the entity over, False refuses.")
        .field("withdrawn", &HandOverRequest::withdrawn, "True if no answer is expected any more.");
    Struct<Waiting>(module, "Waiting", "The progress of a check-out that waits.")
        .field("entity", &Waiting::entity, "UUID; empty if the check-out waits for several entities.")
        .field("place", &Waiting::place, "In the wait list, 1 = next; 0 = not in one.")
        .field("message", &Waiting::message);

    Struct<Argument>(module, "GlobalArgument", "A parameter of a step of a global service.")
        .field("name", &Argument::name)
        .field("values", &Argument::values)
        .field("units", &Argument::units);
    Struct<ParameterSource>(module, "ParameterSource",
                            "Takes an input of a step from an output of an earlier step.")
        .field("parameter", &ParameterSource::parameter)
        .field("step", &ParameterSource::step)
        .field("output", &ParameterSource::output);
    Struct<GlobalStep>(module, "GlobalStep", "A step of a global service.")
        .field("role", &GlobalStep::role, "Number of the role that carries it out.")
        .field("category", &GlobalStep::category)
        .field("type", &GlobalStep::type)
        .field("service_global_id", &GlobalStep::service_global_id)
        .field("preced", &GlobalStep::preced, "Order; steps with equal numbers run at the same time.")
        .field("name", &GlobalStep::name)
        .field("parameters", &GlobalStep::parameters)
        .field("sources", &GlobalStep::sources);
    Struct<GlobalService>(module, "GlobalService", "A job for several entities.")
        .field("name", &GlobalService::name)
        .field("descr", &GlobalService::descr)
        .field("file", &GlobalService::file)
        .field("on_failure", &GlobalService::on_failure)
        .field("steps", &GlobalService::steps)
        .field("compensation", &GlobalService::compensation);
    Struct<GlobalFile>(module, "GlobalFile", "A file in the server's folder of global services.")
        .field("name", &GlobalFile::name)
        .field("findings", &GlobalFile::findings)
        .field("bad", &GlobalFile::bad);
    Struct<GlobalServices>(module, "GlobalServices",
                           "What the server offers, and what it found in its files.")
        .field("services", &GlobalServices::services)
        .field("files", &GlobalServices::files);
    Struct<Unfit>(module, "Unfit", "An entity that cannot play a role now, and why.")
        .field("entity", &Unfit::entity)
        .field("name", &Unfit::name)
        .field("why", &Unfit::why)
        .field("distance", &Unfit::distance, "How much is missing, 1 (least) to 8.");
    Struct<RoleOutlook>(module, "RoleOutlook", "The candidates for one role.")
        .field("role", &RoleOutlook::role)
        .field("wanted", &RoleOutlook::wanted)
        .field("kind", &RoleOutlook::kind)
        .field("able", &RoleOutlook::able, "Names of the entities that could play it now.")
        .field("unfit", &RoleOutlook::unfit)
        .field("entity", &RoleOutlook::entity, "UUID of the entity that is proposed; empty = none.")
        .field("name", &RoleOutlook::name);
    Struct<Proposal>(module, "Proposal", "Which entity could play which role of a global service.")
        .field("roles", &Proposal::roles)
        .field("nobody_offers", &Proposal::nobody_offers)
        .field("why", &Proposal::why)
        .property(
            "complete", [](const Proposal& proposal) { return proposal.complete(); },
            "True if every role has an entity.");
    Struct<StepReport>(module, "StepReport", "The progress of one step of a run.")
        .field("step", &StepReport::step)
        .field("compensation", &StepReport::compensation)
        .field("called", &StepReport::called)
        .field("entity", &StepReport::entity)
        .field("name", &StepReport::name)
        .field("service", &StepReport::service)
        .field("preced", &StepReport::preced)
        .field("state", &StepReport::state, "None = it has not begun.")
        .field("progress", &StepReport::progress)
        .field("feedback", &StepReport::feedback)
        .field("parameters", &StepReport::parameters)
        .field("results", &StepReport::results)
        .field("reason", &StepReport::reason)
        .field("began", &StepReport::began, "Seconds since the launch.")
        .field("ended", &StepReport::ended, "Seconds since the launch.")
        .field("tries", &StepReport::tries);
    Struct<RunProblem>(module, "RunProblem", "Why a run is not possible.")
        .field("step", &RunProblem::step)
        .field("entity", &RunProblem::entity)
        .field("refusal", &RunProblem::refusal);
    Struct<RunReport>(module, "RunReport", "The progress of a run of a global service, or its end.")
        .field("id", &RunReport::id)
        .field("service", &RunReport::service)
        .field("master", &RunReport::master)
        .field("check", &RunReport::check)
        .field("state", &RunReport::state)
        .field("progress", &RunReport::progress)
        .field("elapsed", &RunReport::elapsed, "Seconds since the launch.")
        .field("steps", &RunReport::steps)
        .field("problems", &RunReport::problems)
        .field("reason", &RunReport::reason)
        .property(
            "final", [](const RunReport& report) { return isFinal(report.state); }, "True if it has ended.");
    Struct<Participant>(module, "Participant", "The entity that played a role.")
        .field("role", &Participant::role)
        .field("entity", &Participant::entity)
        .field("name", &Participant::name);
    Struct<RunRecord>(module, "RunRecord", "A past run and its result.")
        .field("id", &RunRecord::id)
        .field("service", &RunRecord::service)
        .field("by", &RunRecord::by)
        .field("master", &RunRecord::master)
        .field("participants", &RunRecord::participants)
        .field("asked_at", &RunRecord::asked_at, "Seconds since 1970, on the client's clock.")
        .field("duration", &RunRecord::duration, "Seconds.")
        .field("state", &RunRecord::state)
        .field("reason", &RunRecord::reason)
        .field("steps", &RunRecord::steps);
    Struct<RunHistory>(module, "RunHistory", "Past runs, newest first.")
        .field("runs", &RunHistory::runs)
        .field("silent", &RunHistory::silent, "Entities that have not answered: name and reason.");
}

}  // namespace axon::python
