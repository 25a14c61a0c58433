// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/runs.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "client/core/content.hpp"
#include "client/core/entities.hpp"
#include "client/core/leases.hpp"
#include "client/core/server_watch.hpp"
#include "client/core/task_control.hpp"
#include "collaboration/sub_lease.hpp"
#include "messages/values.hpp"

namespace axon::client {
namespace {

/// More than any service has, and few enough to be kept.
constexpr int kStepsMax = 4096;

std::string listed(const std::vector<std::string>& names) {
    std::string text;
    for (std::size_t i = 0; i < names.size(); ++i)
        text += (i == 0 ? "" : i + 1 == names.size() ? " and " : ", ") + names[i];
    return text;
}

/// Why a value of one parameter can never be one of another; nothing where it may.
std::string misfit(const proto::CtrlParam& output, const proto::CtrlParam& input) {
    const auto numeric = [](const proto::CtrlParam& param) {
        return param.data_type() == proto::INT || param.data_type() == proto::DBL;
    };
    if (output.data_type() != input.data_type() && !(numeric(output) && numeric(input)))
        return proto::DataType_Name(output.data_type()) + " is not " +
               proto::DataType_Name(input.data_type());
    if (output.units() != input.units() && !output.units().empty() && !input.units().empty())
        return output.units() + " is not " + input.units();
    return {};
}

void merge(std::vector<StepReport>& steps, StepReport changed) {
    const auto place = std::lower_bound(steps.begin(), steps.end(), changed.step,
                                        [](const StepReport& a, int step) { return a.step < step; });
    if (place != steps.end() && place->step == changed.step) {
        // What the service says of it does not travel; nor, in a record that was too large, what is long.
        changed.compensation = place->compensation;
        changed.called = place->called;
        if (changed.tries == place->tries) {
            if (changed.parameters.empty()) changed.parameters = std::move(place->parameters);
            if (changed.results.empty()) changed.results = std::move(place->results);
            if (changed.feedback.empty()) changed.feedback = std::move(place->feedback);
        }
        *place = std::move(changed);
    } else {
        steps.insert(place, std::move(changed));
    }
}

}  // namespace

void Runs::fetchServices(GlobalServicesDone done) {
    if (!parts_.context.connected) return done(CoreContext::notConnected());
    const auto id = Id128::random(parts_.context.random);
    proto::ToEntity body;
    body.mutable_global_services()->set_request_id(id.bytes());
    const auto head = parts_.context.header({}, kMsgGlobalServices);
    parts_.context.link.sendRequest(head, body.SerializeAsString());
    parts_.requests.await(id,
                          {.sequence = head.sequence, .what = request::FetchGlobalServices{std::move(done)}});
}

void Runs::onServices(const proto::GlobalServices& services) {
    const auto id = Id128::fromBytes(services.request_id());
    if (!id) return;
    if (auto pending = parts_.requests.take<request::FetchGlobalServices>(*id))
        pending->as<request::FetchGlobalServices>().done(fromProto(services));
}

Refusal Runs::misfits(const RunOrder& order) const {
    const auto parameter = [&](const GlobalStep& step, const std::string& name) -> const proto::CtrlParam* {
        const auto& offered = parts_.leases.of(order.players.at(step.role))->services;
        const auto* service = findService(offered, step.service_global_id);
        if (service == nullptr) return nullptr;  // the participant will say so
        const auto index = findParamIndex(*service, name);
        return index ? &service->params(index.value()) : nullptr;
    };
    std::string all;
    for (const auto* steps : {&order.service.steps, &order.service.compensation}) {
        for (const auto& step : *steps) {
            for (const auto& source : step.sources) {
                const auto from =
                    std::find_if(order.service.steps.begin(), order.service.steps.end(),
                                 [&](const GlobalStep& other) { return other.name == source.step; });
                if (from == order.service.steps.end()) continue;
                const auto* output = parameter(*from, source.output);
                const auto* input = parameter(step, source.parameter);
                const auto why =
                    output != nullptr && input != nullptr ? misfit(*output, *input) : std::string();
                if (why.empty()) continue;
                all += (all.empty() ? "" : " ") + parts_.entities.label(order.players.at(step.role)) + ": '" +
                       source.parameter + "' of " + step.service_global_id + " cannot take '" +
                       source.output + "' of the step '" + source.step + "': " + why + ".";
            }
        }
    }
    if (all.empty()) return {};
    return {RefusalCode::WrongType, all, {}};
}

Result<Id128> Runs::run(const RunOrder& order) {
    if (!parts_.context.connected) return CoreContext::notConnected();
    const auto malformed = [](std::string what) {
        return Refusal{RefusalCode::Malformed, std::move(what), {}};
    };
    const auto roles = rolesOf(order.service);
    for (const auto& role : roles) {
        if (order.players.count(role.number) == 0) {
            return malformed("Nobody plays role " + std::to_string(role.number) +
                             ". Bind an entity to each role.");
        }
    }
    std::set<std::string> players;
    std::vector<std::string> strangers;
    std::set<std::string> roots;
    for (const auto& [number, entity] : order.players) {
        const bool known = std::any_of(roles.begin(), roles.end(),
                                       [number = number](const auto& role) { return role.number == number; });
        if (!known) return malformed("The service has no role " + std::to_string(number) + ".");
        if (!players.insert(entity).second) {
            return Refusal{
                RefusalCode::Duplicate,
                parts_.entities.label(entity) + " plays two roles. Each role needs an entity of its own.",
                {}};
        }
        const auto* mine = parts_.leases.of(entity);
        if (mine == nullptr) {
            strangers.push_back(parts_.entities.label(entity));
            continue;
        }
        if (auto refusal = parts_.leases.ready({entity, mine->number}); !refusal.ok()) return refusal;
        if (mine->key.size() != 16 || mine->root.size() != 16) {
            return Refusal{RefusalCode::NotSupported,
                           mine->name +
                               " has given no key or no root for its lease, so nobody else can "
                               "be let command it. Update its Entity Manager.",
                           {}};
        }
        roots.insert(mine->root);
    }
    if (!strangers.empty()) {
        return Refusal{
            RefusalCode::NotHolder,
            "This client does not hold " + listed(strangers) + ". Check out every participant first.",
            {}};
    }
    if (players.count(order.master) == 0)
        return malformed("The master must be one of the participants; " +
                         parts_.entities.label(order.master) + " is none.");
    if (roots.size() > 1) {
        return Refusal{RefusalCode::WrongState,
                       "The participants were checked out by different sessions. Release them and check them "
                       "all out by one.",
                       {}};
    }

    if (auto refusal = misfits(order); !refusal.ok()) return refusal;

    const auto id = Id128::uuid(parts_.context.random);
    proto::ToEntity body;
    auto& request = *body.mutable_collaboration();
    request.set_run_id(id.bytes());
    *request.mutable_service() = toProto(order.service);
    request.set_check_only(order.check_only);
    request.set_asked_at_ms(order.asked_at_ms);
    for (const auto& [number, entity] : order.players) {
        const auto& mine = *parts_.leases.of(entity);
        auto& participant = *request.add_participants();
        participant.set_role(number);
        participant.set_entity(entity);
        participant.set_name(parts_.entities.label(entity));
        auto& lease = *participant.mutable_lease();
        lease.set_epoch(static_cast<std::uint32_t>(mine.number.epoch));
        lease.set_number(static_cast<std::uint32_t>(mine.number.number));
        lease.set_root(mine.root);
        lease.set_stop_generation(static_cast<std::uint32_t>(parts_.context.marks.of(entity)));
        collaboration::seal(lease, {request.run_id(), order.master, entity}, mine.key);
    }

    auto& entry = runs_[id];
    open_.insert(id);
    entry.master = {order.master, parts_.leases.of(order.master)->number};
    auto& report = entry.report;
    report.id = id.toString();
    report.service = order.service.name;
    report.master = order.master;
    report.check = order.check_only;
    for (const auto* steps : {&order.service.steps, &order.service.compensation}) {
        for (const auto& step : *steps) {
            auto& of_step = report.steps.emplace_back();
            of_step.step = static_cast<int>(report.steps.size()) - 1;
            of_step.compensation = steps == &order.service.compensation;
            of_step.called = step.name;
            of_step.entity = order.players.at(step.role);
            of_step.name = parts_.entities.label(of_step.entity);
            of_step.service = step.service_global_id;
            of_step.preced = step.preced;
        }
    }
    const auto sequence = parts_.context.send(order.master, kMsgRun, entry.master.lease, body);
    parts_.requests.await(id, {.entity = order.master,
                               .lease = entry.master.lease,
                               .sequence = sequence,
                               .what = request::StartRun{}});
    parts_.server.pace();
    return id;
}

std::optional<RunReport> Runs::report(const Id128& id) const {
    const auto found = runs_.find(id);
    if (found == runs_.end()) return std::nullopt;
    return found->second.report;
}

std::vector<Id128> Runs::open(const Held& master) const {
    std::vector<Id128> open;
    for (const auto id : open_) {
        if (runs_.at(id).master == master) open.push_back(id);
    }
    return open;
}

void Runs::onEvent(const std::string& entity, const proto::RunEvent& event) {
    const auto id = Id128::fromBytes(event.run_id());
    const auto state = runStateFromProto(event.state());
    if (!id || !state) {
        ++parts_.context.malformed;
        return;
    }
    const auto found = runs_.find(*id);
    if (found == runs_.end() || found->second.master.entity != entity) return;
    parts_.requests.settle<request::StartRun>(*id, {});
    auto& entry = found->second;
    auto& report = entry.report;
    if (isFinal(report.state)) {
        // Given up here, alive there: a run whose outcome this client has called unknown must not go on.
        if (report.state == RunState::Unknown && !isFinal(*state) && parts_.leases.holds(entry.master))
            sendControl(parts_.context, *id, entry.master, proto::CANCEL);
        return;
    }
    // It lives: nobody need be asked after it.
    for (const auto key : parts_.requests.of(entity)) {
        if (auto* after = std::get_if<request::AskAfterRuns>(&parts_.requests.find(key)->what))
            std::erase(after->runs, *id);
    }
    if (event.sequence() <= entry.sequence) return;  // a duplicate
    entry.sequence = event.sequence();
    report.state = *state;
    report.progress = std::clamp(event.progress(), 0.0, 1.0);
    report.elapsed = Seconds(event.at_s());
    for (const auto& status : event.steps()) {
        if (status.step() < 0 || status.step() >= kStepsMax) {
            ++parts_.context.malformed;
            continue;
        }
        merge(report.steps, fromProto(status));
    }
    if (event.has_reason()) {
        report.reason = toRefusal(event.reason());
    } else if (*state == RunState::Running) {
        report.reason = {};  // why it had been held
    }
    if (event.problems_size() > 0) {
        report.problems.clear();
        for (const auto& problem : event.problems()) report.problems.push_back(fromProto(problem));
        std::stable_sort(report.problems.begin(), report.problems.end(),
                         [](const RunProblem& a, const RunProblem& b) { return a.step < b.step; });
    }
    if (!isFinal(*state) && !parts_.leases.holds(entry.master)) awaitEnd(*id);
    tell(*id);
}

void Runs::awaitEnd(Id128 id) {
    if (parts_.requests.contains(Requests::keyOf<request::StartRun>(id))) return;
    const auto& master = runs_.at(id).master;
    parts_.requests.await(id, {.entity = master.entity, .lease = master.lease, .what = request::StartRun{}});
}

void Runs::awaitEnds(const Held& master) {
    for (const auto run : open(master)) awaitEnd(run);
}

void Runs::tell(Id128 id) {
    // A copy: the oldest that is over is forgotten.
    const auto report = runs_.at(id).report;
    if (isFinal(report.state) && open_.erase(id) != 0) {
        finished_.push_back(id);
        while (finished_.size() > std::max<std::size_t>(parts_.context.settings.runs_kept, 1)) {
            runs_.erase(finished_.front());
            finished_.pop_front();
        }
    }
    // The report first: whoever waited for the pause finds the run paused.
    parts_.context.observer.onRun(report);
    settleControl(parts_.requests, id, report.state, "run");
    parts_.server.pace();
}

void Runs::finish(Id128 id, RunState state, const Refusal& why) {
    const auto found = runs_.find(id);
    if (found == runs_.end() || isFinal(found->second.report.state)) return;
    parts_.requests.settle<request::StartRun>(id, {});
    auto& report = found->second.report;
    report.state = state;
    report.reason = why;
    for (auto& step : report.steps) {
        // Of what was under way nothing more is heard.
        if (step.state && !isFinal(*step.state)) step.state = TaskState::Unknown;
    }
    tell(id);
}

void Runs::finishAll(const Held& master, const Refusal& unknown) {
    for (const auto run : open(master)) finish(run, RunState::Unknown, unknown);
}

void Runs::finishUnheld(const Refusal& unknown) {
    for (const auto run : std::vector(open_.begin(), open_.end())) {
        if (!parts_.leases.holds(runs_.at(run).master)) finish(run, RunState::Unknown, unknown);
    }
}

void Runs::onRefused(Id128 id, const std::string& entity, const Refusal& why) {
    const auto run = runs_.find(id);
    // Once an event has come, a refusal is of something else, and the robots may move.
    if (run == runs_.end() || run->second.master.entity != entity || run->second.sequence != 0) return;
    if (parts_.requests.contains(Requests::keyOf<request::StartRun>(id))) finish(id, RunState::Refused, why);
}

void Runs::onDue(Id128 id) {
    const auto master = runs_.at(id).master;
    if (parts_.leases.ready(master).ok()) sendControl(parts_.context, id, master, proto::CANCEL);
    finish(id, RunState::Unknown,
           {RefusalCode::OutcomeUnknown,
            parts_.entities.label(master.entity) + ", its master, has not answered the request in time.",
            {}});
}

void Runs::control(const Id128& run, proto::TaskAction action, Done done) {
    const auto found = runs_.find(run);
    if (found == runs_.end())
        return done(Refusal{RefusalCode::UnknownTask, "This client has no record of such a run.", {}});
    const auto& entry = found->second;
    requestControl(parts_, run, entry.master, entry.report.state, action, "run", std::move(done));
}

void Runs::fetchRecords(const std::string& entity, int most, RunRecordsDone done) {
    if (!parts_.context.connected) return done(CoreContext::notConnected());
    const auto known = parts_.entities.entity(entity);
    if (!known) return done(known.refusal());
    const auto id = Id128::random(parts_.context.random);
    proto::ToEntity body;
    body.mutable_run_history()->set_request_id(id.bytes());
    body.mutable_run_history()->set_most(static_cast<std::uint32_t>(std::max(most, 0)));
    const auto sequence = parts_.context.send(entity, kMsgRun, {}, body);
    parts_.requests.await(
        id, {.entity = entity, .sequence = sequence, .what = request::FetchRunRecords{std::move(done)}});
}

void Runs::askAfter(const Held& master) {
    auto runs = open(master);
    if (runs.empty()) return;
    const auto id = Id128::random(parts_.context.random);
    const auto& settings = parts_.context.settings;
    const auto now = parts_.context.clock.now();
    const auto until = now + settings.timeout;
    parts_.requests.await(id, {.entity = master.entity,
                               .lease = master.lease,
                               .deadline = std::min(until, now + settings.outcome_again),
                               .what = request::AskAfterRuns{{}, std::move(runs), until}});
    sendHistoryRequest(id, master);
}

void Runs::sendHistoryRequest(Id128 id, const Held& master) {
    proto::ToEntity body;
    body.mutable_run_history()->set_request_id(id.bytes());
    parts_.context.send(master.entity, kMsgRun, master.lease, body);
}

void Runs::onAskAfterDue(Id128 id) {
    const auto key = Requests::keyOf<request::AskAfterRuns>(id);
    auto& pending = *parts_.requests.find(key);
    const auto& after = pending.as<request::AskAfterRuns>();
    const auto now = parts_.context.clock.now();
    if (after.runs.empty() || now >= after.until) {
        auto over = *parts_.requests.take(key);
        for (const auto run : over.as<request::AskAfterRuns>().runs) {
            finish(run, RunState::Unknown,
                   {RefusalCode::OutcomeUnknown,
                    parts_.entities.label(over.entity) + ", its master, does not say what became of it.",
                    {}});
        }
        return;
    }
    // It may be ending at this moment.
    sendHistoryRequest(id, {pending.entity, pending.lease});
    parts_.requests.postpone(key, std::min(after.until, now + parts_.context.settings.outcome_again));
}

void Runs::onHistory(const std::string& entity, const proto::RunHistory& history) {
    const auto id = Id128::fromBytes(history.request_id());
    if (!id) return;
    if (auto asked = parts_.requests.take<request::FetchRunRecords>(*id)) {
        std::vector<RunRecord> records;
        for (const auto& record : history.runs()) records.push_back(fromProto(record));
        asked->as<request::FetchRunRecords>().done(std::move(records));
        return;
    }
    const auto key = Requests::keyOf<request::AskAfterRuns>(*id);
    auto* pending = parts_.requests.find(key);
    if (pending == nullptr || pending->entity != entity) return;
    for (const auto& record : history.runs()) {
        const auto run = Id128::fromBytes(record.run_id());
        const auto state = runStateFromProto(record.state());
        if (!run || !state || open_.count(*run) == 0) continue;
        std::erase(pending->as<request::AskAfterRuns>().runs, *run);
        parts_.requests.settle<request::StartRun>(*run, {});
        auto& report = runs_.at(*run).report;
        const auto recorded = fromProto(record);
        for (const auto& step : recorded.steps) merge(report.steps, step);
        report.elapsed = recorded.duration;
        if (isFinal(*state)) {
            if (*state == RunState::Succeeded) report.progress = 1;
            finish(*run, *state, recorded.reason);
        } else {  // it lives, and the master tells what comes
            report.state = *state;
            report.reason = recorded.reason;
            tell(*run);
        }
        pending = parts_.requests.find(key);  // telling may end the lease, and this request with it
        if (pending == nullptr) return;
    }
    if (pending->as<request::AskAfterRuns>().runs.empty()) parts_.requests.take(key);
}

}  // namespace axon::client
