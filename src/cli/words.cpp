// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/words.hpp"

#include <algorithm>
#include <cctype>
#include <set>
#include <utility>

#include "common/refusal.hpp"

namespace axon::cli {
namespace {

Json toJson(const std::vector<Value>& values) {
    auto list = Json::array();
    for (const auto& value : values) list.push_back(cli::toJson(value));
    return list;
}

Json toJson(const std::map<std::string, std::vector<Value>>& values) {
    auto json = Json::object();
    for (const auto& [name, list] : values) json[name] = toJson(list);
    return json;
}

Json toJson(const Parameter& parameter) {
    Json json{{"name", parameter.name},
              {"type", toString(parameter.kind)},
              {"data_type", toString(parameter.data_type)},
              {"units", parameter.units},
              {"descr", parameter.descr},
              {"ready", parameter.ready},
              {"required", parameter.required},
              {"savable", parameter.savable},
              {"multiple", parameter.multiple},
              {"values", toJson(parameter.values)}};
    if (!parameter.choices.empty()) json["choices"] = toJson(parameter.choices);
    if (parameter.minimum) json["minimum"] = *parameter.minimum;
    if (parameter.maximum) json["maximum"] = *parameter.maximum;
    return json;
}

Json milliseconds(const std::optional<Seconds>& time) {
    return time ? Json(time->count() * 1000) : Json(nullptr);
}

/// What a person can do about it; empty where the message says it.
std::string fixFor(const Refusal& refusal, const std::string& entity) {
    return remedyFor(refusal.code, entity.empty() ? "ENTITY" : shellWord(entity),
                     refusal.holder.empty() ? "its holder" : refusal.holder);
}

}  // namespace

Json toJson(const Value& value) {
    return std::visit([](const auto& held) { return Json(held); }, value);
}

Json toJson(const Entity& entity, bool yours) {
    Json json{{"id", entity.id},
              {"name", entity.name},
              {"ready", entity.ready},
              {"category", entity.category},
              {"type", entity.type},
              {"descr", entity.descr},
              {"x_mm", entity.x_mm},
              {"y_mm", entity.y_mm},
              {"z_mm", entity.z_mm},
              {"state", axon::toString(entity.state)},
              {"latched", entity.latched},
              {"stop_generation", entity.stop_generation},
              {"holder", entity.holder.name},
              {"holder_id", entity.holder.id},
              {"yours", yours},
              {"reason", entity.reason},
              {"orphaned", entity.orphaned},
              {"waiting", entity.waiting},
              {"stop_latency_ms", milliseconds(entity.stop_latency)}};
    return json;
}

Json toJson(const Service& service) {
    auto parameters = Json::array();
    for (const auto& parameter : service.parameters) parameters.push_back(toJson(parameter));
    auto resources = Json::array();
    for (const auto& resource : service.resources) {
        resources.push_back({{"name", resource.name},
                             {"descr", resource.descr},
                             {"ready", resource.ready},
                             {"required", resource.required},
                             {"savable", resource.savable},
                             {"size", resource.size}});
    }
    return {{"name", service.name},
            {"global_id", service.global_id},
            {"type", toString(service.kind)},
            {"descr", service.descr},
            {"notes", service.notes},
            {"active", service.active},
            {"inactive_reason", service.inactive_reason},
            {"executing", service.executing},
            {"blocking", service.blocking},
            {"pausable", service.pausable},
            {"parameters", std::move(parameters)},
            {"resources", std::move(resources)},
            {"missing", service.missing},
            {"parts", service.parts}};
}

Json reasonOf(const Refusal& refusal) {
    if (refusal.ok()) return nullptr;
    Json json{{"code", refusalName(refusal.code)}, {"message", refusal.message}};
    if (!refusal.holder.empty()) json["holder"] = refusal.holder;
    return json;
}

Json toJson(const TaskReport& report) {
    Json json{{"event", "task"},
              {"id", report.id},
              {"entity", report.entity},
              {"service", report.service},
              {"state", client::toString(report.state)},
              {"final", client::isFinal(report.state)},
              {"progress", report.progress < 0 ? -1 : report.progress + 0.0},
              {"feedback", report.feedback},
              {"results", toJson(report.results)},
              {"reason", reasonOf(report.reason)}};
    return json;
}

Json taskEvent(const TaskReport& report, const std::string& entity, Seconds elapsed) {
    auto event = toJson(report);
    event["entity_id"] = report.entity;
    event["entity"] = entity;
    event["elapsed_s"] = elapsed.count();
    if (!report.reason.ok()) {
        const auto error = errorEvent(report.reason, entity);
        if (error.contains("fix")) event["fix"] = error["fix"];
        event["reason"]["message"] = error["message"];  // without the fix that it may have had
    }
    return event;
}

Json unitsOf(const Service& service) {
    auto units = Json::object();
    for (const auto& parameter : service.parameters) {
        if (!parameter.units.empty()) units[parameter.name] = parameter.units;
    }
    return units;
}

Json feedbackOf(const Service& service) {
    auto names = Json::array();
    for (const auto& parameter : service.parameters)
        if (parameter.kind == client::ParameterKind::Feedback) names.push_back(parameter.name);
    return names;
}

Json toJson(const StepReport& step) {
    const auto seconds = [](const std::optional<Seconds>& time) {
        return time ? Json(time->count()) : Json(nullptr);
    };
    return {{"step", step.step},
            {"called", step.called},
            {"entity", step.name},
            {"entity_id", step.entity},
            {"service", step.service},
            {"preced", step.preced},
            {"compensation", step.compensation},
            {"state", step.state ? Json(client::toString(*step.state)) : Json(nullptr)},
            {"progress", step.progress < 0 ? -1 : step.progress + 0.0},
            {"feedback", step.feedback},
            {"parameters", toJson(step.parameters)},
            {"results", toJson(step.results)},
            {"reason", reasonOf(step.reason)},
            {"began_s", seconds(step.began)},
            {"ended_s", seconds(step.ended)},
            {"tries", step.tries}};
}

Json toJson(const RunReport& report) {
    auto steps = Json::array();
    std::string master;
    for (const auto& step : report.steps) {
        steps.push_back(toJson(step));
        if (step.entity == report.master) master = step.name;
    }
    auto problems = Json::array();
    for (const auto& problem : report.problems) {
        Json json{{"step", problem.step < 0 ? Json(nullptr) : Json(problem.step)},
                  {"called", ""},
                  {"service", ""},
                  {"entity", problem.entity}};
        for (const auto& step : report.steps) {
            if (step.step != problem.step) continue;
            json["called"] = step.called;
            json["service"] = step.service;
            if (problem.entity.empty()) json["entity"] = step.name;
        }
        const auto error = errorEvent(problem.refusal, json["entity"].get<std::string>());
        for (const auto* member : {"code", "message", "holder", "fix"}) {
            if (error.contains(member)) json[member] = error[member];
        }
        problems.push_back(std::move(json));
    }
    return {{"event", "run"},
            {"id", report.id},
            {"service", report.service},
            {"master", master},
            {"master_id", report.master},
            {"check", report.check},
            {"state", client::toString(report.state)},
            {"final", client::isFinal(report.state)},
            {"progress", report.progress},
            {"elapsed_s", report.elapsed.count()},
            {"steps", std::move(steps)},
            {"problems", std::move(problems)},
            {"reason", reasonOf(report.reason)}};
}

namespace {

Json toJson(const std::vector<client::GlobalStep>& steps) {
    auto list = Json::array();
    for (const auto& step : steps) {
        auto parameters = Json::object();
        auto units = Json::object();
        for (const auto& argument : step.parameters) {
            parameters[argument.name] = toJson(argument.values);
            if (!argument.units.empty()) units[argument.name] = argument.units;
        }
        auto sources = Json::array();
        for (const auto& source : step.sources) {
            sources.push_back(
                {{"parameter", source.parameter}, {"step", source.step}, {"output", source.output}});
        }
        list.push_back({{"role", step.role},
                        {"category", step.category},
                        {"type", step.type},
                        {"service", step.service_global_id},
                        {"preced", step.preced},
                        {"called", step.name},
                        {"parameters", std::move(parameters)},
                        {"units", std::move(units)},
                        {"sources", std::move(sources)}});
    }
    return list;
}

}  // namespace

Json toJson(const GlobalService& service) {
    std::set<int> roles;
    for (const auto* steps : {&service.steps, &service.compensation})
        for (const auto& step : *steps) roles.insert(step.role);
    return {{"name", service.name},
            {"descr", service.descr},
            {"file", service.file},
            {"on_failure", client::toString(service.on_failure)},
            {"roles", roles},
            {"steps", toJson(service.steps)},
            {"compensation", toJson(service.compensation)}};
}

Json toJson(const RunRecord& record, bool with_steps) {
    using std::chrono::duration_cast;
    using std::chrono::milliseconds;
    auto participants = Json::array();
    std::string master;
    for (const auto& one : record.participants) {
        participants.push_back({{"role", one.role}, {"entity", one.name}, {"entity_id", one.entity}});
        if (one.entity == record.master) master = one.name;
    }
    Json json{{"id", record.id},
              {"service", record.service.name},
              {"by", record.by},
              {"master", master},
              {"master_id", record.master},
              {"participants", std::move(participants)},
              {"asked_at_ms", duration_cast<milliseconds>(record.asked_at.time_since_epoch()).count()},
              {"duration_s", record.duration.count()},
              {"state", client::toString(record.state)},
              {"final", client::isFinal(record.state)},
              {"reason", reasonOf(record.reason)}};
    if (!with_steps) return json;
    json["event"] = "run_record";
    json["steps"] = Json::array();
    for (const auto& step : record.steps) json["steps"].push_back(toJson(step));
    json["global_service"] = toJson(record.service);
    return json;
}

Json toJson(const Receipt& receipt) {
    return {{"entity", receipt.entity},
            {"name", receipt.name},
            {"confirmed", receipt.confirmed()},
            {"stop_generation", receipt.stop_generation},
            {"state", axon::toString(receipt.state)},
            {"server_ms", milliseconds(receipt.server)},
            {"manager_ms", milliseconds(receipt.manager)},
            {"callback_returned_ms", milliseconds(receipt.callback_returned)},
            {"standstill_ms", milliseconds(receipt.standstill)},
            {"precision_ms", receipt.precision.count() * 1000},
            {"standstill_follows", receipt.standstill_follows},
            {"no_application", receipt.no_application},
            {"application_lost", receipt.application_lost},
            {"application_lost_s",
             receipt.application_lost_for ? Json(receipt.application_lost_for->count()) : Json()},
            {"fault", receipt.fault}};
}

Json toJson(const HandOverRequest& request, const std::string& entity, const std::string& answer) {
    return {{"event", "hand_over"},
            {"entity", entity},
            {"by", request.by},
            {"reason", request.reason},
            {"answer_within_s", request.answer_within.count()},
            {"yield", request.yield},
            {"withdrawn", request.withdrawn},
            {"answer", answer.empty() ? Json(nullptr) : Json(answer + " " + shellWord(entity))}};
}

std::pair<std::string, std::string> parted(const std::string& message) {
    constexpr std::string_view kMark = "; fix: ";
    const auto mark = message.find(kMark);
    if (mark == std::string::npos) return {message, {}};
    return {message.substr(0, mark), message.substr(mark + kMark.size())};
}

Json errorEvent(const Refusal& refusal, const std::string& entity) {
    auto [message, fix] = parted(refusal.message);
    Json json{{"event", "error"}, {"code", refusalName(refusal.code)}, {"message", std::move(message)}};
    if (!refusal.holder.empty()) json["holder"] = refusal.holder;
    if (fix.empty()) fix = fixFor(refusal, entity);
    if (!fix.empty()) json["fix"] = std::move(fix);
    return json;
}

Json usageEvent(const std::string& message, const std::string& fix) {
    auto [what, its_fix] = parted(message);
    Json json{{"event", "error"}, {"code", "USAGE"}, {"message", std::move(what)}};
    if (!its_fix.empty()) {
        json["fix"] = std::move(its_fix);
    } else if (!fix.empty()) {
        json["fix"] = fix;
    }
    return json;
}

Json noServerEvent(const Refusal& refusal, const std::string& server) {
    auto [message, fix] = parted(refusal.message);
    // Of a server that is not there, the command knows better how to name another one. Otherwise a fix of the
    // message is about what has happened, and a server that has answered says the remedy itself.
    const bool answered = refusal.code == RefusalCode::PermissionDenied ||
                          refusal.code == RefusalCode::Malformed || refusal.code == RefusalCode::NotSupported;
    if (message.ends_with("nothing listens there") || (fix.empty() && !answered)) {
        fix = server.find("/router:") == std::string::npos
                  ? "start a server with axon-server, or give the address of another one with "
                    "--server HOST:PORT (or AXON_SERVER)"
                  : "check that the router and a server behind it are running at the address in "
                    "--config (or AXON_CONFIG): "
                    "axon-cluster status, or the logs of glacier2router and axon-server";
    }
    if (message.empty()) message = "no server at " + server;
    Json json{{"event", "error"}, {"code", refusalName(refusal.code)}, {"message", std::move(message)}};
    if (!fix.empty()) json["fix"] = std::move(fix);
    return json;
}

int exitOf(const Refusal& refusal) {
    return refusalEntry(refusal.code).exit;
}

int exitOf(TaskState state, const Refusal& reason) {
    switch (state) {
        case TaskState::Succeeded:
            return kDone;
        case TaskState::Stopped:
        case TaskState::Cancelled:
            return kStopped;
        case TaskState::Refused:
            return reason.ok() ? static_cast<int>(kRefused) : exitOf(reason);
        case TaskState::Failed:
            return kRefused;
        default:
            return kNotConfirmed;
    }
}

int exitOf(RunState state, const Refusal& reason) {
    switch (state) {
        case RunState::Succeeded:
            return kDone;
        case RunState::Stopped:
        case RunState::Cancelled:
            return kStopped;
        case RunState::Refused:
            return reason.ok() ? static_cast<int>(kRefused) : exitOf(reason);
        case RunState::Failed:
            return kRefused;
        default:
            return kNotConfirmed;
    }
}

std::string callName(const Entity& entity, const std::vector<Entity>& all) {
    std::vector<std::string> same;
    bool taken = false;  // by one that is ready, and this one is not
    for (const auto& other : all) {
        if (other.name != entity.name) continue;
        if (other.ready == entity.ready) same.push_back(other.id);
        taken = taken || other.ready != entity.ready;
    }
    if (!entity.ready) return taken || same.size() > 1 ? entity.id.substr(0, 8) : entity.name;
    if (same.size() < 2) return entity.name;
    std::sort(same.begin(), same.end());
    const auto place = std::find(same.begin(), same.end(), entity.id) - same.begin();
    return entity.name + "#" + std::to_string(place + 1);
}

std::string shellWord(const std::string& word) {
    const auto plain = [](char c) {
        return std::isalnum(static_cast<unsigned char>(c)) != 0 ||
               std::string_view("_-./:=,#@%+").find(c) != std::string_view::npos;
    };
    if (!word.empty() && word.front() != '#' && std::all_of(word.begin(), word.end(), plain)) return word;
    std::string quoted = "'";
    for (const char c : word) {
        if (c == '\'') {
            quoted += "'\\''";
        } else {
            quoted += c;
        }
    }
    return quoted + "'";
}

std::string line(const Json& json) {
    return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace axon::cli
