// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>

#include "cli/verbs/holding.hpp"
#include "cli/words.hpp"

// axon checkout, axon release
namespace axon::cli {
namespace {

int checkout(Session& session) {
    std::vector<std::string> ids;
    auto entities = Json::array();
    auto already = Json::array();
    const auto held = session.station->held();
    for (const auto& word : session.args.at("entity")) {
        const auto name = word.get<std::string>();
        const auto found = session.station->find(name);
        if (!found) return refuse(session, found.refusal(), name);
        const Json item{{"id", found->id}, {"name", found->name}, {"call", callOf(session, found.value())}};
        if (std::any_of(held.begin(), held.end(), [&](const Entity& e) { return e.id == found->id; })) {
            already.push_back(item);
        } else if (std::find(ids.begin(), ids.end(), found->id) == ids.end()) {
            ids.push_back(found->id);
            entities.push_back(item);
        }
    }
    if (!ids.empty()) {
        const auto granted = session.station->checkOut(ids);
        if (!granted) {
            return refuse(session, granted.refusal(),
                          ids.size() == 1 ? entities[0]["call"].get<std::string>() : "");
        }
    }
    session.events.emit(
        {{"event", "checked_out"}, {"entities", entities}, {"already", already}, {"kept", session.kept}});
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
    if (wanted.empty() && exit == kDone) {
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
    "  axon checkout PeopleBot -- ./experiment   held while the command runs;\n"
    "                                            its axon commands use this check-out\n",
    Runs::Keeper,
    {{"entity", Takes::Entity, true, true, "What to check out"}},
    {},
    checkout};

extern const Verb kRelease{"release",
                           "Give back what axon checkout holds; a moving robot is stopped first",
                           "  axon release PeopleBot\n"
                           "  axon release                     everything that is held here\n",
                           Runs::Kept,
                           {{"entity", Takes::Entity, false, true, "What to release; none = everything"}},
                           {{"all", Takes::Nothing, "Everything that is held here (as without a name)"}},
                           release};

}  // namespace axon::cli
