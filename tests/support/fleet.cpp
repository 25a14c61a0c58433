// SPDX-License-Identifier: GPL-2.0-or-later
#include "tests/support/fleet.hpp"

#include <algorithm>
#include <sstream>

#include "collaboration/sub_lease.hpp"
#include "messages/values.hpp"

namespace axon::test {

namespace {
const std::string kRoot(16, 'o');
constexpr Duration kStep = std::chrono::milliseconds{5};
}  // namespace

proto::GlobalService globalService(const std::vector<std::string>& steps, proto::OnFailure on_failure) {
    proto::GlobalService service;
    service.set_name("Demo");
    service.set_on_failure(on_failure);
    for (const auto& text : steps) {
        std::istringstream words(text);
        auto& step = *service.add_steps();
        std::int32_t role = 0;
        std::int32_t preced = 0;
        std::string name;
        words >> role >> name >> preced;
        step.set_role(role);
        step.set_service_global_id(name);
        step.set_preced(preced);
    }
    return service;
}

Fleet::Fleet(std::size_t robots, std::uint64_t seed, const std::vector<Duration>& watchdogs)
    : robots_(robots) {
    for (std::size_t i = 0; i < robots; ++i) {
        entity_manager::EntityManagerCoreSettings settings{.application = "rig"};
        if (i < watchdogs.size()) settings.server_watchdog_busy = watchdogs[i];
        robots_[i].rig = std::make_unique<CoreRig>(seed * 1000 + i, settings);
        auto& rig = *robots_[i].rig;
        rig.makeIdle();
        rig.take("client1", "r1", kRoot);
        rig.on_application = [this, i](const proto::EmToEi& message) { serve(i, message); };
        rig.on_peer = [this, i](Lane, const Header& head, const proto::ToEntity& message) {
            for (std::size_t to = 0; to < robots_.size(); ++to)
                if (uuid(to) == head.entity && !(lose && lose(i, to, message)))
                    letters_.push_back({i, to, head, message.SerializeAsString()});
        };
        rig.on_client = [this](const CoreRig::ToClientRecord& record) {
            if (record.message.has_reply() && record.message.reply().has_refusal())
                told.refused = toRefusal(record.message.reply().refusal());
            if (!record.message.has_run()) return;
            const auto& event = record.message.run();
            told.in_order = told.in_order && event.sequence() == told.sequence + 1;
            told.sequence = event.sequence();
            told.state = event.state();
            told.events.emplace_back(event.state(), now());
            told.reason = event.reason();
            told.problems.assign(event.problems().begin(), event.problems().end());
            for (const auto& step : event.steps()) told.steps[step.step()] = step;
        };
    }
}

void Fleet::serve(std::size_t robot, const proto::EmToEi& message) {
    auto& self = robots_[robot];
    const auto find = [&](const std::string& id) {
        return std::find_if(self.running.begin(), self.running.end(),
                            [&](const Running& task) { return task.id == id; });
    };
    if (message.has_task()) {
        const auto& dispatch = message.task();
        auto outcome = behave ? behave(robot, dispatch) : Outcome{};
        proto::EiToEm answer;
        answer.mutable_task_answer()->set_task_id(dispatch.task_id());
        if (outcome.denied) {
            answer.mutable_task_answer()->mutable_refusal()->set_code(proto::DENIED);
            answer.mutable_task_answer()->mutable_refusal()->set_message("It does not want to.");
        } else {
            const auto ends = rig(robot).clock.now() + outcome.lasts;
            self.running.push_back({dispatch.task_id(), dispatch.service(), ends, {}, false, outcome});
            log.push_back({Happened::What::Began, robot, dispatch.service(), rig(robot).clock.now()});
        }
        self.answers.push_back(answer);
        if (!outcome.denied && outcome.lasts <= Duration::zero()) {
            const auto task = self.running.back();
            self.running.pop_back();
            finish(robot, task);
        }
    } else if (message.has_cancel()) {
        const auto task = find(message.cancel().task_id());
        if (task == self.running.end() || task->outcome.deaf) return;
        task->paused = false;
        task->ends = rig(robot).clock.now();
        task->outcome = {.verdict = proto::TASK_CANCELLED};
    } else if (message.has_pause()) {
        const auto task = find(message.pause().task_id());
        if (task == self.running.end() || task->outcome.deaf || task->paused != message.pause().resume())
            return;
        const auto now = rig(robot).clock.now();
        task->paused = !task->paused;
        if (task->paused)
            task->left = task->ends - now;
        else
            task->ends = now + task->left;
        proto::EiToEm answer;
        answer.mutable_task()->mutable_event()->set_task_id(task->id);
        answer.mutable_task()->mutable_event()->set_progress(-1);
        answer.mutable_task()->mutable_event()->set_state(task->paused ? proto::TASK_PAUSED
                                                                       : proto::TASK_RUNNING);
        self.answers.push_back(answer);
    }
}

void Fleet::finish(std::size_t robot, const Running& task) {
    log.push_back({Happened::What::Ended, robot, task.service, rig(robot).clock.now()});
    proto::EiToEm ended;
    auto& event = *ended.mutable_task()->mutable_event();
    event.set_task_id(task.id);
    event.set_state(task.outcome.verdict);
    event.set_progress(-1);
    for (const auto& result : task.outcome.results) *event.add_results() = result;
    robots_[robot].answers.push_back(ended);
}

/// What the Entity Interfacer does at each stop, also at the loss of its Entity Manager.
void Fleet::halt(std::size_t robot) {
    auto& self = robots_[robot];
    for (const auto& task : std::exchange(self.running, {})) {
        log.push_back({Happened::What::Stopped, robot, task.service, rig(robot).clock.now()});
        proto::EiToEm ended;
        ended.mutable_task()->mutable_event()->set_task_id(task.id);
        ended.mutable_task()->mutable_event()->set_state(proto::TASK_STOPPED);
        self.answers.push_back(ended);
    }
}

void Fleet::deliver() {
    bool more = true;
    while (more) {
        more = false;
        for (std::size_t i = 0; i < robots_.size(); ++i) {
            auto& rig = *robots_[i].rig;
            for (const auto& [generation, cause] : std::exchange(rig.stops, {})) {
                if (cause == StopCause::Drill) continue;
                halt(i);
                proto::EiToEm done;
                done.mutable_stop_done()->set_stop_generation(generation);
                done.mutable_stop_done()->set_stage(proto::StopReceipt::CALLBACK_RETURNED);
                robots_[i].answers.push_back(done);
                more = true;
            }
            while (!frozen_.contains(i) && !robots_[i].answers.empty()) {
                auto answer = std::move(robots_[i].answers.front());
                robots_[i].answers.pop_front();
                rig.fromApplication(std::move(answer));
                more = true;
            }
        }
        while (!letters_.empty()) {
            const auto letter = std::move(letters_.front());
            letters_.pop_front();
            if (!reaches(letter.from, letter.to)) continue;
            auto head = letter.head;
            head.sender = {uuid(letter.from), "Robot " + std::to_string(letter.from), Role::Operator};
            rig(letter.to).core().onClientMsg(head, letter.bytes);
            more = true;
        }
    }
}

void Fleet::advance(Duration by) {
    deliver();
    for (const auto end = now() + by; now() < end;) {
        for (std::size_t i = 0; i < robots_.size(); ++i) {
            auto& rig = *robots_[i].rig;
            if (frozen_.contains(i)) {
                rig.clock.set(rig.clock.now() + kStep);
            } else {
                rig.core().onServerHeartbeat();
                rig.advance(kStep, false);
            }
        }
        deliver();
        for (std::size_t i = 0; i < robots_.size(); ++i) {
            auto& self = robots_[i];
            for (std::size_t at = 0; at < self.running.size();) {
                if (self.running[at].paused || self.running[at].ends > self.rig->clock.now()) {
                    ++at;
                    continue;
                }
                const auto task = self.running[at];
                self.running.erase(self.running.begin() + static_cast<std::ptrdiff_t>(at));
                finish(i, task);
            }
        }
        deliver();
    }
}

proto::CollaborationRequest Fleet::request(const proto::GlobalService& service, std::size_t master,
                                           const std::string& run) {
    proto::CollaborationRequest request;
    request.set_run_id(idOf(run));
    *request.mutable_service() = service;
    std::set<std::int32_t> roles;
    for (const auto& step : service.steps()) roles.insert(step.role());
    for (const auto role : roles) {
        const auto robot = static_cast<std::size_t>(role);
        auto& participant = *request.add_participants();
        participant.set_role(role);
        participant.set_entity(uuid(robot));
        participant.set_name("Robot " + std::to_string(role));
        const auto& belief = rig(robot).clients["client1"];
        auto& lease = *participant.mutable_lease();
        lease.set_epoch(static_cast<std::uint32_t>(belief.lease.epoch));
        lease.set_number(static_cast<std::uint32_t>(belief.lease.number));
        lease.set_root(kRoot);
        lease.set_stop_generation(static_cast<std::uint32_t>(belief.generation));
        collaboration::seal(lease, {request.run_id(), uuid(master), uuid(robot)}, belief.key);
    }
    return request;
}

void Fleet::launch(const proto::GlobalService& service, std::size_t master, const std::string& run) {
    launch(request(service, master, run), master);
}

void Fleet::launch(const proto::CollaborationRequest& request, std::size_t master) {
    told = {};
    log.clear();
    proto::ToEntity message;
    *message.mutable_collaboration() = request;
    rig(master).send("client1", message);
    deliver();
}

void Fleet::control(std::size_t master, const std::string& run, proto::TaskAction action) {
    told.refused = {};
    proto::ToEntity message;
    message.mutable_task_control()->set_task_id(idOf(run));
    message.mutable_task_control()->set_action(action);
    rig(master).send("client1", message);
    deliver();
}

proto::RunRecord Fleet::record(std::size_t master) {
    proto::ToEntity message;
    message.mutable_run_history()->set_request_id(idOf("history"));
    message.mutable_run_history()->set_most(1);
    rig(master).send("observer", message);
    const auto& answer = rig(master).to_clients.back().message.run_history();
    return answer.runs_size() > 0 ? answer.runs(0) : proto::RunRecord{};
}

std::vector<std::pair<std::size_t, std::string>> Fleet::order() const {
    std::vector<std::pair<std::size_t, std::string>> all;
    for (const auto& event : log)
        if (event.what == Happened::What::Began) all.emplace_back(event.robot, event.service);
    return all;
}

}  // namespace axon::test
