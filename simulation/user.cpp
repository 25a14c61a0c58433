// SPDX-License-Identifier: GPL-2.0-or-later
#include "simulation/user.hpp"

#include <axon/task.pb.h>

#include <algorithm>

namespace axon::simulation {

namespace {

using namespace std::chrono_literals;

constexpr std::size_t kTasksKnown = 8;
constexpr Duration kStopDeadline = 1s;
constexpr Duration kAnswerWithin = 5500ms;  // the library's time-out, and what clocks may differ
constexpr const char* kServices[] = {"Driving", "Turning", "Light", "Light", "Lift", "Lift", "Dock"};

}  // namespace

User::User(Timeline& timeline, ClientStation& client, std::uint64_t seed, TimePoint retires_at)
    : timeline_(timeline), client_(client), dice_(seed), retires_at_(retires_at) {
    client_.on_start = [this] {
        open_ = 0;
        ++life_;
        tasks_.clear();
        if (dice_.chance(0.3)) tickets_.clear();  // who sits there now does not know of them
        useTickets();
        comeBack(dice_.between(1ms, 400ms));
    };
    client_.on_kill = [this] {
        const auto* core = client_.core();
        if (core == nullptr) return;
        for (const auto& held : core->leases().held())
            if (auto ticket = core->leases().ticket(held)) tickets_.push_back(std::move(ticket).value());
    };
    client_.on_hand_over = [this](const client::Held& held) {
        if (dice_.chance(0.2)) return;  // says nothing; the policy decides
        timeline_.after(dice_.between(2ms, 1500ms), client_.process(),
                        [this, held] { answerHandOver(held); });
    };
}

void User::useTickets() {
    if (tickets_.empty() || timeline_.now() >= retires_at_) return tickets_.clear();
    auto& core = *client_.core();
    std::erase_if(tickets_, [&](const client::LeaseTicket& ticket) {
        if (!client_.connected() || !core.entities().entity(ticket.entity)) return false;
        timeline_.tell(client_.process().name(),
                       [&] { return "has a ticket for lease " + std::to_string(ticket.lease.number); });
        ++open_;
        core.checkOuts().resume(ticket,
                                [this, life = life_](const Result<std::vector<client::Held>>& result) {
                                    if (life != life_) return;
                                    --open_;
                                    if (result) ++tickets_resumed_;
                                });
        return true;
    });
    client_.settle();
    timeline_.after(50ms, client_.process(), [this] { useTickets(); });
}

void User::answerHandOver(const client::Held& held) {
    auto& core = *client_.core();
    if (!core.leases().question(held)) return;
    const bool accept = dice_.chance(0.5);
    timeline_.tell(client_.process().name(), [&] { return accept ? "hands it over" : "keeps it"; });
    (void)core.leases().answerHandOver(held, accept, "").ok();
    client_.settle();
}

void User::comeBack(Duration in) {
    timeline_.after(in, client_.process(), [this] {
        if (timeline_.now() >= retires_at_) {
            retire();
            comeBack(400ms);
            return;
        }
        act();
        client_.settle();
        comeBack(dice_.chance(0.2) ? dice_.between(100us, 40ms) : dice_.between(100ms, 2200ms));
    });
}

client::Done User::answered() {
    ++open_;
    return [this, life = life_, asked = timeline_.now()](const Result<void>&) {
        if (life != life_) return;
        --open_;
        // Who was frozen meanwhile cannot know.
        if (timeline_.now() - asked > kAnswerWithin && client_.process().changedAt() < asked)
            complain("a request of " + client_.process().name() + " had its answer after " +
                     std::to_string((timeline_.now() - asked) / 1ms) + " ms");
    };
}

void User::act() {
    auto& core = *client_.core();
    const auto say = [&](const std::string& what) {
        timeline_.tell(client_.process().name(), [&] { return what; });
    };
    if (dice_.chance(0.06)) {
        const auto entities = core.entities().list();
        if (entities.empty()) return;
        const auto& entity = entities[dice_.roll(entities.size())];
        const bool all = dice_.chance(0.2);
        say(all ? "stops everything" : "stops " + entity.name);
        ++open_;
        client_.desk()->stop(all ? std::vector<std::string>{} : std::vector<std::string>{entity.id},
                             kStopDeadline,
                             [this, life = life_](const Result<std::vector<client::Receipt>>&) {
                                 if (life == life_) --open_;
                             });
        return;
    }
    if (client_.role() == Role::Admin && dice_.chance(0.05)) {
        const auto entities = core.entities().list();
        if (entities.empty()) return;
        const auto& entity = entities[dice_.roll(entities.size())];
        say("rearms " + entity.name + " as administrator");
        core.commands().rearm(entity.id, answered());
        return;
    }
    const auto held = core.leases().held();
    if (held.empty() || (held.size() == 1 && dice_.chance(0.1)))
        checkOut();
    else
        work(held[dice_.roll(held.size())]);
}

void User::checkOut() {
    auto& core = *client_.core();
    const auto entities = core.entities().list();
    if (entities.empty()) return;
    std::vector<std::string> names{entities[dice_.roll(entities.size())].id};
    if (dice_.chance(0.3)) {
        const auto& other = entities[dice_.roll(entities.size())].id;
        if (other != names.front()) names.push_back(other);
    }
    client::CheckOutOptions options;
    options.hand_over.answer_within = client::Seconds(0.3 + static_cast<double>(dice_.roll(30)) / 10);
    options.hand_over.yield = dice_.chance(0.5);
    options.hand_over.refuse = dice_.chance(0.15);
    const auto way = dice_.roll(10);
    options.ask = way >= 6 && way < 9 && names.size() == 1;
    options.force = way == 9 && client_.role() == Role::Admin;
    if ((way >= 3 && way < 6) || (options.ask && dice_.chance(0.4)))
        options.wait = client::Seconds(0.5 + static_cast<double>(dice_.roll(80)) / 10);
    timeline_.tell(client_.process().name(), [&] {
        return "checks out " + std::to_string(names.size()) + ": " +
               core.entities().entity(names.front()).value().name + (options.ask ? ", asks" : "") +
               (options.wait ? ", waits" : "") + (options.force ? ", by force" : "");
    });
    ++open_;
    spring();
    const auto id = core.checkOuts().checkOut(
        names, options, [this, life = life_](const Result<std::vector<client::Held>>& result) {
            if (life == life_) --open_;
            if (!result)
                timeline_.tell(client_.process().name(),
                               [&] { return "is refused the check-out: " + result.refusal().message; });
        });
    if (options.wait && dice_.chance(0.2))
        timeline_.after(dice_.between(100ms, 3s), client_.process(), [this, id] {
            client_.core()->checkOuts().giveUp(id);
            client_.settle();
        });
}

void User::work(const client::Held& held) {
    auto& core = *client_.core();
    const auto known = core.entities().entity(held.entity);
    const std::string name = known ? known->name : "?";
    const auto say = [&](const char* what) {
        timeline_.tell(client_.process().name(), [&] { return std::string(what) + ' ' + name; });
    };
    if (known && known->latched && dice_.chance(0.7)) {
        say("rearms");
        core.commands().rearm(held.entity, answered());
        if (dice_.chance(0.5)) return;
    }
    const auto what = dice_.roll(100);
    if (what < 48) {
        spring();
        for (auto more = 1 + dice_.roll(3); more > 0; --more) {
            const auto not_after = dice_.chance(0.25) ? dice_.between(5ms, 600ms) : Duration{};
            tasks_.push_back(
                core.tasks().run(held, kServices[dice_.roll(std::size(kServices))], {}, not_after));
            timeline_.tell(client_.process().name(),
                           [&] { return "runs " + tasks_.back().toString().substr(0, 8) + " on " + name; });
            if (tasks_.size() > kTasksKnown) tasks_.pop_front();
        }
    } else if (what < 66 && !tasks_.empty()) {
        static constexpr proto::TaskAction kActions[] = {proto::PAUSE, proto::PAUSE, proto::RESUME,
                                                         proto::RESUME, proto::CANCEL};
        const auto& task = tasks_[tasks_.size() - 1 - dice_.roll(std::min<std::size_t>(tasks_.size(), 3))];
        const auto action = kActions[dice_.roll(std::size(kActions))];
        say(action == proto::PAUSE    ? "pauses a task of"
            : action == proto::RESUME ? "resumes a task of"
                                      : "cancels a task of");
        core.tasks().control(task, action, answered());
    } else if (what < 71) {
        say("resets");
        (void)core.commands().reset(held).ok();
    } else if (what < 75) {
        say("clears");
        (void)core.commands().clear(held).ok();
    } else if (what < 79) {
        core.commands().set(held, "Driving", {"Speed", {std::int64_t{100}}, {}}, answered());
    } else if (what < 83) {
        (void)core.commands().sendRaw(held, "joystick").ok();
    } else if (what < 92) {
        say("releases");
        core.leases().release(held, answered());
    }
}

void User::spring() {
    if (const auto trap = std::exchange(ambush, nullptr)) trap();
}

void User::retire() {
    auto& core = *client_.core();
    for (const auto& held : core.leases().held()) core.leases().release(held, answered());
    client_.settle();
}

Visitor::Visitor(Timeline& timeline, ClientStation& client, std::size_t entities)
    : timeline_(timeline), client_(client), wanted_(entities) {
    client_.on_start = [this] { timeline_.after(50ms, client_.process(), [this] { look(); }); };
}

void Visitor::look() {
    auto& core = *client_.core();
    timeline_.after(150ms, client_.process(), [this] { look(); });
    for (const auto& entity : core.entities().list()) {
        const auto known = std::find_if(visits_.begin(), visits_.end(),
                                        [&](const Visit& visit) { return visit.entity == entity.id; });
        if (known == visits_.end()) visits_.push_back({entity.id, false, false, {}, {}, "not asked yet"});
    }
    for (std::size_t i = 0; i < visits_.size(); ++i) {
        auto& visit = visits_[i];
        if (visit.done) continue;
        if (visit.held && !core.leases().holds(*visit.held)) {
            visit.held.reset();
            visit.task.reset();
            visit.last = "lost its lease";
        }
        if (!visit.held) {
            if (visit.asked) continue;
            visit.asked = true;
            core.checkOuts().checkOut(
                {visit.entity}, [this, i](const Result<std::vector<client::Held>>& result) {
                    visits_[i].asked = false;
                    if (result)
                        visits_[i].held = result.value().front();
                    else
                        visits_[i].last = "is refused the check-out: " + result.refusal().message;
                });
            continue;
        }
        if (visit.task) {
            const auto report = core.tasks().report(*visit.task);
            if (!report || !client::isFinal(report->state)) {
                visit.last = "waits for its task";
                continue;
            }
            visit.task.reset();
            if (report->state == client::TaskState::Succeeded) {
                visit.done = true;
                ++done_;
                core.leases().release(*visit.held, [](const Result<void>&) {});
                continue;
            }
            visit.last = "has no luck with its task: " + report->reason.message;
        }
        if (const auto entity = core.entities().entity(visit.entity); entity && entity->latched) {
            visit.last = "rearms it";
            core.commands().rearm(visit.entity, [](const Result<void>&) {});
            continue;
        }
        visit.task = core.tasks().run(*visit.held, "Turning", {}, {});
    }
    client_.settle();
}

std::string Visitor::complaint() const {
    if (!client_.connected()) return "a fresh client has no session";
    if (visits_.size() < wanted_)
        return "a fresh client sees " + std::to_string(visits_.size()) + " of " + std::to_string(wanted_) +
               " entities";
    std::string all;
    for (const auto& visit : visits_)
        if (!visit.done)
            all += (all.empty() ? "a fresh client could not use " : "; ") + visit.entity.substr(0, 8) +
                   ": it " + visit.last;
    return all;
}

}  // namespace axon::simulation
