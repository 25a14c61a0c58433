// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/surveys.hpp"

#include <algorithm>
#include <condition_variable>
#include <future>
#include <map>
#include <utility>

#include "client/base/durations.hpp"
#include "client/core/content.hpp"
#include "client/session.hpp"

namespace axon::client {
namespace {

/// A drill that has not come back by then never arrived.
constexpr Duration kDrillTime = std::chrono::seconds{1};

/// The answers of several entities to one question. Filled under the core's lock.
template <class Answer>
struct Survey {
    explicit Survey(std::size_t asked)
        : answers(asked, Refusal{RefusalCode::TimedOut, "No answer.", {}}), open(asked) {
        if (asked == 0) all.set_value();
    }
    void put(std::size_t place, Answer answer) {
        answers[place] = std::move(answer);
        if (--open == 0) all.set_value();
    }
    std::vector<Answer> answers;
    std::size_t open;
    std::promise<void> all;
};

}  // namespace

Result<Proposal> propose(Client::Session& session, const GlobalService& service, const Bindings& chosen) {
    session.mayWait();
    using Answers = Survey<Result<Details>>;
    std::shared_ptr<Answers> survey;
    std::vector<collaboration::Candidate> candidates;
    std::map<int, std::string> choices;
    const auto asked = session.withCore([&](SessionCore& core) -> Result<void> {
        if (!core.connected()) return core.entities().find("").refusal();
        for (const auto& [role, name] : chosen) {
            const auto entity = core.entities().find(name);
            if (!entity) return entity.refusal();
            choices[role] = entity->id;
        }
        const auto mine = core.leases().held();
        for (const auto& entity : core.entities().list()) {
            auto& candidate = candidates.emplace_back();
            candidate.entity = entity.id;
            candidate.name = core.entities().label(entity.id);
            candidate.category = entity.category;
            candidate.type = entity.type;
            candidate.state = entity.state;
            candidate.latched = entity.latched;
            candidate.holder = entity.holder.name;
            candidate.held_here = std::any_of(mine.begin(), mine.end(),
                                              [&](const Held& held) { return held.entity == entity.id; });
        }
        survey = std::make_shared<Answers>(candidates.size());
        for (std::size_t i = 0; i < candidates.size(); ++i) {
            core.entities().fetchDetails(candidates[i].entity, [survey, i](Result<Details> details) {
                survey->put(i, std::move(details));
            });
        }
        return {};
    });
    if (!asked) return asked.refusal();
    survey->all.get_future().wait();
    for (std::size_t i = 0; i < candidates.size(); ++i) {
        const auto& details = survey->answers[i];
        if (!details) {
            candidates[i].silent = details.refusal().message;
            continue;
        }
        for (const auto& one : details->services)
            candidates[i].offers.push_back({one.name, one.global_id, one.active, one.missing});
    }
    return toPublic(collaboration::propose(rolesOf(service), std::move(candidates), choices));
}

Result<RunHistory> runHistory(Client::Session& session, const std::vector<std::string>& names, int most) {
    session.mayWait();
    using Answers = Survey<Result<std::vector<RunRecord>>>;
    std::shared_ptr<Answers> survey;
    std::vector<std::string> called;
    const auto asked = session.withCore([&](SessionCore& core) -> Result<void> {
        if (!core.connected()) return core.entities().find("").refusal();
        std::vector<std::string> entities;
        for (const auto& name : names) {
            const auto entity = core.entities().find(name);
            if (!entity) return entity.refusal();
            if (std::find(entities.begin(), entities.end(), entity->id) == entities.end())
                entities.push_back(entity->id);
        }
        if (names.empty()) {
            for (const auto& entity : core.entities().list()) entities.push_back(entity.id);
        }
        survey = std::make_shared<Answers>(entities.size());
        for (std::size_t i = 0; i < entities.size(); ++i) {
            called.push_back(core.entities().label(entities[i]));
            core.runs().fetchRecords(entities[i], most, [survey, i](Result<std::vector<RunRecord>> runs) {
                survey->put(i, std::move(runs));
            });
        }
        return {};
    });
    if (!asked) return asked.refusal();
    survey->all.get_future().wait();
    RunHistory history;
    for (std::size_t i = 0; i < called.size(); ++i) {
        auto& answer = survey->answers[i];
        if (!answer) {
            history.silent.emplace_back(called[i], answer.refusal());
            continue;
        }
        for (auto& record : answer.value()) history.runs.push_back(std::move(record));
    }
    std::stable_sort(history.runs.begin(), history.runs.end(),
                     [](const RunRecord& a, const RunRecord& b) { return a.asked_at > b.asked_at; });
    return history;
}

Result<std::vector<DrillReport>> drill(Client::Session& session, const std::vector<std::string>& names,
                                       int count, Seconds period, const std::stop_token& give_up) {
    session.mayWait();
    std::map<std::string, DrillReport> reports;
    std::mutex mutex;
    std::condition_variable_any pause;
    for (int i = 0; i < count && !give_up.stop_requested(); ++i) {
        const auto next = std::chrono::steady_clock::now() + toDuration(period);
        using Answer = Result<std::vector<Receipt>>;
        const auto promise = std::make_shared<std::promise<Answer>>();
        auto future = promise->get_future();
        session.stops().withDesk([&](StopDesk& desk) {
            desk.drill(names, kDrillTime,
                       [promise](Answer answer) { promise->set_value(std::move(answer)); });
        });
        const auto receipts = future.get();
        if (!receipts) return receipts.refusal();
        for (const auto& receipt : receipts.value()) {
            auto& report = reports[receipt.entity];
            report.entity = receipt.entity;
            report.name = receipt.name;
            report.no_application = receipt.no_application;
            report.manager.push_back(receipt.manager);
            report.callback.push_back(receipt.callback_returned);
        }
        if (i + 1 == count) break;
        std::unique_lock lock(mutex);
        pause.wait_until(lock, give_up, next, [] { return false; });
    }
    std::vector<DrillReport> all;
    for (auto& [entity, report] : reports) all.push_back(std::move(report));
    return all;
}

}  // namespace axon::client
