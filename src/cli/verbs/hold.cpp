// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>

#include "cli/caretaker.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"

// axon checkout, axon handover, axon release
namespace axon::cli {
namespace {

int checkout(Session& session) {
    const bool notify = session.args.contains("notify");
    if (notify && !session.notify)
        return misused(session, "--notify is for the agent that axon checkout starts",
                       "not inside axon checkout … -- COMMAND");
    if (notify && refuseUnreachable(session, session.args.at("notify"))) return kUsage;
    const auto taken = takeOut(session);
    if (taken.exit != kDone) return taken.exit;
    if (notify) session.notify(session.args.at("notify"));
    session.events.emit({{"event", "checked_out"},
                         {"entities", taken.items},
                         {"already", taken.already},
                         {"kept", session.kept}});
    return kDone;
}

/// Where the user is reached: the agent has no terminal.
std::string prepareCheckout(Json& args) {
    if (args.contains("notify")) args["notify"] = reachableAt();
    return {};
}

int handover(Session& session) {
    const auto name = session.args.at("entity").get<std::string>();
    const auto found = findHeld(session, name);
    if (!found) return refuse(session, found.refusal(), name);
    const bool accept = session.args.at("answer") == "accept";
    const auto call = callOf(session, found.value());
    const auto done = session.station->answerHandOver(found->id, accept, session.args.value("reason", ""));
    if (!done) return refuse(session, done.refusal(), name);
    session.events.emit({{"event", "done"},
                         {"verb", "handover"},
                         {"entity", call},
                         {"answer", accept ? "accept" : "refuse"}});
    return kDone;
}

int release(Session& session) {
    std::vector<Entity> wanted;
    int exit = kDone;
    if (const auto names = session.args.value("entity", Json::array()); !names.empty()) {
        for (const auto& word : names) {
            const auto name = word.get<std::string>();
            auto found = findHeld(session, name);
            if (found) {
                wanted.push_back(found.value());
            } else {
                exit = refuse(session, found.refusal(), name);
            }
        }
    } else {
        wanted = session.station->held();
    }
    for (const auto& entity : wanted) {
        if (const auto done = session.station->release(entity.id); done) {
            session.events.emit(
                {{"event", "released"}, {"id", entity.id}, {"entity", callOf(session, entity)}});
        } else {
            exit = refuse(session, done.refusal(), callOf(session, entity));
        }
    }
    if (wanted.empty() && exit == kDone && !tellLost(session)) {
        session.events.emit({{"event", "notice"}, {"message", "nothing is checked out here"}});
    }
    return exit;
}

}  // namespace

extern const Verb kCheckout{
    "checkout",
    "Check out entities for yourself: all of them or none",
    "  axon checkout PeopleBot                   kept until axon release\n"
    "  axon checkout PeopleBot Cyton             both or neither\n"
    "  axon checkout --query '2 ROBOT/MOBILE + 1 ROBOT/STATIONARY with Gripping'\n"
    "                                            any that are free and ready\n"
    "  axon checkout PeopleBot --wait            wait in line and show the place; --wait=60: at most a "
    "minute\n"
    "  axon checkout PeopleBot --ask 'for a demonstration'\n"
    "                                            ask the holder, who answers with axon handover\n"
    "  axon checkout PeopleBot --force 'battery is low'\n"
    "                                            take it over (administrators): it is stopped first, and the "
    "holder is told\n"
    "  axon checkout PeopleBot -- ./experiment   held while the command runs;\n"
    "                                            its axon commands use this check-out\n",
    Runs::Keeper,
    {{"entity", Takes::Entity, false, true, "Entities to check out"}},
    {{"query", Takes::Text,
      "Instead of names: [COUNT] KIND [with SERVICE] + …; a kind is for example ROBOT/MOBILE"},
     {"wait", Takes::MaybeDuration, "Wait until it is free, at most this long (default a day)"},
     {"ask", Takes::Text, "Ask the holder to hand it over, for this reason"},
     {"force", Takes::Text, "Take it from its holder, for this reason (administrators only)"},
     {"hand-over",
      Takes::Choice,
      "If others ask for it: ask (you decide; no answer refuses), yield (no answer hands over) or refuse",
      {"ask", "yield", "refuse"}},
     {"notify", Takes::Nothing, "Tell this terminal and desktop at once when somebody asks for an entity"}},
    checkout,
    prepareCheckout};

extern const Verb kHandover{
    "handover",
    "Answer a request for an entity that you hold",
    "  axon handover PeopleBot accept\n"
    "  axon handover PeopleBot refuse --reason 'ten more minutes'\n"
    "Accepting stops the robot and ends your check-out. Open requests are shown by the axon commands that\n"
    "use your check-outs, and by axon agent status.\n",
    Runs::Kept,
    {{"entity", Takes::Entity, true, false, "The entity"},
     {"answer", Takes::Choice, true, false, "accept or refuse", {"accept", "refuse"}}},
    {{"reason", Takes::Text, "Text for the client that asks"}},
    handover};

extern const Verb kRelease{"release",
                           "Give back what axon checkout holds; a moving robot is stopped first",
                           "  axon release PeopleBot\n"
                           "  axon release                     everything that is held here\n",
                           Runs::Kept,
                           {{"entity", Takes::Entity, false, true,
                             "Entities to release; without a name, everything that is held here"}},
                           {{"all", Takes::Nothing, "Everything that is held here, as without a name"}},
                           release};

}  // namespace axon::cli
