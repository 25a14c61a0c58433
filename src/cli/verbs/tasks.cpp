// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>

#include "cli/verbs/holding.hpp"
#include "cli/words.hpp"

// axon tasks, pause, resume, cancel
namespace axon::cli {
namespace {

/// The task that is meant: by the beginning of its id, or the only one of the entity that is not over.
Result<TaskReport> findTask(Session& session, const Entity& entity, const std::string& id) {
    std::vector<TaskReport> candidates;
    for (const auto& task : session.station->tasks()) {
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
    std::string list;
    for (const auto& task : candidates) list += "\n  " + task.id + "  " + task.service;
    return Refusal{RefusalCode::UnknownTask,
                   "several tasks may be meant; name one by the beginning of its id:" + list,
                   {}};
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

int tasks(Session& session) {
    std::string only;
    if (const auto name = session.args.value("entity", ""); !name.empty()) {
        const auto entity = session.station->find(name);
        if (!entity) return refuse(session, entity.refusal(), name);
        only = entity->id;
    }
    const auto all = session.station->entities();
    auto list = Json::array();
    for (const auto& task : session.station->tasks()) {
        if (!only.empty() && task.entity != only) continue;
        auto json = toJson(task);
        json.erase("event");
        const auto entity =
            std::find_if(all.begin(), all.end(), [&](const Entity& e) { return e.id == task.entity; });
        json["entity_id"] = task.entity;
        if (entity != all.end()) json["entity"] = callName(*entity, all);
        list.push_back(std::move(json));
    }
    session.events.emit({{"event", "tasks"}, {"tasks", std::move(list)}});
    return kDone;
}

std::vector<Operand> taskOperands() {
    return {{"entity", Takes::Entity, true, false, "Which entity"},
            {"task", Takes::Task, false, false, "Beginning of the task's id; none = the running one"}};
}

}  // namespace

extern const Verb kTasks{"tasks",
                         "Show the tasks that were begun under axon checkout",
                         "  axon tasks\n"
                         "  axon tasks PeopleBot\n",
                         Runs::Kept,
                         {{"entity", Takes::Entity, false, false, "Only this entity's"}},
                         {},
                         tasks};

extern const Verb kPause{"pause", "Pause a task", "  axon pause PeopleBot\n", Runs::Kept, taskOperands(),
                         {},      pauseTask};
extern const Verb kResume{
    "resume",  "Let a paused task go on", "  axon resume PeopleBot\n", Runs::Kept, taskOperands(), {},
    resumeTask};
extern const Verb kCancel{"cancel",
                          "End a task, running or waiting, without a latch",
                          "  axon cancel PeopleBot\n"
                          "  axon cancel PeopleBot 3f2a     the task whose id begins so (axon tasks)\n",
                          Runs::Kept,
                          taskOperands(),
                          {},
                          cancelTask};

}  // namespace axon::cli
