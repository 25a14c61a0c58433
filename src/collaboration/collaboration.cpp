// SPDX-License-Identifier: GPL-2.0-or-later
#include "collaboration/collaboration.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <set>
#include <string_view>

#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::collaboration {

namespace {

/// So much goes into one event: a message between stations has at most 1 MiB.
constexpr std::size_t kStepsPerEvent = 250;
constexpr std::size_t kEventBytes = 512 * 1024;
constexpr int kBeatsPerWatchdog = 5;
constexpr auto kShortestWatchdog = std::chrono::milliseconds{50};

proto::Problem problem(std::string entity, int step, RefusalCode code, std::string message) {
    proto::Problem made;
    made.set_step(step);
    made.set_entity(std::move(entity));
    *made.mutable_refusal() = toProto({code, std::move(message), {}});
    return made;
}

std::string inMilliseconds(Duration time) {
    return std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(time).count()) + " ms";
}

std::string titleOf(const proto::GlobalStep& step) {
    return step.name().empty() ? inQuotes(step.service_global_id()) : inQuotes(step.name());
}

}  // namespace

proto::Problem andMore(int count) {
    return problem({}, -1, RefusalCode::Malformed,
                   "… and " + std::to_string(count) + " more. Fix these first.");
}

Duration beatPeriod(Duration own, std::uint32_t other_ms) {
    const Duration other = std::chrono::milliseconds{other_ms};
    if (other_ms > 0) own = std::min(own, std::max<Duration>(other, kShortestWatchdog));
    return own / kBeatsPerWatchdog;
}

bool isStop(const Refusal& reason) {
    switch (reason.code) {
        case RefusalCode::Stopped:
        case RefusalCode::Cancelled:
        case RefusalCode::ClientLost:
        case RefusalCode::RevokedLease:
        case RefusalCode::Expired:
        case RefusalCode::NotConnected:
        // Of one that had agreed: it has left, and why was lost on the way. In doubt it is a stop.
        case RefusalCode::NotHolder:
            return true;
        default:
            return false;
    }
}

std::vector<proto::Problem> Collaboration::problemsOf(const proto::CollaborationRequest& request,
                                                      const std::string& self, const std::string& root) {
    std::vector<proto::Problem> problems;
    int more = 0;
    const auto add = [&](proto::Problem found) {
        if (static_cast<int>(problems.size()) < kProblemsMax)
            problems.push_back(std::move(found));
        else
            ++more;
    };
    const auto malformed = [&](int step, std::string message) {
        add(problem({}, step, RefusalCode::Malformed, std::move(message)));
    };
    const auto& service = request.service();
    const auto steps = service.steps_size() + service.compensation_size();
    if (service.steps_size() == 0) malformed(-1, "The global service has no steps.");
    if (steps > kStepsMax)
        malformed(-1, "The global service has " + std::to_string(steps) + " steps; at most " +
                          std::to_string(kStepsMax) + " can be carried out. Divide it.");
    if (request.participants_size() > kParticipantsMax)
        malformed(-1, "There are " + std::to_string(request.participants_size()) + " participants; at most " +
                          std::to_string(kParticipantsMax) + " are possible.");
    if (!problems.empty()) return problems;

    std::set<std::int32_t> roles;
    std::set<std::string> entities;
    for (const auto& participant : request.participants()) {
        if (!roles.insert(participant.role()).second)
            malformed(-1, "Role " + std::to_string(participant.role()) + " is given to two entities.");
        if (!entities.insert(participant.entity()).second)
            malformed(-1, "The entity " + inQuotes(participant.name()) +
                              " has two roles. Give each role an entity of its own.");
        if (participant.lease().root().size() != 16 || participant.lease().root() != root)
            add(problem(
                participant.name(), -1, RefusalCode::NotHolder,
                "It is not held under the same root lease as the master. Check all participants out by the "
                "same client."));
    }
    if (!entities.contains(self))
        malformed(-1, "The master does not take part. Make one of the participants the master.");
    std::map<std::string, std::int32_t> named;  // step → its place in the order
    std::set<std::int32_t> used;
    for (const auto& step : service.steps()) {
        used.insert(step.role());
        if (!step.name().empty() && !named.emplace(step.name(), step.preced()).second)
            malformed(-1, "Two steps have the name " + inQuotes(step.name()) + '.');
    }
    for (int i = 0; i < steps; ++i) {
        const bool compensation = i >= service.steps_size();
        const auto& step = compensation ? service.compensation(i - service.steps_size()) : service.steps(i);
        if (!roles.contains(step.role()))
            malformed(i, "Nobody has role " + std::to_string(step.role()) + '.');
        for (const auto& source : step.sources()) {
            const auto at = named.find(source.step());
            if (compensation)
                malformed(i, "A step of the compensation cannot take its input from another step.");
            else if (at == named.end())
                malformed(i, "Parameter " + inQuotes(source.param()) + " comes from step " +
                                 inQuotes(source.step()) + ", which does not exist.");
            else if (at->second >= step.preced())
                malformed(i, "Parameter " + inQuotes(source.param()) + " comes from step " +
                                 inQuotes(source.step()) + ", which has not ended by then: its preced " +
                                 std::to_string(at->second) + " is not below " +
                                 std::to_string(step.preced()) + '.');
        }
    }
    for (const auto role : roles)
        if (!used.contains(role)) malformed(-1, "Role " + std::to_string(role) + " has no step.");
    if (more > 0) problems.push_back(andMore(more));
    return problems;
}

Collaboration::Collaboration(proto::CollaborationRequest request, std::string self, std::string by,
                             RandomSource& random, Pace pace, TimePoint now)
    : request_(std::move(request)),
      self_(std::move(self)),
      by_(std::move(by)),
      random_(random),
      pace_(pace),
      launched_(now),
      members_(static_cast<std::size_t>(request_.participants_size())) {
    std::map<std::int32_t, std::size_t> roles;
    for (int i = 0; i < request_.participants_size(); ++i)
        roles.emplace(request_.participants(i).role(), static_cast<std::size_t>(i));
    const auto& service = request_.service();
    const auto add = [&](const proto::GlobalStep& declared, std::int32_t preced) {
        Step step;
        step.declared = &declared;
        step.participant = roles.at(declared.role());
        auto& status = step.status;
        status.set_step(static_cast<std::int32_t>(steps_.size()));
        status.set_entity(participant(step.participant).entity());
        status.set_name(participant(step.participant).name());
        status.set_service(declared.service_global_id());
        status.set_preced(preced);
        status.set_progress(-1);
        status.set_began_s(-1);
        status.set_ended_s(-1);
        *status.mutable_params() = declared.params();
        steps_.push_back(std::move(step));
    };
    for (const auto& step : service.steps()) {
        add(step, step.preced());
        levels_.push_back(step.preced());
    }
    for (const auto& step : service.compensation()) add(step, -1);
    std::sort(levels_.begin(), levels_.end());
    levels_.erase(std::unique(levels_.begin(), levels_.end()), levels_.end());
}

proto::FromMaster& Collaboration::send(std::size_t participant) {
    auto& order = orders_.emplace_back();
    order.participant = participant;
    order.message.set_run_id(request_.run_id());
    return order.message;
}

void Collaboration::begin(TimePoint now) {
    if (over()) return;
    launched_ = now;
    proto::Invitation common;
    common.set_service(request_.service().name());
    common.set_by(by_);
    common.set_check_only(request_.check_only());
    common.set_watchdog_ms(static_cast<std::uint32_t>(
        std::chrono::duration_cast<std::chrono::milliseconds>(pace_.watchdog).count()));
    for (const auto& participant : request_.participants()) {
        auto& other = *common.add_participants();
        other.set_role(participant.role());
        other.set_entity(participant.entity());
        other.set_name(participant.name());
    }
    for (std::size_t i = 0; i < members_.size(); ++i) {
        members_[i].stage = Member::Stage::Invited;
        members_[i].heard = now;
        auto& invitation = *send(i).mutable_invitation();
        invitation = common;
        *invitation.mutable_lease() = participant(i).lease();
        for (const auto& step : steps_) {
            if (step.participant != i) continue;
            auto& asked = *invitation.add_steps();
            asked.set_step(step.status.step());
            asked.set_preced(step.status.preced());
            asked.mutable_task()->set_service(step.declared->service_global_id());
            *asked.mutable_task()->mutable_params() = step.declared->params();
            for (const auto& source : step.declared->sources()) asked.add_later(source.param());
            if (step.declared->name().empty()) continue;
            std::set<std::string_view> wanted;
            for (const auto& later : steps_)
                for (const auto& source : later.declared->sources())
                    if (source.step() == step.declared->name()) wanted.insert(source.output());
            for (const auto output : wanted) asked.add_wanted(std::string(output));
        }
    }
}

void Collaboration::order(Step& step, TimePoint now) {
    const auto& declared = *step.declared;
    auto& status = step.status;
    step.changed = true;
    step.want = step.told = Want::Run;
    *status.mutable_params() = declared.params();
    for (const auto& source : declared.sources()) {
        const auto from = std::find_if(steps_.begin(), steps_.end(), [&](const Step& other) {
            return other.declared->name() == source.step();
        });
        const auto& results = from->status.results();
        const auto result = std::find_if(results.begin(), results.end(), [&](const proto::Param& param) {
            return param.name() == source.output();
        });
        if (result == results.end()) {
            status.set_state(proto::TASK_REFUSED);
            status.set_ended_s(since(now));
            const Refusal reason{RefusalCode::MissingDependency,
                                 "Step " + inQuotes(source.step()) + " has ended without a result " +
                                     inQuotes(source.output()) + ", which " + inQuotes(source.param()) +
                                     " takes.",
                                 {}};
            *status.mutable_reason() = toProto(reason);
            fail(&step, reason, now);
            return;
        }
        auto& given = *status.add_params();
        given = *result;
        given.set_name(source.param());
    }
    step.task_id = Id128::random(random_).bytes();
    step.ordered_s = since(now);
    step.heard = step.given_up = false;
    members_[step.participant].begin_until = now + pace_.end_within;
    step.answer_until = now + pace_.answer_within;
    status.set_state(proto::TASK_QUEUED);
    status.set_progress(-1);
    status.set_tries(status.tries() + 1);
    status.set_began_s(-1);
    status.set_ended_s(-1);
    status.clear_reason();
    status.clear_results();
    status.clear_feedback();
    auto& ordered = *send(step.participant).mutable_order();
    ordered.set_step(status.step());
    ordered.mutable_task()->set_task_id(step.task_id);
    ordered.mutable_task()->set_service(declared.service_global_id());
    *ordered.mutable_task()->mutable_params() = status.params();
    for (const auto& source : declared.sources()) ordered.add_later(source.param());
}

/// Tells the participant what is wanted of the step, as soon as it can do it.
void Collaboration::attend(Step& step, TimePoint now) {
    if (!step.open() || step.want == step.told) return;
    proto::TaskAction action{};
    if (step.want == Want::End)
        action = proto::CANCEL;
    else if (step.want == Want::Pause && step.status.state() == proto::TASK_RUNNING && step.pausable)
        action = proto::PAUSE;
    else if (step.want == Want::Run && step.status.state() == proto::TASK_PAUSED)
        action = proto::RESUME;
    else
        return;
    step.told = step.want;
    if (action == proto::PAUSE) step.obey_until = now + pace_.end_within;
    auto& control = *send(step.participant).mutable_control();
    control.set_step(step.status.step());
    control.set_action(action);
}

void Collaboration::ask(Step& step, Want want, TimePoint now) {
    if (step.want != want) step.obey_until = now + pace_.end_within;  // asked for again it has no more time
    step.want = want;
    attend(step, now);
}

void Collaboration::wantOfAll(Want want, TimePoint now, bool pause_where_possible) {
    for (auto& step : steps_)
        if (step.active())  // what was given up is cancelled already
            ask(step, pause_where_possible && step.pausable ? Want::Pause : want, now);
}

TimePoint Collaboration::patienceWith(const Step& step) const {
    if (!step.open()) return TimePoint::max();
    if (step.want == Want::End ||
        (step.told == Want::Pause && step.want == Want::Pause && step.status.state() != proto::TASK_PAUSED))
        return step.obey_until;
    // Behind another one of its participant it waits as long as that takes.
    const auto busy = [&](const Step& other) {
        return other.participant == step.participant && other.open() &&
               other.status.state() >= proto::TASK_RUNNING;
    };
    if (state_ == proto::RUN_COMPENSATING && std::none_of(steps_.begin(), steps_.end(), busy))
        return members_[step.participant].begin_until;
    return TimePoint::max();
}

void Collaboration::endAll(bool stop, const Refusal& reason) {
    for (std::size_t i = 0; i < members_.size(); ++i) {
        if (members_[i].stage == Member::Stage::Out) continue;
        members_[i].stage = Member::Stage::Out;
        auto& end = *send(i).mutable_end();
        end.set_stop(stop);
        if (!reason.ok()) *end.mutable_reason() = toProto(reason);
    }
}

std::optional<std::size_t> Collaboration::indexOf(const std::string& entity) const {
    for (std::size_t i = 0; i < members_.size(); ++i)
        if (participant(i).entity() == entity) return i;
    return std::nullopt;
}

void Collaboration::hear(const std::string& entity, const proto::FromSlave& message, TimePoint now) {
    const auto from = indexOf(entity);
    if (!from || message.run_id() != id() || over() || members_[*from].stage == Member::Stage::Out) return;
    members_[*from].heard = now;
    switch (message.body_case()) {
        case proto::FromSlave::kAnswer:
            answered(*from, message.answer(), now);
            break;
        case proto::FromSlave::kReport:
            reported(*from, message.report(), now);
            break;
        case proto::FromSlave::kDeparture:
            depart(*from, toRefusal(message.departure().reason()), now);
            break;
        case proto::FromSlave::kBeat:
        case proto::FromSlave::BODY_NOT_SET:
            break;
    }
}

void Collaboration::lose(const std::string& entity, const Refusal& reason, TimePoint now) {
    const auto who = indexOf(entity);
    if (who && !over()) depart(*who, reason, now);
}

void Collaboration::answered(std::size_t participant, const proto::InvitationAnswer& answer, TimePoint now) {
    auto& member = members_[participant];
    if (member.stage != Member::Stage::Invited) return;
    member.stage = Member::Stage::In;
    member.stop_generation = answer.stop_generation();
    member.beat_every = beatPeriod(pace_.watchdog, answer.watchdog_ms());
    member.beat_at = now;
    if (answer.problems_size() > 0 || request_.check_only())
        member.stage = Member::Stage::Out;  // it has not joined
    for (auto found : answer.problems()) {
        found.set_entity(this->participant(participant).name());
        note(std::move(found));
    }
    for (const auto step : answer.pausable())
        if (step >= 0 && static_cast<std::size_t>(step) < steps_.size() &&
            steps_[static_cast<std::size_t>(step)].participant == participant)
            steps_[static_cast<std::size_t>(step)].pausable = true;
    advance(now);
}

void Collaboration::reported(std::size_t participant, const proto::StepReport& report, TimePoint now) {
    if (report.step() < 0 || static_cast<std::size_t>(report.step()) >= steps_.size()) return;
    auto& step = steps_[static_cast<std::size_t>(report.step())];
    const auto& event = report.event();
    if (step.participant != participant || !step.open() || event.task_id() != step.task_id) return;
    if (step.given_up && !isFinal(event.state())) {
        step.told = Want::Run;  // late, and it has not heard that it is to end
        attend(step, now);
        return;
    }
    step.given_up = false;
    step.heard = true;
    if (event.state() >= proto::TASK_RUNNING) members_[participant].begin_until = now + pace_.end_within;
    step.changed = true;
    auto& status = step.status;
    status.set_state(event.state());
    if (event.progress() >= 0) status.set_progress(event.progress());
    if (!event.feedback().empty()) status.set_feedback(event.feedback());
    for (const auto& result : event.results()) {
        auto& results = *status.mutable_results();
        const auto known = std::find_if(results.begin(), results.end(), [&](const proto::Param& param) {
            return param.name() == result.name();
        });
        (known == results.end() ? *results.Add() : *known) = result;
    }
    if (event.has_reason()) *status.mutable_reason() = event.reason();
    if (status.began_s() < 0 && report.has_running_s()) {
        const double running = std::isfinite(report.running_s()) ? report.running_s() : 0;
        status.set_began_s(since(now) - std::clamp(running, 0.0, since(now) - step.ordered_s));
    }
    if (!isFinal(event.state())) {
        attend(step, now);
        return;
    }
    status.set_ended_s(since(now));
    if (event.state() == proto::TASK_SUCCEEDED) {
        status.set_progress(1);
        advance(now);
    } else if (step.told == Want::End) {
        advance(now);
    } else {
        auto reason = toRefusal(event.reason());
        if (reason.ok()) reason.code = RefusalCode::Failed;
        // Nobody here has asked for this end, so somebody else wanted it: the application itself, a reset, a
        // person.
        const bool stopped = event.state() == proto::TASK_STOPPED || event.state() == proto::TASK_CANCELLED;
        if (stopped)
            conclude(proto::RUN_STOPPED, true, {reason.code, titled(step, reason.message), {}});
        else
            fail(&step, reason, now);
    }
}

/// A participant takes part no more.
void Collaboration::depart(std::size_t participant, const Refusal& reason, TimePoint now) {
    auto& member = members_[participant];
    if (member.stage == Member::Stage::Out) return;
    const bool invited = member.stage == Member::Stage::Invited;
    member.stage = Member::Stage::Out;
    const auto& name = this->participant(participant).name();
    if (invited || state_ == proto::RUN_CHECKING) {
        note(problem(name, -1, reason.code, reason.message));
        advance(now);
        return;
    }
    for (auto& step : steps_) {
        if (step.participant != participant || !step.active()) continue;
        step.changed = true;
        step.status.set_state(isStop(reason) ? proto::TASK_STOPPED : proto::TASK_UNKNOWN);
        step.status.set_ended_s(since(now));
        *step.status.mutable_reason() = toProto(reason);
    }
    for (auto& step : steps_)
        if (step.participant == participant) step.given_up = false;  // out of reach
    const Refusal why{reason.code, name + ": " + reason.message, {}};
    const bool failing =
        state_ == proto::RUN_RUNNING || state_ == proto::RUN_PAUSED || state_ == proto::RUN_HELD;
    if (isStop(reason))
        conclude(proto::RUN_STOPPED, true, why);
    else if (!failing)
        advance(now);
    else if (request_.service().on_failure() == proto::COMPENSATE)
        fail(nullptr, why, now);
    else
        conclude(proto::RUN_FAILED, true, why);  // there is nobody left to try the step again
}

Refusal Collaboration::pause(TimePoint now) {
    if (state_ != proto::RUN_RUNNING) return {RefusalCode::WrongState, "The run is not running.", {}};
    std::string stubborn;
    for (const auto& step : steps_)
        if (step.active() && !step.pausable)
            stubborn +=
                (stubborn.empty() ? "" : ", ") + titleOf(*step.declared) + " of " + step.status.name();
    if (!stubborn.empty())
        return {RefusalCode::NotPausable,
                "These steps are running and cannot be paused: " + stubborn +
                    ". Wait for their end, or cancel the run.",
                {}};
    enter(proto::RUN_PAUSED);
    wantOfAll(Want::Pause, now);
    return {};
}

Refusal Collaboration::resume(TimePoint now) {
    if (state_ != proto::RUN_PAUSED && state_ != proto::RUN_HELD)
        return {RefusalCode::WrongState, "The run is neither paused nor held.", {}};
    for (const auto& step : steps_)
        if (step.open() && step.want == Want::End)
            return {RefusalCode::WrongState,
                    "Step " + titleOf(*step.declared) + " of " + step.status.name() +
                        " is still ending. Try again in a moment.",
                    {}};
    enter(proto::RUN_RUNNING);
    reason_ = {};
    wantOfAll(Want::Run, now);
    beginLevel(now);
    advance(now);
    return {};
}

Refusal Collaboration::cancel(TimePoint now) {
    if (over()) return {RefusalCode::WrongState, "The run is over.", {}};
    const Refusal reason{RefusalCode::Cancelled, "Cancelled by " + by_ + '.', {}};
    if (state_ == proto::RUN_CHECKING) {
        conclude(proto::RUN_CANCELLED, false, reason);
        return {};
    }
    if (outcome_ == proto::RUN_UNSPECIFIED) {  // otherwise it has failed already
        outcome_ = proto::RUN_CANCELLED;
        reason_ = reason;
    }
    compensates_ = false;
    if (state_ != proto::RUN_STOPPING) end_until_ = now + pace_.end_within;
    enter(proto::RUN_STOPPING);
    wantOfAll(Want::End, now);
    advance(now);
    return {};
}

void Collaboration::abandon(proto::RunState outcome, const Refusal& reason, TimePoint now) {
    (void)now;
    if (over()) return;
    if (const auto self = indexOf(self_)) members_[*self].stage = Member::Stage::Out;
    conclude(outcome, true, reason);
}

void Collaboration::enter(proto::RunState state) {
    state_ = state;
    changed_ = true;
}

void Collaboration::note(proto::Problem found) {
    if (static_cast<int>(problems_.size()) < kProblemsMax)
        problems_.push_back(std::move(found));
    else
        ++more_problems_;
}

std::string Collaboration::titled(const Step& step, const std::string& message) const {
    return "Step " + titleOf(*step.declared) + " of " + step.status.name() + ": " + message;
}

bool Collaboration::anyOpen() const {
    return std::any_of(steps_.begin(), steps_.end(), [](const Step& step) { return step.open(); });
}

bool Collaboration::anyChanged() const {
    return std::any_of(steps_.begin(), steps_.end(), [](const Step& step) { return step.changed; });
}

/// Its participant has not said a word about it. The order may only be late, so it is cancelled.
void Collaboration::giveUp(Step& step, TimePoint now) {
    step.changed = true;
    step.given_up = true;
    step.status.set_state(proto::TASK_UNKNOWN);
    step.status.set_ended_s(since(now));
    const Refusal reason{RefusalCode::TimedOut,
                         "Nothing was heard of it within " + inMilliseconds(pace_.answer_within) + '.',
                         {}};
    *step.status.mutable_reason() = toProto(reason);
    ask(step, Want::End, now);
    fail(&step, reason, now);
}

/// Orders what the present level still lacks.
void Collaboration::beginLevel(TimePoint now) {
    for (std::size_t i = 0; i < firstCompensation(); ++i) {
        auto& step = steps_[i];
        if (state_ != proto::RUN_RUNNING) return;  // a step has failed at once
        if (step.status.preced() == levels_[level_] && !step.active() &&
            step.status.state() != proto::TASK_SUCCEEDED)
            order(step, now);
    }
}

void Collaboration::advance(TimePoint now) {
    switch (state_) {
        case proto::RUN_CHECKING:
            if (std::any_of(members_.begin(), members_.end(),
                            [](const Member& member) { return member.stage == Member::Stage::Invited; }))
                return;
            if (!problems_.empty())
                conclude(proto::RUN_REFUSED, false, toRefusal(problems_.front().refusal()));
            else if (request_.check_only())
                conclude(proto::RUN_SUCCEEDED, false, {});
            else {
                enter(proto::RUN_RUNNING);
                beginLevel(now);
            }
            return;
        case proto::RUN_RUNNING: {
            const auto done = [this](const Step& step) {
                return step.status.preced() != levels_[level_] ||
                       step.status.state() == proto::TASK_SUCCEEDED;
            };
            if (!std::all_of(steps_.begin(),
                             steps_.begin() + static_cast<std::ptrdiff_t>(firstCompensation()), done))
                return;
            if (++level_ == levels_.size())
                conclude(proto::RUN_SUCCEEDED, false, {});
            else
                beginLevel(now);
            return;
        }
        case proto::RUN_STOPPING:
            if (anyOpen()) return;
            if (compensates_)
                compensate(now);
            else
                conclude(outcome_, false, reason_);
            return;
        case proto::RUN_COMPENSATING:
            if (!anyOpen()) conclude(outcome_, false, reason_);
            return;
        default:
            return;
    }
}

/// `step`: which one, where it is one.
void Collaboration::fail(const Step* step, const Refusal& reason, TimePoint now) {
    if (state_ != proto::RUN_RUNNING && state_ != proto::RUN_PAUSED) {
        advance(now);  // one more, while the first failure is being seen to
        return;
    }
    reason_ = reason;
    if (step != nullptr) reason_.message = titled(*step, reason.message);
    switch (request_.service().on_failure()) {
        case proto::HOLD_OTHERS:
            enter(proto::RUN_HELD);
            wantOfAll(Want::End, now, true);
            return;
        case proto::COMPENSATE:
            outcome_ = proto::RUN_FAILED;
            compensates_ = true;
            enter(proto::RUN_STOPPING);
            end_until_ = now + pace_.end_within;
            wantOfAll(Want::End, now);
            advance(now);
            return;
        default:
            conclude(proto::RUN_FAILED, true, reason_);
    }
}

void Collaboration::compensate(TimePoint now) {
    compensates_ = false;
    enter(proto::RUN_COMPENSATING);
    for (auto i = firstCompensation(); i < steps_.size(); ++i) {
        auto& step = steps_[i];
        if (members_[step.participant].stage == Member::Stage::In) {
            order(step, now);
            continue;
        }
        step.changed = true;
        step.status.set_state(proto::TASK_REFUSED);
        *step.status.mutable_reason() =
            toProto(Refusal{RefusalCode::Unavailable, "It takes part in the run no more.", {}});
    }
    advance(now);
}

void Collaboration::conclude(proto::RunState state, bool stop, const Refusal& reason) {
    // Nobody knows what those do that were given up.
    stop = stop || std::any_of(steps_.begin(), steps_.end(), [](const Step& step) { return step.given_up; });
    for (auto& step : steps_) {
        if (!step.active()) continue;
        step.changed = true;
        step.status.set_state(proto::TASK_STOPPED);
        *step.status.mutable_reason() = toProto(reason);
    }
    reason_ = reason;
    enter(state);
    endAll(stop, reason);
}

void Collaboration::onTimer(TimePoint now) {
    if (over()) return;
    for (std::size_t i = 0; i < members_.size() && !over(); ++i) {
        const auto& member = members_[i];
        if (isSelf(i)) continue;
        if (member.stage == Member::Stage::Invited && now >= launched_ + pace_.answer_within)
            depart(i,
                   {RefusalCode::TimedOut,
                    "It has not answered the invitation within " + inMilliseconds(pace_.answer_within) + '.',
                    {}},
                   now);
        else if (member.stage == Member::Stage::In && now >= member.heard + pace_.watchdog)
            depart(
                i,
                {RefusalCode::TimedOut, "It has been silent for " + inMilliseconds(pace_.watchdog) + '.', {}},
                now);
    }
    for (auto& step : steps_) {
        if (over()) return;
        if (!step.active() || step.heard || now < step.answer_until) continue;
        giveUp(step, now);
    }
    if (state_ == proto::RUN_STOPPING && now >= end_until_) {
        conclude(outcome_, true, reason_);
        return;
    }
    for (const auto& step : steps_) {
        if (now < patienceWith(step)) continue;
        const char* const what = step.want == Want::End     ? "It was told to end and has not within "
                                 : step.want == Want::Pause ? "It was told to pause and has not within "
                                                            : "It has not begun within ";
        conclude(outcome_ == proto::RUN_UNSPECIFIED ? proto::RUN_FAILED : outcome_, true,
                 {RefusalCode::TimedOut, titled(step, what + inMilliseconds(pace_.end_within) + '.'), {}});
        return;
    }
    for (std::size_t i = 0; i < members_.size(); ++i) {
        auto& member = members_[i];
        if (isSelf(i) || member.stage != Member::Stage::In || now < member.beat_at) continue;
        member.beat_at = now + member.beat_every;
        send(i).mutable_beat()->set_sequence(++beat_);
    }
}

TimePoint Collaboration::nextDeadline() const {
    if (over()) return TimePoint::max();
    auto next = TimePoint::max();
    for (std::size_t i = 0; i < members_.size(); ++i) {
        if (isSelf(i)) continue;
        if (members_[i].stage == Member::Stage::Invited)
            next = std::min(next, launched_ + pace_.answer_within);
        if (members_[i].stage == Member::Stage::In)
            next = std::min({next, members_[i].heard + pace_.watchdog, members_[i].beat_at});
    }
    for (const auto& step : steps_)
        if (step.active() && !step.heard) next = std::min(next, step.answer_until);
    for (const auto& step : steps_) next = std::min(next, patienceWith(step));
    if (anyChanged()) next = std::min(next, event_at_);
    if (state_ == proto::RUN_STOPPING) next = std::min(next, end_until_);
    return next;
}

double Collaboration::since(TimePoint now) const {
    return std::chrono::duration<double>(now - launched_).count();
}

double Collaboration::progress() const {
    double sum = 0;
    for (std::size_t i = 0; i < firstCompensation(); ++i)
        sum += std::clamp(steps_[i].status.progress(), 0.0, 1.0);
    return sum / static_cast<double>(firstCompensation());
}

std::optional<proto::RunEvent> Collaboration::takeEvent(TimePoint now) {
    if (over() && !ended_) ended_ = now;
    if (!changed_ && (!anyChanged() || now < event_at_)) return std::nullopt;
    event_at_ = now + pace_.event_period;
    proto::RunEvent event;
    std::size_t told = 0;
    std::size_t bytes = 0;
    for (auto& step : steps_) {
        if (!step.changed) continue;
        proto::StepStatus status = step.status;
        if (status.ByteSizeLong() > kEventBytes) {
            status.clear_params();
            status.clear_results();
        }
        if (status.ByteSizeLong() > kEventBytes) status.clear_feedback();
        if (told > 0 && (told == kStepsPerEvent || bytes + status.ByteSizeLong() > kEventBytes)) break;
        ++told;
        bytes += status.ByteSizeLong();
        step.changed = false;
        event.add_steps()->Swap(&status);
    }
    const bool more = anyChanged();
    event.set_run_id(id());
    event.set_sequence(++sequence_);
    // The end is told with the last of the steps.
    event.set_state(more && over() ? proto::RUN_STOPPING : state_);
    event.set_progress(progress());
    event.set_at_s(since(now));
    if (!reason_.ok()) *event.mutable_reason() = toProto(reason_);
    changed_ = more;
    for (const auto& found : problems_) *event.add_problems() = found;
    if (more_problems_ > 0) *event.add_problems() = andMore(more_problems_);
    return event;
}

proto::RunRecord Collaboration::record(TimePoint now) const {
    proto::RunRecord record;
    record.set_run_id(id());
    *record.mutable_service() = request_.service();
    record.set_by(by_);
    record.set_master(self_);
    for (const auto& participant : request_.participants()) {
        auto& kept = *record.add_participants();
        kept.set_role(participant.role());
        kept.set_entity(participant.entity());
        kept.set_name(participant.name());
    }
    record.set_asked_at_ms(request_.asked_at_ms());
    record.set_duration_s(since(ended_.value_or(now)));
    record.set_state(state_);
    if (!reason_.ok()) *record.mutable_reason() = toProto(reason_);
    for (const auto& step : steps_) *record.add_steps() = step.status;
    return record;
}

}  // namespace axon::collaboration
