// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>
#include <utility>

#include "cli/session.hpp"

// The fields of the command's JSON (docs/reference/command.md), and what refusals mean for a person.
namespace axon::cli {

Json toJson(const Value& value);
/// `yours`: whether this connection holds it.
Json toJson(const Entity& entity, bool yours);
Json toJson(const Service& service);
Json toJson(const TaskReport& report);
/// A "task" event, complete but for "units": the entity by the name it is called, "elapsed_s", and the fix.
Json taskEvent(const TaskReport& report, const std::string& entity, Seconds elapsed);
/// {parameter: its unit}, of those that have one.
Json unitsOf(const Service& service);
/// The names of its FEEDBACK parameters.
Json feedbackOf(const Service& service);
Json toJson(const Receipt& receipt);
/// A step of a run; without the members of "run" and "run_record" events that are not its own.
Json toJson(const StepReport& step);
/// A "run" event, complete.
Json toJson(const RunReport& report);
Json toJson(const GlobalService& service);
/// A member of "runs", and a "run_record" event; `with_steps`: the service and its steps too.
Json toJson(const RunRecord& record, bool with_steps);
/// {"code", "message", "holder"?}, or null.
Json reasonOf(const Refusal& refusal);
/// A "hand_over" event. `answer`: the command that answers it, up to the entity; empty = nobody can.
Json toJson(const HandOverRequest& request, const std::string& entity, const std::string& answer);

/// What was said before "; fix: ", and the remedy after it, if the message has one.
std::pair<std::string, std::string> parted(const std::string& message);
/// {"event": "error", "code", "message", "holder"?, "fix"?}. `entity` is how the user would name it again.
/// The remedy is that of the message if it has one, and that of the code otherwise.
Json errorEvent(const Refusal& refusal, const std::string& entity = {});
/// A command line that makes no sense; exits with kUsage.
Json usageEvent(const std::string& message, const std::string& fix = {});
/// For refusals of connecting itself.
Json noServerEvent(const Refusal& refusal, const std::string& server);

/// The exit status that a refusal leads to.
int exitOf(const Refusal& refusal);
int exitOf(TaskState state, const Refusal& reason);
int exitOf(RunState state, const Refusal& reason);

/// The shortest name that means only this entity: its name, or "Name#2" where several have it.
std::string callName(const Entity& entity, const std::vector<Entity>& all);

/// As a shell needs it: PeopleBot, 'Cyton Arm'.
std::string shellWord(const std::string& word);

/// JSON on one line; bytes that are no UTF-8 become U+FFFD instead of an exception.
std::string line(const Json& json);

}  // namespace axon::cli
