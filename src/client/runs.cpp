// SPDX-License-Identifier: GPL-2.0-or-later
// SessionCore: global services and their runs.
#include <axon/messages.pb.h>

#include <algorithm>

#include "client/content.hpp"
#include "client/session_core.hpp"
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
        // What the service says of it does not travel.
        changed.compensation = place->compensation;
        changed.called = place->called;
        *place = std::move(changed);
    } else {
        steps.insert(place, std::move(changed));
    }
}

}  // namespace

// ---- what the server offers

void SessionCore::fetchGlobalServices(GlobalServicesDone done) {
    if (!connected_) return done(notConnected());
    const auto id = Id128::random(random_);
    proto::ToEntity body;
    body.mutable_global_services()->set_request_id(id.bytes());
    const auto head = header({}, kMsgGlobalServices);
    link_.sendRequest(head, body.SerializeAsString());
    Pending pending;
    pending.global_services_done = std::move(done);
    pending.sequence = head.sequence;
    await(Ask::GlobalServices, id, std::move(pending));
}

// ---- a run

Refusal SessionCore::misfits(const RunOrder& order) const {
    const auto parameter = [&](const GlobalStep& step, const std::string& name) -> const proto::CtrlParam* {
        const auto& offered = leases_.at(order.players.at(step.role)).services;
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
                all += (all.empty() ? "" : " ") + label(order.players.at(step.role)) + ": '" +
                       source.parameter + "' of " + step.service_global_id + " cannot take '" +
                       source.output + "' of the step '" + source.step + "': " + why + ".";
            }
        }
    }
    if (all.empty()) return {};
    return {RefusalCode::WrongType, all, {}};
}

Result<Id128> SessionCore::runGlobal(const RunOrder& order) {
    if (!connected_) return notConnected();
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
            return Refusal{RefusalCode::Duplicate,
                           label(entity) + " plays two roles. Each role needs an entity of its own.",
                           {}};
        }
        const auto mine = leases_.find(entity);
        if (mine == leases_.end()) {
            strangers.push_back(label(entity));
            continue;
        }
        if (auto refusal = ready({entity, mine->second.number}); !refusal.ok()) return refusal;
        if (mine->second.key.size() != 16 || mine->second.root.size() != 16) {
            return Refusal{RefusalCode::NotSupported,
                           mine->second.name +
                               " has given no key or no root for its lease, so nobody else can "
                               "be let command it. Update its Entity Manager.",
                           {}};
        }
        roots.insert(mine->second.root);
    }
    if (!strangers.empty()) {
        return Refusal{
            RefusalCode::NotHolder,
            "This client does not hold " + listed(strangers) + ". Check out every participant first.",
            {}};
    }
    if (players.count(order.master) == 0)
        return malformed("The master must be one of the participants; " + label(order.master) + " is none.");
    if (roots.size() > 1) {
        return Refusal{RefusalCode::WrongState,
                       "The participants were checked out by different sessions. Release them and check them "
                       "all out by one.",
                       {}};
    }

    if (auto refusal = misfits(order); !refusal.ok()) return refusal;

    const auto id = Id128::uuid(random_);
    proto::ToEntity body;
    auto& request = *body.mutable_collaboration();
    request.set_run_id(id.bytes());
    *request.mutable_service() = toProto(order.service);
    request.set_check_only(order.check_only);
    request.set_asked_at_ms(order.asked_at_ms);
    for (const auto& [number, entity] : order.players) {
        const auto& mine = leases_.at(entity);
        auto& participant = *request.add_participants();
        participant.set_role(number);
        participant.set_entity(entity);
        participant.set_name(label(entity));
        auto& lease = *participant.mutable_lease();
        lease.set_epoch(static_cast<std::uint32_t>(mine.number.epoch));
        lease.set_number(static_cast<std::uint32_t>(mine.number.number));
        lease.set_root(mine.root);
        lease.set_stop_generation(static_cast<std::uint32_t>(marks_.of(entity)));
        collaboration::seal(lease, {request.run_id(), order.master, entity}, mine.key);
    }

    auto& entry = runs_[id];
    open_runs_.insert(id);
    entry.master = {order.master, leases_.at(order.master).number};
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
            of_step.name = label(of_step.entity);
            of_step.service = step.service_global_id;
            of_step.preced = step.preced;
        }
    }
    Pending pending;
    pending.entity = order.master;
    pending.lease = entry.master.lease;
    pending.sequence = send(order.master, kMsgRun, entry.master.lease, body);
    await(Ask::Run, id, std::move(pending));
    pace();
    return id;
}

std::optional<RunReport> SessionCore::runReport(const Id128& id) const {
    const auto found = runs_.find(id);
    if (found == runs_.end()) return std::nullopt;
    return found->second.report;
}

std::vector<Id128> SessionCore::openRuns(const Held& master) const {
    std::vector<Id128> open;
    for (const auto id : open_runs_) {
        if (runs_.at(id).master == master) open.push_back(id);
    }
    return open;
}

void SessionCore::onRunEvent(const std::string& entity, const proto::RunEvent& event) {
    const auto id = Id128::fromBytes(event.run_id());
    const auto state = runStateFromProto(event.state());
    if (!id || !state) {
        ++malformed_;
        return;
    }
    const auto found = runs_.find(*id);
    if (found == runs_.end() || found->second.master.entity != entity) return;
    answer(Ask::Run, *id, {});
    auto& entry = found->second;
    auto& report = entry.report;
    if (isFinal(report.state)) {
        // Given up here, alive there: a run whose outcome this client has called unknown must not go on.
        if (report.state == RunState::Unknown && !isFinal(*state) && lease(entry.master) != nullptr)
            cancelRun(*id, entry.master);
        return;
    }
    // It lives: nobody need be asked after it.
    for (const auto& [ask, asked] : pendingOf(entity)) {
        if (ask == Ask::Runs) std::erase(pending_.at({ask, asked}).tasks, *id);
    }
    if (event.sequence() <= entry.sequence) return;  // a duplicate
    entry.sequence = event.sequence();
    report.state = *state;
    report.progress = std::clamp(event.progress(), 0.0, 1.0);
    report.elapsed = Seconds(event.at_s());
    for (const auto& status : event.steps()) {
        if (status.step() < 0 || status.step() >= kStepsMax) {
            ++malformed_;
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
    if (!isFinal(*state) && lease(entry.master) == nullptr) awaitRun(*id);
    tellRun(*id);
}

void SessionCore::awaitRun(Id128 id) {
    if (pending_.count({Ask::Run, id}) != 0) return;
    Pending pending;
    pending.entity = runs_.at(id).master.entity;
    pending.lease = runs_.at(id).master.lease;
    await(Ask::Run, id, std::move(pending));
}

void SessionCore::tellRun(Id128 id) {
    // A copy: the oldest that is over is forgotten.
    const auto report = runs_.at(id).report;
    if (isFinal(report.state) && open_runs_.erase(id) != 0) {
        finished_runs_.push_back(id);
        while (finished_runs_.size() > std::max<std::size_t>(settings_.runs_kept, 1)) {
            runs_.erase(finished_runs_.front());
            finished_runs_.pop_front();
        }
    }
    // The report first: whoever waited for the pause finds the run paused.
    observer_.onRun(report);
    settleRunControls(id, report);
    pace();
}

void SessionCore::finishRun(Id128 id, RunState state, const Refusal& why) {
    const auto found = runs_.find(id);
    if (found == runs_.end() || isFinal(found->second.report.state)) return;
    answer(Ask::Run, id, {});
    auto& report = found->second.report;
    report.state = state;
    report.reason = why;
    for (auto& step : report.steps) {
        // Of what was under way nothing more is heard.
        if (step.state && !isFinal(*step.state)) step.state = TaskState::Unknown;
    }
    tellRun(id);
}

void SessionCore::cancelRun(Id128 id, const Held& master) {
    proto::ToEntity body;
    body.mutable_task_control()->set_task_id(id.bytes());
    body.mutable_task_control()->set_action(proto::CANCEL);
    send(master.entity, kMsgTaskControl, master.lease, body);
}

// ---- control

void SessionCore::controlRun(const Id128& run, proto::TaskAction action, Done done) {
    const auto found = runs_.find(run);
    if (found == runs_.end())
        return done(Refusal{RefusalCode::UnknownTask, "This client knows no such run (any more).", {}});
    const auto& entry = found->second;
    if (isFinal(entry.report.state)) {
        return done(Refusal{RefusalCode::WrongState,
                            std::string("The run has ended already: ") + toString(entry.report.state) + ".",
                            {}});
    }
    if (const auto refusal = ready(entry.master); !refusal.ok()) return done(refusal);
    answer(Ask::Control, run,
           Refusal{RefusalCode::Cancelled, "A newer request for the same run took its place.", {}});
    proto::ToEntity body;
    body.mutable_task_control()->set_task_id(run.bytes());
    body.mutable_task_control()->set_action(action);
    Pending pending;
    pending.entity = entry.master.entity;
    pending.lease = entry.master.lease;
    pending.action = action;
    pending.done = std::move(done);
    pending.sequence = send(entry.master.entity, kMsgTaskControl, entry.master.lease, body);
    await(Ask::Control, run, std::move(pending));
}

void SessionCore::settleRunControls(Id128 id, const RunReport& report) {
    const auto found = pending_.find({Ask::Control, id});
    if (found == pending_.end()) return;
    const auto action = found->second.action;
    if (isFinal(report.state)) {
        if (action == proto::CANCEL && report.state != RunState::Unknown) {
            answer(Ask::Control, id, {});
        } else {
            answer(Ask::Control, id,
                   Refusal{report.state == RunState::Unknown ? RefusalCode::OutcomeUnknown
                                                             : RefusalCode::WrongState,
                           std::string("The run has ended meanwhile: ") + toString(report.state) + ".",
                           {}});
        }
    } else if ((action == proto::PAUSE && report.state == RunState::Paused) ||
               (action == proto::RESUME && report.state == RunState::Running)) {
        answer(Ask::Control, id, {});
    }
}

// ---- what became of it

void SessionCore::fetchRuns(const std::string& entity, int most, RunRecordsDone done) {
    if (!connected_) return done(notConnected());
    const auto known = this->entity(entity);
    if (!known) return done(known.refusal());
    const auto id = Id128::random(random_);
    proto::ToEntity body;
    body.mutable_run_history()->set_request_id(id.bytes());
    body.mutable_run_history()->set_most(static_cast<std::uint32_t>(std::max(most, 0)));
    Pending pending;
    pending.entity = entity;
    pending.run_records_done = std::move(done);
    pending.sequence = send(entity, kMsgRun, {}, body);
    await(Ask::RunRecords, id, std::move(pending));
}

void SessionCore::askAfterRuns(const Held& master) {
    auto open = openRuns(master);
    if (open.empty()) return;
    const auto id = Id128::random(random_);
    Pending pending;
    pending.entity = master.entity;
    pending.lease = master.lease;
    pending.tasks = std::move(open);
    pending.until = clock_.now() + settings_.timeout;
    pending.deadline = std::min(pending.until, clock_.now() + settings_.outcome_again);
    await(Ask::Runs, id, std::move(pending));
    sendRunHistoryRequest(pending_.at({Ask::Runs, id}), id);
}

void SessionCore::sendRunHistoryRequest(Pending& pending, Id128 id) {
    proto::ToEntity body;
    body.mutable_run_history()->set_request_id(id.bytes());
    send(pending.entity, kMsgRun, pending.lease, body);
}

void SessionCore::onRunsDue(Id128 id) {
    const auto found = pending_.find({Ask::Runs, id});
    auto& pending = found->second;
    const auto now = clock_.now();
    if (pending.tasks.empty() || now >= pending.until) {
        const auto over = take(found);
        for (const auto run : over.tasks) {
            finishRun(run, RunState::Unknown,
                      {RefusalCode::OutcomeUnknown,
                       label(over.entity) + ", its master, does not say what became of it.",
                       {}});
        }
        return;
    }
    // It may be ending at this moment.
    sendRunHistoryRequest(pending, id);
    postpone(found, std::min(pending.until, now + settings_.outcome_again));
}

void SessionCore::onRunHistory(const std::string& entity, const proto::RunHistory& history) {
    const auto id = Id128::fromBytes(history.request_id());
    if (!id) return;
    if (const auto found = pending_.find({Ask::RunRecords, *id}); found != pending_.end()) {
        std::vector<RunRecord> records;
        for (const auto& record : history.runs()) records.push_back(fromProto(record));
        take(found).run_records_done(std::move(records));
        return;
    }
    const auto found = pending_.find({Ask::Runs, *id});
    if (found == pending_.end() || found->second.entity != entity) return;
    for (const auto& record : history.runs()) {
        const auto run = Id128::fromBytes(record.run_id());
        const auto state = runStateFromProto(record.state());
        if (!run || !state || !isFinal(*state) || open_runs_.count(*run) == 0) continue;
        std::erase(found->second.tasks, *run);
        auto& report = runs_.at(*run).report;
        const auto recorded = fromProto(record);
        for (const auto& step : recorded.steps) merge(report.steps, step);
        report.elapsed = recorded.duration;
        if (*state == RunState::Succeeded) report.progress = 1;
        finishRun(*run, *state, recorded.reason);
    }
    if (const auto still = pending_.find({Ask::Runs, *id});
        still != pending_.end() && still->second.tasks.empty())
        take(still);
}

}  // namespace axon::client
