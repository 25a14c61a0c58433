// SPDX-License-Identifier: GPL-2.0-or-later
#include <unistd.h>

#include <iostream>

#include "cli/agent_link.hpp"
#include "cli/caretaker.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"
#include "common/release.hpp"
#include "messages/profile_command.hpp"

// axon profile, axon agent, axon version
namespace axon::cli {
namespace {

int profile(Session& session) {
    return checkProfiles(session.args.at("files").get<std::vector<std::string>>(), session.settings.json,
                         std::cout);
}

int agent(Session& session) {
    const auto place = agentPlace(session.settings.server);
    auto held = Json::array();
    auto lost = Json::array();
    for (const auto& entity : session.station->held()) {
        held.push_back(toJson(entity, true));
        held.back()["call"] = callOf(session, entity);
        held.back()["orphaned"] = session.station->orphaned(entity.id);
        held.back()["direct"] = session.station->direct(entity.id);
    }
    for (const auto& one : session.station->lost()) {
        lost.push_back({{"id", one.entity.id},
                        {"name", one.entity.name},
                        {"code", refusalName(one.why.code)},
                        {"message", one.why.message},
                        {"holder", one.why.holder}});
    }
    if (session.args.contains("notify") || session.args.contains("idle")) {
        if (!session.notify || !session.set_idle)
            return misused(session, "--notify and --idle are for the agent that axon checkout starts",
                           "not inside axon checkout … -- COMMAND");
        if (session.args.contains("notify") && refuseUnreachable(session, session.args.at("notify")))
            return kUsage;
        if (session.args.contains("idle")) session.set_idle(session.args.at("idle").get<double>());
        if (session.args.contains("notify")) {
            session.notify(session.args.at("notify"));
            session.events.emit(
                {{"event", "notice"}, {"message", "requests for what is held are told here at once"}});
        }
    }
    if (session.args.value("action", "status") == "stop") {
        for (const auto& entity : session.station->held()) {
            if (const auto done = session.station->release(entity.id); !done) {
                session.events.emit(errorEvent(done.refusal(), entity.name));
            } else {
                session.events.emit(
                    {{"event", "released"}, {"id", entity.id}, {"entity", callOf(session, entity)}});
            }
        }
        if (session.end_agent) {
            session.events.emit({{"event", "notice"}, {"message", "the agent has ended"}});
            session.end_agent();
        }
        return kDone;
    }
    session.events.emit({{"event", "agent"},
                         {"running", true},
                         {"pid", ::getpid()},
                         {"server", session.station->server()},
                         {"self", session.station->self().name},
                         {"connected", session.station->connected()},
                         {"held", held},
                         {"lost", lost},
                         {"log", place && session.end_agent ? place->log.string() : ""}});
    return kDone;
}

/// Where the user is reached: the agent has no terminal.
std::string prepareAgent(Json& args) {
    if (args.contains("notify")) args["notify"] = reachableAt();
    return {};
}

int version(Session& session) {
    session.events.emit({{"event", "version"}, {"version", kRelease}});
    return kDone;
}

}  // namespace

extern const Verb kProfile{"profile",
                           "Check profiles (XML) before a robot uses them",
                           "  axon profile check basic.xml services.xml\n"
                           "Each finding says file:line, what was expected and how to fix it. With warnings "
                           "only, the exit status is 0.\n",
                           Runs::Local,
                           {{"action", Takes::Choice, true, false, "check", {"check"}},
                            {"files", Takes::File, true, true, "Profiles"}},
                           {},
                           profile};

extern const Verb kAgent{
    "agent",
    "Show, set or end the agent, the process that keeps your check-outs between commands",
    "  axon agent\n"
    "  axon agent --notify      tell me here at once when somebody asks for what I hold\n"
    "  axon agent --idle 600    release everything when no command and no task has used it for 600 s\n"
    "  axon agent stop          release everything and end the agent\n"
    "--notify writes a line to this terminal, with the bell, and shows a notification where notify-send and "
    "a\n"
    "desktop are. Unless --idle says otherwise, the agent releases everything after an hour without use. It "
    "warns\n"
    "five minutes before, in its log and where --notify says.\n",
    Runs::Kept,
    {{"action",
      Takes::Choice,
      false,
      false,
      "status (default) or stop (run is what axon checkout uses)",
      {"status", "stop", "run"}}},
    {{"notify", Takes::Nothing, "Tell this terminal and desktop at once when somebody asks for an entity"},
     {"idle", Takes::Duration, "Release everything after this long without use; 0 = never"}},
    agent,
    prepareAgent};

extern const Verb kVersion{"version", "Show the version", "  axon version --json\n", Runs::Local, {}, {},
                           version};

}  // namespace axon::cli
