// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include "cli/holding.hpp"
#include "cli/words.hpp"
#include "messages/text.hpp"

// axon tasks, wait, pause, resume, cancel
namespace axon::cli {
namespace {

using Clock = std::chrono::steady_clock;

/// What the entity of a task is called; its UUID where it has gone.
std::string entityOf(const std::string& id, const std::vector<Entity>& all) {
    const auto entity = std::find_if(all.begin(), all.end(), [&](const Entity& one) { return one.id == id; });
    return entity == all.end() ? id : callName(*entity, all);
}

Refusal ambiguous(const std::vector<TaskReport>& candidates) {
    std::string list;
    for (const auto& task : candidates) list += "\n  " + task.id + "  " + task.service;
    return {RefusalCode::UnknownTask, "several tasks match; name one by the beginning of its id:" + list, {}};
}

/// The task that is meant: by the beginning of its id, or the only one of the entity that is not over.
Result<TaskReport> findTask(Session& session, const Entity& entity, const std::string& id) {
    std::vector<TaskReport> candidates;
    for (const auto& [task, elapsed] : session.station->tasks().list) {
        if (task.entity != entity.id) continue;
        if (id.empty() ? !client::isFinal(task.state) : task.id.compare(0, id.size(), id) == 0) {
            candidates.push_back(task);
        }
    }
    if (candidates.size() == 1) return candidates.front();
    if (candidates.empty()) {
        return Refusal{RefusalCode::UnknownTask,
                       id.empty()
                           ? "no task of " + callOf(session, entity) + " is running or waiting"
                           : "no task of " + callOf(session, entity) + " has an id that begins with " + id,
                       {}};
    }
    // Of several, the running one is what a person means who names none.
    if (id.empty()) {
        std::vector<TaskReport> started;
        std::copy_if(candidates.begin(), candidates.end(), std::back_inserter(started),
                     [](const TaskReport& task) {
                         return task.state == TaskState::Running || task.state == TaskState::Paused;
                     });
        if (started.size() == 1) return started.front();
    }
    return ambiguous(candidates);
}

int control(Session& session, TaskAction action, const char* verb) {
    const auto name = session.args.at("entity").get<std::string>();
    const auto entity = findHeld(session, name);
    if (!entity) return refuse(session, entity.refusal(), name);
    const auto task = findTask(session, entity.value(), session.args.value("task", ""));
    if (!task) return refuse(session, task.refusal(), name);
    if (const auto done = session.station->control(task->id, action); !done)
        return refuse(session, done.refusal(), name);
    session.events.emit({{"event", "done"},
                         {"verb", verb},
                         {"entity", callOf(session, entity.value())},
                         {"service", task->service},
                         {"task", task->id}});
    return kDone;
}

int pauseTask(Session& session) {
    return control(session, TaskAction::Pause, "pause");
}
int resumeTask(Session& session) {
    return control(session, TaskAction::Resume, "resume");
}
int cancelTask(Session& session) {
    return control(session, TaskAction::Cancel, "cancel");
}

/// When `--for` is over.
std::optional<Clock::time_point> endOf(const Session& session) {
    const auto given = session.args.find("for");
    if (given == session.args.end()) return std::nullopt;
    return Clock::now() + std::chrono::duration_cast<Clock::duration>(Seconds(given->get<double>()));
}

/// As it waits in the mailbox: Changes makes a "task" event of it, which calls the entity by its name.
Json changeOf(const KeptTask& task) {
    auto change = toJson(task.report);
    change["elapsed_s"] = task.elapsed.count();
    change["exit"] = exitOf(task.report.state, task.report.reason);
    change["code"] = static_cast<int>(task.report.reason.code);
    return change;
}

/// Posts each change of each task to the mailbox, or of one entity's.
std::shared_ptr<void> followInMailbox(Session& session, const std::string& only) {
    return session.station->followTasks([mailbox = session.mailbox, only](const KeptTask& task) {
        if (!only.empty() && task.report.entity != only) return;
        mailbox->post(changeOf(task), !client::isFinal(task.report.state));
    });
}

/// Shows changes of tasks in the order in which they came about: nothing of a task after its end, which may
/// have been shown before its last changes arrive.
class Changes {
  public:
    explicit Changes(Session& session) : session_(session) {}

    /// What was shown before the first change.
    void seen(const std::string& id) { over_.insert(id); }

    /// Whether it was the end of a task.
    bool show(Json event) {
        if (event.at("event") != "task") {
            session_.events.emit(event);
            return false;
        }
        const auto id = event.at("id").get<std::string>();
        if (over_.count(id) != 0) return false;
        const bool ends = event.at("final");
        if (ends) over_.insert(id);
        const auto entity = event.at("entity").get<std::string>();
        const auto name = entityOf(entity, session_.station->entities());
        event["entity_id"] = entity;
        event["entity"] = name;
        event["units"] = ends ? unitsOfService(entity, event.at("service")) : Json::object();
        if (const auto code = event.at("code").get<int>(); code != 0) {
            const auto error = errorEvent(
                {static_cast<RefusalCode>(code), {}, event.at("reason").value("holder", "")}, name);
            if (error.contains("fix")) event["fix"] = error["fix"];
        }
        event.erase("code");
        event.erase("exit");
        session_.events.emit(event);
        return ends;
    }

  private:
    /// The units of its results; none where the entity does not tell its services.
    Json unitsOfService(const std::string& entity, const std::string& service) {
        const auto [at, unknown] = units_.try_emplace({entity, service}, Json::object());
        if (!unknown) return at->second;
        if (const auto services = session_.station->services(entity)) {
            for (const auto& one : services.value())
                if (one.name == service) at->second = unitsOf(one);
        }
        return at->second;
    }

    Session& session_;
    std::set<std::string> over_;
    std::map<std::pair<std::string, std::string>, Json> units_;
};

int tasks(Session& session) {
    const bool follow = session.args.value("follow", false);
    if (!follow && session.args.contains("for"))
        return misused(session, "--for limits --follow, and needs it", "axon tasks --follow --for 60");
    std::string only;
    if (const auto name = session.args.value("entity", ""); !name.empty()) {
        const auto entity = session.station->find(name);
        if (!entity) return refuse(session, entity.refusal(), name);
        only = entity->id;
    }
    // Before the list, so that no change falls between the two.
    const auto following = follow ? followInMailbox(session, only) : nullptr;
    const auto end = endOf(session);
    const auto all = session.station->entities();
    const auto kept = session.station->tasks();
    Changes changes(session);
    auto list = Json::array();
    for (const auto& [task, elapsed] : kept.list) {
        if (!only.empty() && task.entity != only) continue;
        auto json = taskEvent(task, entityOf(task.entity, all), elapsed);
        json.erase("event");
        list.push_back(std::move(json));
        if (client::isFinal(task.state)) changes.seen(task.id);
    }
    session.events.emit({{"event", "tasks"}, {"tasks", std::move(list)}, {"forgotten", kept.forgotten}});
    if (session.station->held().empty()) tellLost(session);
    if (!follow) return kDone;
    while (const auto event = session.mailbox->wait(end)) changes.show(*event);
    return session.mailbox->takeInterrupt() ? kInterrupted : kDone;
}

/// The tasks that are to be waited for, in the order in which they were named; none named = all that are not
/// over.
Result<std::vector<KeptTask>> awaited(Session& session) {
    const auto kept = session.station->tasks();
    const auto names = session.args.value("task", std::vector<std::string>{});
    std::vector<KeptTask> chosen;
    if (names.empty()) {
        std::copy_if(kept.list.begin(), kept.list.end(), std::back_inserter(chosen),
                     [](const KeptTask& one) { return !client::isFinal(one.report.state); });
        return chosen;
    }
    for (const auto& name : names) {
        std::vector<TaskReport> candidates;
        KeptTask found;
        for (const auto& one : kept.list) {
            if (one.report.id.compare(0, name.size(), name) != 0) continue;
            candidates.push_back(one.report);
            found = one;
        }
        if (candidates.size() > 1) return ambiguous(candidates);
        if (candidates.empty()) {
            auto message = "no task that was started here has an id that begins with " + inQuotes(name);
            if (kept.forgotten > 0)
                message +=
                    "; " + std::to_string(kept.forgotten) + " tasks that have ended are no longer kept";
            return Refusal{RefusalCode::UnknownTask, message, {}};
        }
        const bool again = std::any_of(chosen.begin(), chosen.end(),
                                       [&](const KeptTask& one) { return one.report.id == found.report.id; });
        if (!again) chosen.push_back(std::move(found));
    }
    return chosen;
}

int waitForTasks(Session& session) {
    const auto following = followInMailbox(session, {});
    const auto chosen = awaited(session);
    if (!chosen) return refuse(session, chosen.refusal());
    if (chosen->empty()) {
        session.events.emit({{"event", "notice"}, {"message", "no task is running or waiting"}});
        return kDone;
    }
    std::map<std::string, std::optional<int>> exits;  // by id; none: it has not ended
    for (const auto& [task, elapsed] : chosen.value()) exits[task.id] = std::nullopt;
    Changes changes(session);
    const auto show = [&](const Json& event) {
        const auto exit = event.contains("exit") ? event.at("exit").get<int>() : 0;
        if (changes.show(event)) exits[event.at("id")] = exit;
    };
    for (const auto& task : chosen.value()) show(changeOf(task));
    const auto end = endOf(session);
    const auto open = [&] {
        return std::count_if(exits.begin(), exits.end(), [](const auto& one) { return !one.second; });
    };
    while (open() > 0) {
        const auto event = session.mailbox->wait(end);
        if (!event) {
            const std::string go_on = open() == 1 ? "the task continues" : "the tasks continue";
            if (session.mailbox->takeInterrupt()) {
                session.events.emit({{"event", "notice"}, {"message", go_on + ": axon tasks shows more"}});
                return kInterrupted;
            }
            return refuseWith(session,
                              {RefusalCode::TimedOut,
                               std::to_string(open()) + " of " + std::to_string(exits.size()) +
                                   " tasks had not ended when the time of --for was up; " + go_on,
                               {}},
                              "wait longer: axon wait; or look at the tasks: axon tasks");
        }
        if (event->at("event") != "task" || exits.count(event->at("id")) != 0) show(*event);
    }
    for (const auto& [task, elapsed] : chosen.value())
        if (*exits.at(task.id) != kDone) return *exits.at(task.id);
    return kDone;
}

std::vector<Operand> taskOperands() {
    return {{"entity", Takes::Entity, true, false, "The entity"},
            {"task", Takes::Task, false, false, "Beginning of the task's id; without one, the running task"}};
}

}  // namespace

extern const Verb kTasks{"tasks",
                         "Show the tasks that were started under axon checkout",
                         "  axon tasks\n"
                         "  axon tasks PeopleBot\n"
                         "  axon tasks --follow                       then each change, until Ctrl-C\n"
                         "  axon tasks --follow --for 60 --json       for a minute, as JSON lines\n"
                         "The list has every task that is running or waiting, and the newest 256 of all. The "
                         "agent forgets it when\n"
                         "everything has been released.\n",
                         Runs::Kept,
                         {{"entity", Takes::Entity, false, false, "Only the tasks of this entity"}},
                         {{"follow", Takes::Nothing, "Then show every change, of new tasks too"},
                          {"for", Takes::Duration, "Follow for this long, then end"}},
                         tasks};

extern const Verb kWait{
    "wait",
    "Wait for the end of tasks that were started with axon run --detach",
    "  axon run PeopleBot Driving Distance=1000 --detach\n"
    "  axon run Cyton 'Reach Demo' --detach\n"
    "  axon wait                    for all tasks that are running or waiting now\n"
    "  axon wait 3f2a               the task whose id begins so (axon tasks)\n"
    "  axon wait 3f2a --for 30      at most 30 s; if the task has not ended, it continues, and the status is "
    "4\n"
    "Shows every change as axon run does. The exit status is that of the first named task that did not\n"
    "succeed. A task that has already ended is reported immediately. Ctrl-C ends the wait, not the tasks.\n",
    Runs::Kept,
    {{"task", Takes::Task, false, true, "Beginning of a task's id; without one, all that have not ended"}},
    {{"for", Takes::Duration, "Wait at most this long"}},
    waitForTasks};

extern const Verb kPause{"pause", "Pause a task", "  axon pause PeopleBot\n", Runs::Kept, taskOperands(),
                         {},      pauseTask};
extern const Verb kResume{"resume",   "Continue a paused task", "  axon resume PeopleBot\n",
                          Runs::Kept, taskOperands(),           {},
                          resumeTask};
extern const Verb kCancel{"cancel",
                          "Cancel a running or waiting task, without latching the entity",
                          "  axon cancel PeopleBot\n"
                          "  axon cancel PeopleBot 3f2a     the task whose id begins so (axon tasks)\n",
                          Runs::Kept,
                          taskOperands(),
                          {},
                          cancelTask};

}  // namespace axon::cli
