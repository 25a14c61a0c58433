// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/verbs/global.hpp"

#include <algorithm>
#include <set>

#include "cli/arguments.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"

// axon global ls, info, stop, pause, resume, cancel, history
namespace axon::cli {

Result<GlobalService> findGlobal(Session& session, const std::string& name) {
    const auto offered = session.station->globalServices();
    if (!offered) return offered.refusal();
    const auto found = findGlobalService(offered->services, name);
    if (found) return *found.value();
    auto refusal = found.refusal();
    std::string bad;
    for (const auto& file : offered->files) {
        if (file.bad) bad += (bad.empty() ? "" : ", ") + file.name;
    }
    if (!bad.empty()) refusal.message += ". The services in " + bad + " are not offered, because of errors";
    return refusal;
}

int refuseGlobal(Session& session, const Refusal& refusal) {
    auto event = errorEvent(refusal);
    switch (refusal.code) {
        case RefusalCode::UnknownService:
            event["fix"] =
                "axon global ls shows the services and the errors in their files; axon global info SERVICE "
                "shows which robots can play its roles";
            break;
        case RefusalCode::UnknownTask:
            event["fix"] =
                session.kept ? "a run that was started a moment ago may not have begun yet; axon global "
                               "history shows the runs"
                             : "Ctrl-C where axon global run is running cancels the run; to reach a run from "
                               "another command, check its robots out first: axon checkout";
            break;
        case RefusalCode::NotSupported:
            event["fix"] = "the server, or a robot's Entity Manager, is older than this command: update it";
            break;
        default:
            break;
    }
    session.events.emit(event);
    return exitOf(refusal);
}

ServicesOfSteps::ServicesOfSteps(const std::shared_ptr<Station>& station,
                                 const std::vector<std::string>& entities) {
    for (const auto& entity : entities) {
        if (services_.count(entity) != 0) continue;
        const auto found = station->services(entity);
        services_[entity] = found ? found.value() : std::vector<Service>{};
    }
}

void ServicesOfSteps::describe(Json& step) const {
    step["units"] = Json::object();
    step["live"] = Json::array();
    const auto entity = services_.find(step.value("entity_id", ""));
    if (entity == services_.end()) return;
    const auto service = findService(entity->second, step.value("service", ""));
    if (!service) return;
    step["units"] = unitsOf(*service.value());
    step["live"] = feedbackOf(*service.value());
}

Json toJson(const client::Proposal& proposal) {
    auto roles = Json::array();
    for (const auto& outlook : proposal.roles) {
        auto unfit = Json::array();
        for (const auto& one : outlook.unfit) {
            unfit.push_back({{"entity", one.name},
                             {"entity_id", one.entity},
                             {"code", refusalName(one.why.code)},
                             {"why", one.why.message}});
        }
        roles.push_back({{"role", outlook.role},
                         {"wanted", outlook.wanted},
                         {"able", outlook.able},
                         {"unfit", std::move(unfit)},
                         {"entity", outlook.entity.empty() ? Json(nullptr) : Json(outlook.name)},
                         {"entity_id", outlook.entity.empty() ? Json(nullptr) : Json(outlook.entity)}});
    }
    return roles;
}

namespace {

int ls(Session& session) {
    const auto offered = session.station->globalServices();
    if (!offered) return refuseGlobal(session, offered.refusal());
    auto services = Json::array();
    for (const auto& service : offered->services) services.push_back(toJson(service));
    auto files = Json::array();
    for (const auto& file : offered->files)
        files.push_back({{"name", file.name}, {"bad", file.bad}, {"findings", file.findings}});
    session.events.emit({{"event", "global_services"},
                         {"server", session.station->server()},
                         {"services", std::move(services)},
                         {"files", std::move(files)}});
    return kDone;
}

int info(Session& session) {
    const auto service = findGlobal(session, session.args.at("name").get<std::string>());
    if (!service) return refuseGlobal(session, service.refusal());
    const auto proposal = session.station->propose(service.value(), {});
    if (!proposal) return refuseGlobal(session, proposal.refusal());
    session.events.emit({{"event", "global_service"},
                         {"service", toJson(service.value())},
                         {"roles", toJson(proposal.value())},
                         {"nobody_offers", proposal->nobody_offers},
                         {"possible", proposal->complete()},
                         {"why", proposal->why.message}});
    return kDone;
}

bool isMeant(const std::string& word, const std::string& id, const std::string& service) {
    return id.compare(0, word.size(), word) == 0 || sameToAPerson(service, word);
}

/// The run that was begun here and is meant: by the beginning of its id, by its service, or the only one.
Result<RunReport> findRun(Session& session, const std::string& word) {
    std::vector<RunReport> open;
    std::vector<RunReport> over;
    for (auto& run : session.station->runs()) {
        if (run.check || (!word.empty() && !isMeant(word, run.id, run.service))) continue;
        (client::isFinal(run.state) ? over : open).push_back(std::move(run));
    }
    if (open.size() == 1) return open.front();
    if (open.empty()) {
        return Refusal{
            RefusalCode::UnknownTask,
            !over.empty() ? over.back().service + " has already ended: " + client::toString(over.back().state)
            : session.kept ? "no such run was started here"
                           : "no run was started here: only a run under axon checkout can be reached "
                             "from another command",
            {}};
    }
    std::string list;
    for (const auto& run : open) list += "\n  " + run.id + "  " + run.service;
    return Refusal{
        RefusalCode::UnknownTask, "several runs match; name one by the beginning of its id:" + list, {}};
}

int control(Session& session, TaskAction action, const char* verb) {
    const auto run = findRun(session, session.args.value("run", ""));
    if (!run) return refuseGlobal(session, run.refusal());
    if (const auto done = session.station->controlRun(run->id, action); !done)
        return refuseGlobal(session, done.refusal());
    session.events.emit({{"event", "done"}, {"verb", verb}, {"service", run->service}, {"run", run->id}});
    return kDone;
}

int pauseRun(Session& session) {
    return control(session, TaskAction::Pause, "pause");
}
int resumeRun(Session& session) {
    return control(session, TaskAction::Resume, "resume");
}
int cancelRun(Session& session) {
    return control(session, TaskAction::Cancel, "cancel");
}

using Ids = std::set<std::string>;

/// It takes part in a run, or may: while it carries out a step a participant is BUSY as with any other task.
bool mayTakePart(const Entity& entity) {
    return availability(entity.state) == Availability::Working;
}

/// Who takes part in the runs of others that are meant, as their masters say. One that does not say may be
/// the master, and stops the others with itself.
Ids askWhoTakesPart(Session& session, const std::string& word) {
    Ids meant;
    const auto history = session.station->runHistory(0);
    const auto all = session.station->entities();
    if (history) {
        for (const auto& run : history->runs) {
            if (client::isFinal(run.state) || !isMeant(word, run.id, run.service.name)) continue;
            for (const auto& one : run.participants) meant.insert(one.entity);
        }
    }
    for (const auto& entity : all) {
        const bool silent =
            !history || std::any_of(history->silent.begin(), history->silent.end(), [&](const auto& one) {
                return one.first == entity.name || one.first == entity.id ||
                       one.first == callName(entity, all);
            });
        if (silent && mayTakePart(entity)) meant.insert(entity.id);
    }
    return meant;
}

int stopThose(Session& session, const Ids& meant) {
    const auto all = session.station->entities();
    std::string names;
    for (const auto& id : meant) {
        const auto known =
            std::find_if(all.begin(), all.end(), [&](const Entity& entity) { return entity.id == id; });
        names += (names.empty() ? "" : ", ") + (known == all.end() ? id : callName(*known, all));
    }
    const auto exit = stopAndShow(session, {meant.begin(), meant.end()}, stopTimes(session.args));
    session.events.emit({{"event", "notice"}, {"message", "a stop was sent to " + names}});
    return exit;
}

/// What is known here is stopped before anybody is asked, and in doubt it is meant.
int stop(Session& session) {
    const auto word = session.args.value("run", "");
    Ids meant;
    bool alone = false;  // nobody else's run can be meant
    for (const auto& run : session.station->runs()) {
        if (client::isFinal(run.state) || run.check) continue;
        if (!word.empty() && !isMeant(word, run.id, run.service)) continue;
        alone = alone || !sameToAPerson(run.service, word);
        for (const auto& step : run.steps) meant.insert(step.entity);
    }
    if (word.empty()) {
        for (const auto& entity : session.station->entities())
            if (mayTakePart(entity)) meant.insert(entity.id);
    }
    int exit = meant.empty() ? kDone : stopThose(session, meant);
    if (!word.empty() && !alone) {
        Ids others;
        for (const auto& id : askWhoTakesPart(session, word))
            if (!meant.contains(id)) others.insert(id);
        if (!others.empty()) exit = std::max(exit, stopThose(session, others));
        meant.merge(others);
    }
    if (!meant.empty()) return exit;
    session.events.emit(
        {{"event", "notice"},
         {"message", std::string(word.empty() ? "no robot is working now" : "no such run is in progress") +
                         "; nothing was stopped. axon stop --all stops everything"}});
    return kNotConfirmed;
}

int history(Session& session) {
    const auto word = session.args.value("run", "");
    const auto known = session.station->runHistory(session.args.value("most", 0));
    if (!known) return refuseGlobal(session, known.refusal());
    auto silent = Json::array();
    for (const auto& [name, why] : known->silent)
        silent.push_back({{"entity", name}, {"code", refusalName(why.code)}, {"message", why.message}});
    if (word.empty()) {
        auto runs = Json::array();
        for (const auto& run : known->runs) runs.push_back(toJson(run, false));
        session.events.emit({{"event", "runs"}, {"runs", std::move(runs)}, {"silent", std::move(silent)}});
        return kDone;
    }
    std::vector<const RunRecord*> found;
    for (const auto& run : known->runs) {
        if (run.id.compare(0, word.size(), word) == 0) found.push_back(&run);
    }
    if (found.size() == 1) {
        auto record = toJson(*found.front(), true);
        std::vector<std::string> present;  // only they are asked: nobody waits for one that has left
        const auto all = session.station->entities();
        for (const auto& one : found.front()->participants) {
            if (std::any_of(all.begin(), all.end(),
                            [&](const Entity& entity) { return entity.id == one.entity; }))
                present.push_back(one.entity);
        }
        const ServicesOfSteps services(session.station, present);
        for (auto& step : record["steps"]) services.describe(step);
        session.events.emit(record);
        return kDone;
    }
    std::string list;
    for (const auto* run : found) list += "\n  " + run->id + "  " + run->service.name;
    return refuseGlobal(session,
                        {RefusalCode::UnknownTask,
                         found.empty() ? "no run that is remembered has an id that begins with " + word
                                       : "several runs match; write more of the id:" + list,
                         {}});
}

std::vector<Operand> runOperand() {
    return {{"run", Takes::GlobalService, false, false,
             "Its service, or the beginning of its id; without one, the only run"}};
}

}  // namespace

extern const Verb kGlobalLs{"global ls",
                            "List the global services of the server, and the errors in their files",
                            "  axon global ls\n"
                            "  axon global ls --json | jq -r '.files[].findings[]'\n"
                            "The server reads the files of its folder again when they change.\n",
                            Runs::Anywhere,
                            {},
                            {},
                            ls};

extern const Verb kGlobalInfo{
    "global info",
    "Show the steps of a global service, and which robots can play its roles",
    "  axon global info 'Fetch ball'\n"
    "Asks every entity for its services. Says why a robot cannot play a role, and which services no entity\n"
    "offers.\n",
    Runs::Anywhere,
    {{"name", Takes::GlobalService, true, false, "Name of the global service"}},
    {},
    info};

extern const Verb kGlobalStop{
    "global stop",
    "Immediately stop every robot that takes part in a run",
    "  axon global stop                every robot that takes part in a run now or may: all that are "
    "COLLAB,\n"
    "                                  SLAVE or BUSY, since a robot that carries out a step is BUSY\n"
    "  axon global stop 'Fetch ball'   every robot that takes part in it, whoever started it\n"
    "  axon global stop 3f2a           every robot of the run whose id begins with 3f2a\n"
    "With a name, the robots that are known here are stopped first. Then the masters are asked who takes\n"
    "part; a master that is working and does not answer is stopped too. As with axon stop, receipts are\n"
    "printed, the exit status is 0 only if all are confirmed, and the robots refuse tasks until axon rearm.\n"
    "axon global cancel ends a run without latching the robots.\n",
    Runs::Anywhere,
    {{"run", Takes::GlobalService, false, false,
      "The service, or the beginning of the run's id; without one, all robots that are working"}},
    {{"deadline", Takes::Duration, "How long to wait for the receipts (default 1; 5 for the standstill)"},
     {"no-wait", Takes::Nothing, "Do not wait for the standstill of robots that were moving"}},
    stop};

extern const Verb kGlobalPause{"global pause",
                               "Pause a run; every running step must be pausable",
                               "  axon global pause\n"
                               "  axon global pause 'Fetch ball'\n"
                               "It reaches only runs that were started under axon checkout.\n",
                               Runs::Anywhere,
                               runOperand(),
                               {},
                               pauseRun};
extern const Verb kGlobalResume{"global resume",
                                "Continue a paused run; a run that is held tries its failed steps again",
                                "  axon global resume\n"
                                "It reaches only runs that were started under axon checkout.\n",
                                Runs::Anywhere,
                                runOperand(),
                                {},
                                resumeRun};
extern const Verb kGlobalCancel{"global cancel",
                                "Cancel a run, without latching the robots",
                                "  axon global cancel\n"
                                "It reaches only runs that were started under axon checkout.\n",
                                Runs::Anywhere,
                                runOperand(),
                                {},
                                cancelRun};

extern const Verb kGlobalHistory{
    "global history",
    "Show the runs that the robots here remember, newest first",
    "  axon global history\n"
    "  axon global history 3f2a     one run with its steps, parameters, results and times\n"
    "  axon global history --json | jq '.runs[] | select(.state != \"SUCCEEDED\")'\n"
    "Each robot keeps the last runs whose master it was.\n",
    Runs::Anywhere,
    {{"run", Takes::Run, false, false, "Beginning of a run's id: shows its steps"}},
    {{"most", Takes::Count, "At most this many of each robot (default: all that it keeps)"}},
    history};

}  // namespace axon::cli
