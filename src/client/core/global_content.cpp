// SPDX-License-Identifier: GPL-2.0-or-later
// content.hpp: global services and their runs.
#include <algorithm>

#include "client/core/content.hpp"
#include "messages/values.hpp"

namespace axon::client {
namespace {

std::map<std::string, std::vector<Value>> fromProto(
    const google::protobuf::RepeatedPtrField<proto::Param>& params) {
    std::map<std::string, std::vector<Value>> all;
    for (const auto& param : params) {
        auto& values = all[param.name()];
        for (const auto& value : param.values()) values.push_back(client::fromProto(value));
    }
    return all;
}

std::optional<Seconds> since(double seconds) {
    return seconds < 0 ? std::nullopt : std::optional(Seconds(seconds));
}

GlobalStep fromProto(const proto::GlobalStep& step) {
    GlobalStep out;
    out.role = step.role();
    if (step.category() != proto::CATEGORY_UNSPECIFIED) out.category = proto::Category_Name(step.category());
    if (step.type() != proto::MOBILITY_UNSPECIFIED) out.type = proto::Mobility_Name(step.type());
    out.service_global_id = step.service_global_id();
    out.preced = step.preced();
    out.name = step.name();
    for (const auto& param : step.params()) {
        auto& argument = out.parameters.emplace_back();
        argument.name = param.name();
        argument.units = param.units();
        argument.from_text = true;
        for (const auto& value : param.values()) argument.values.push_back(client::fromProto(value));
    }
    for (const auto& source : step.sources())
        out.sources.push_back({source.param(), source.step(), source.output()});
    return out;
}

proto::GlobalStep toProto(const GlobalStep& step) {
    proto::GlobalStep out;
    auto category = proto::CATEGORY_UNSPECIFIED;
    auto mobility = proto::MOBILITY_UNSPECIFIED;
    if (proto::Category_Parse(step.category, &category)) out.set_category(category);
    if (proto::Mobility_Parse(step.type, &mobility)) out.set_type(mobility);
    out.set_role(step.role);
    out.set_service_global_id(step.service_global_id);
    out.set_preced(step.preced);
    out.set_name(step.name);
    for (const auto& argument : step.parameters) {
        auto& param = *out.add_params();
        param.set_name(argument.name);
        param.set_units(argument.units);
        for (const auto& value : argument.values) param.add_values()->set_str(toText(value));
    }
    for (const auto& source : step.sources) {
        auto& to = *out.add_sources();
        to.set_param(source.parameter);
        to.set_step(source.step);
        to.set_output(source.output);
    }
    return out;
}

}  // namespace

const char* toString(OnFailure on_failure) {
    switch (on_failure) {
        case OnFailure::StopAll:
            return "stop-all";
        case OnFailure::HoldOthers:
            return "hold-others";
        case OnFailure::Compensate:
            return "compensate";
    }
    return "stop-all";
}

const char* toString(RunState state) {
    switch (state) {
        case RunState::Checking:
            return "CHECKING";
        case RunState::Running:
            return "RUNNING";
        case RunState::Paused:
            return "PAUSED";
        case RunState::Held:
            return "HELD";
        case RunState::Stopping:
            return "STOPPING";
        case RunState::Compensating:
            return "COMPENSATING";
        case RunState::Succeeded:
            return "SUCCEEDED";
        case RunState::Failed:
            return "FAILED";
        case RunState::Stopped:
            return "STOPPED";
        case RunState::Cancelled:
            return "CANCELLED";
        case RunState::Refused:
            return "REFUSED";
        case RunState::Unknown:
            return "UNKNOWN";
    }
    return "UNKNOWN";
}

std::optional<RunState> runStateFromProto(proto::RunState state) {
    if (state < proto::RUN_CHECKING || state > proto::RUN_UNKNOWN) return std::nullopt;
    return static_cast<RunState>(static_cast<int>(state));
}

GlobalService fromProto(const proto::GlobalService& service) {
    GlobalService out;
    out.name = service.name();
    out.descr = service.descr();
    if (service.on_failure() == proto::HOLD_OTHERS) out.on_failure = OnFailure::HoldOthers;
    if (service.on_failure() == proto::COMPENSATE) out.on_failure = OnFailure::Compensate;
    for (const auto& step : service.steps()) out.steps.push_back(fromProto(step));
    for (const auto& step : service.compensation()) out.compensation.push_back(fromProto(step));
    return out;
}

proto::GlobalService toProto(const GlobalService& service) {
    proto::GlobalService out;
    out.set_name(service.name);
    out.set_descr(service.descr);
    out.set_on_failure(service.on_failure == OnFailure::HoldOthers   ? proto::HOLD_OTHERS
                       : service.on_failure == OnFailure::Compensate ? proto::COMPENSATE
                                                                     : proto::STOP_ALL);
    for (const auto& step : service.steps) *out.add_steps() = toProto(step);
    for (const auto& step : service.compensation) *out.add_compensation() = toProto(step);
    return out;
}

GlobalServices fromProto(const proto::GlobalServices& services) {
    GlobalServices out;
    for (const auto& file : services.files()) {
        out.files.push_back({file.name(), {file.findings().begin(), file.findings().end()}, file.bad()});
        if (file.bad()) continue;
        for (const auto& service : file.profile().services()) {
            out.services.push_back(fromProto(service));
            out.services.back().file = file.name();
        }
    }
    return out;
}

StepReport fromProto(const proto::StepStatus& status) {
    StepReport out;
    out.step = status.step();
    out.entity = status.entity();
    out.name = status.name();
    out.service = status.service();
    out.preced = status.preced();
    out.state = taskStateFromProto(status.state());
    out.progress = status.progress() + 0.0;  // makes -0 a 0
    out.feedback = status.feedback();
    out.parameters = fromProto(status.params());
    out.results = fromProto(status.results());
    out.reason = toRefusal(status.reason());
    // A step whose turn has not come has no times, whatever its fields are by default.
    if (out.state) out.began = since(status.began_s());
    if (out.state && isFinal(*out.state)) out.ended = since(status.ended_s());
    out.tries = static_cast<int>(std::max(status.tries(), 1U));
    return out;
}

RunProblem fromProto(const proto::Problem& problem) {
    return {problem.step(), problem.entity(), toRefusal(problem.refusal())};
}

RunRecord fromProto(const proto::RunRecord& record) {
    RunRecord out;
    if (const auto id = Id128::fromBytes(record.run_id())) out.id = id->toString();
    out.service = fromProto(record.service());
    out.by = record.by();
    out.master = record.master();
    for (const auto& one : record.participants())
        out.participants.push_back({one.role(), one.entity(), one.name()});
    out.asked_at = std::chrono::system_clock::time_point(std::chrono::milliseconds(record.asked_at_ms()));
    out.duration = Seconds(record.duration_s());
    out.state = runStateFromProto(record.state()).value_or(RunState::Unknown);
    out.reason = toRefusal(record.reason());
    for (const auto& status : record.steps()) {
        auto& step = out.steps.emplace_back(fromProto(status));
        step.compensation = step.step >= record.service().steps_size();
        if (step.step >= 0 && !step.compensation)
            step.called = out.service.steps[static_cast<std::size_t>(step.step)].name;
    }
    std::stable_sort(out.steps.begin(), out.steps.end(),
                     [](const StepReport& a, const StepReport& b) { return a.step < b.step; });
    return out;
}

Proposal toPublic(collaboration::Proposal found) {
    Proposal proposal;
    proposal.nobody_offers = std::move(found.nobody_offers);
    proposal.why = std::move(found.why);
    for (auto& role : found.roles) {
        auto& outlook = proposal.roles.emplace_back();
        outlook.role = role.role;
        outlook.wanted = std::move(role.wanted);
        outlook.kind = std::move(role.kind);
        outlook.able = std::move(role.able);
        for (auto& one : role.unfit)
            outlook.unfit.push_back(
                {std::move(one.entity), std::move(one.name), std::move(one.why), one.distance});
        outlook.entity = std::move(role.entity);
        outlook.name = std::move(role.name);
    }
    return proposal;
}

std::vector<collaboration::Role> rolesOf(const GlobalService& service) {
    std::vector<collaboration::Role> roles;
    for (const auto* steps : {&service.steps, &service.compensation}) {
        for (const auto& step : *steps) {
            auto role = std::find_if(roles.begin(), roles.end(),
                                     [&](const auto& one) { return one.number == step.role; });
            if (role == roles.end()) {
                roles.push_back({step.role, step.category, step.type, {}});
                role = roles.end() - 1;
            }
            collaboration::Need need{step.service_global_id, {}};
            for (const auto& argument : step.parameters) need.given.push_back(argument.name);
            for (const auto& source : step.sources) need.given.push_back(source.parameter);
            role->needs.push_back(std::move(need));
        }
    }
    return roles;
}

}  // namespace axon::client
