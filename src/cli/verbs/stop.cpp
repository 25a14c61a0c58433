// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>

#include "cli/holding.hpp"
#include "cli/words.hpp"
#include "messages/text.hpp"

// axon stop, rearm, reset, clear
namespace axon::cli {

StopTimes stopTimes(const Json& args) {
    const Seconds deadline(args.value("deadline", 1.0));
    if (args.value("no-wait", false)) return {deadline, Seconds(0)};
    return {deadline, args.contains("deadline") ? deadline : kStandstillWait};
}

int stopAndShow(Session& session, const std::vector<std::string>& names, StopTimes times,
                const std::vector<Json>& errors) {
    const auto receipts = session.station->stop(names, times.deadline, times.standstill);
    if (!receipts) {
        for (const auto& error : errors) session.events.emit(error);
        return refuse(session, receipts.refusal());
    }
    const auto all = session.station->entities();
    auto list = Json::array();
    bool confirmed = !receipts->empty();
    for (const auto& receipt : receipts.value()) {
        auto json = toJson(receipt);
        const auto entity =
            std::find_if(all.begin(), all.end(), [&](const Entity& e) { return e.id == receipt.entity; });
        json["call"] = entity == all.end() ? receipt.name : callName(*entity, all);
        list.push_back(std::move(json));
        confirmed = confirmed && receipt.confirmed();
    }
    session.events.emit({{"event", "receipts"}, {"confirmed", confirmed}, {"receipts", list}});
    if (list.empty()) {
        session.events.emit(
            {{"event", "notice"}, {"message", "there is nothing to stop: no entity is known"}});
    }
    for (const auto& error : errors) session.events.emit(error);
    if (!confirmed) return kNotConfirmed;
    return errors.empty() ? kDone : kRefused;
}

namespace {

int stop(Session& session) {
    std::vector<std::string> names;
    std::vector<Json> errors;
    if (!session.args.value("all", false)) {
        // A word that means nothing here must not hide the receipts of the others; what a word that means
        // several stops, the library knows best.
        for (const auto& name : session.args.value("entity", std::vector<std::string>{})) {
            const auto found = session.station->find(name);
            if (!found && found.refusal().code == RefusalCode::UnknownEntity) {
                errors.push_back(errorEvent(found.refusal(), name));
            } else {
                names.push_back(name);
            }
        }
        if (names.empty() && !errors.empty()) {
            for (const auto& error : errors) session.events.emit(error);
            session.events.emit(
                {{"event", "notice"}, {"message", "nothing was stopped; axon stop --all stops everything"}});
            return kRefused;
        }
    }
    return stopAndShow(session, names, stopTimes(session.args), errors);
}

int rearmOne(Session& session, const std::string& name) {
    const auto found = session.station->find(name);
    if (!found) return refuse(session, found.refusal(), name);
    auto done = session.station->rearm(found->id);
    if (!done && done.refusal().code == RefusalCode::NotHolder && found->holder.id.empty()) {
        // An operator has to hold it: for this moment, so that nobody else decides about it meanwhile.
        int exit = kDone;
        const auto holding = Holding::of(session, name, "rearm", exit);
        if (!holding) return exit;
        done = session.station->rearm(found->id);
    }
    if (!done) return refuse(session, done.refusal(), name);
    session.events.emit({{"event", "done"}, {"verb", "rearm"}, {"entity", callOf(session, found.value())}});
    return kDone;
}

int rearm(Session& session) {
    int exit = kDone;
    for (const auto& name : session.args.at("entity").get<std::vector<std::string>>())
        if (const int its = rearmOne(session, name); its != kDone) exit = its;
    return exit;
}

int command(Session& session, const char* verb, Result<Receipt> (Station::*give)(const std::string&)) {
    const auto name = session.args.at("entity").get<std::string>();
    const auto found = findHeld(session, name);
    if (!found) return refuse(session, found.refusal(), name);
    const auto done = ((*session.station).*give)(found->id);
    if (!done) return refuse(session, done.refusal(), name);
    session.events.emit({{"event", "done"},
                         {"verb", verb},
                         {"entity", callOf(session, found.value())},
                         {"confirmed", done->confirmed()},
                         {"tasks_ended", done->tasks_ended},
                         {"tasks_removed", done->tasks_removed}});
    return done->confirmed() ? kDone : kNotConfirmed;
}

int reset(Session& session) {
    return command(session, "reset", &Station::reset);
}
int clear(Session& session) {
    return command(session, "clear", &Station::clear);
}

}  // namespace

extern const Verb kStop{
    "stop",
    "Stop entities immediately, whoever holds them; without a name, all of them",
    "  axon stop PeopleBot      also when somebody else holds it\n"
    "  axon stop --all          the whole laboratory (so does axon stop alone)\n"
    "Prints the receipt: when the server, the Entity Manager and the robot's stop callback had the stop,\n"
    "and when the application reported that the robot stands still. A stop is confirmed when the callback\n"
    "has returned. The exit status is 0 only if every stop is confirmed, otherwise 4. If a robot was moving\n"
    "and its application reports standstill, the command waits for that too: 5 seconds, or as long as\n"
    "--deadline says; with --no-wait it does not. An application that hangs or has died cannot confirm:\n"
    "look at the robot then. A stopped entity refuses tasks until axon rearm. This is a control-system\n"
    "stop, not an emergency stop.\n",
    Runs::Anywhere,
    {{"entity", Takes::Entity, false, true, "Entities to stop; a name that several share stops all of them"}},
    {{"all", Takes::Nothing, "All entities"},
     {"deadline", Takes::Duration, "How long to wait for the receipts (default 1; 5 for the standstill)"},
     {"no-wait", Takes::Nothing, "Do not wait for the standstill of robots that were moving"}},
    stop};

extern const Verb kRearm{"rearm",
                         "Let a stopped entity take tasks again; nothing starts by itself",
                         "  axon rearm PeopleBot\n"
                         "Its holder and administrators may do that. An entity that nobody holds is checked\n"
                         "out for this moment, if you do not hold it.\n",
                         Runs::Anywhere,
                         {{"entity", Takes::Entity, true, true, "Entities to rearm"}},
                         {},
                         rearm};

extern const Verb kReset{
    "reset",
    "End the running task and start the next waiting one",
    "  axon reset PeopleBot\n"
    "Unlike axon stop, this does not latch the entity. It is refused (WRONG_STATE) while the entity takes\n"
    "part in a global service and runs no step of it. The exit status is 4 if the robot does not confirm.\n",
    Runs::Kept,
    {{"entity", Takes::Entity, true, false, "The entity"}},
    {},
    reset};

extern const Verb kClear{
    "clear",
    "End the running task and remove the waiting ones",
    "  axon clear PeopleBot\n"
    "Unlike axon stop, this does not latch the entity. A run of a global service in which the entity takes\n"
    "part ends. The exit status is 4 if the robot does not confirm.\n",
    Runs::Kept,
    {{"entity", Takes::Entity, true, false, "The entity"}},
    {},
    clear};

}  // namespace axon::cli
