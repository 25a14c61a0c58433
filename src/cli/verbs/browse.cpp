// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <tuple>

#include "cli/arguments.hpp"
#include "cli/heard_streams.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"

// axon ls, axon info
namespace axon::cli {
namespace {

bool isHeld(const std::vector<Entity>& held, const Entity& entity) {
    return std::any_of(held.begin(), held.end(), [&](const Entity& other) { return other.id == entity.id; });
}

int ls(Session& session) {
    auto all = session.station->entities(Listed::All);
    const bool listed_all = session.args.value("all", false);
    const auto held = session.station->held();
    std::sort(all.begin(), all.end(), [](const Entity& a, const Entity& b) {
        return std::tie(a.name, a.id) < std::tie(b.name, b.id);
    });
    auto list = Json::array();
    int hidden = 0;
    for (const auto& entity : all) {
        if (!entity.ready && !listed_all) {
            ++hidden;
            continue;
        }
        auto json = toJson(entity, isHeld(held, entity));
        json["call"] = callName(entity, all);
        json["direct"] = session.station->direct(entity.id);
        list.push_back(std::move(json));
    }
    session.events.emit({{"event", "entities"},
                         {"server", session.station->server()},
                         {"self", session.station->self().name},
                         {"uuid", session.args.value("uuid", false)},
                         {"not_ready", hidden},
                         {"entities", std::move(list)}});
    return kDone;
}

int info(Session& session) {
    const auto name = session.args.at("entity").get<std::string>();
    const auto entity = session.station->find(name);
    if (!entity) return refuse(session, entity.refusal(), name);
    Json json{{"event", "entity"},
              {"entity", toJson(entity.value(), isHeld(session.station->held(), entity.value()))}};
    json["entity"]["call"] = callName(entity.value(), session.station->entities(Listed::All));
    json["entity"]["direct"] = session.station->direct(entity->id);
    const auto details = session.station->details(entity->id);
    auto list = Json::array();
    auto margins = Json::array();
    auto findings = Json::array();
    if (details) {
        for (const auto& finding : details->findings)
            findings.push_back({{"message", finding.message}, {"fix", finding.fix}});
        for (const auto& margin : details->watchdogs) {
            margins.push_back({{"hop", margin.hop},
                               {"timeout_ms", margin.timeout.count() * 1000},
                               {"longest_gap_ms", margin.longest_gap.count() * 1000}});
        }
        if (const auto wanted = session.args.value("service", ""); !wanted.empty()) {
            const auto one = findService(details->services, wanted);
            if (!one) return refuse(session, one.refusal(), name);
            list.push_back(toJson(*one.value()));
        } else {
            for (const auto& service : details->services) list.push_back(toJson(service));
        }
    }
    json["streams"] = details && entity->ready && !session.args.contains("service") &&
                              !session.args.value("no-streams", false)
                          ? streamsOf(session, entity->id)
                          : Json::array();
    json["services"] = std::move(list);
    json["watchdogs"] = std::move(margins);
    json["findings"] = std::move(findings);
    session.events.emit(json);
    return details ? static_cast<int>(kDone) : refuse(session, details.refusal(), name);
}

}  // namespace

extern const Verb kLs{
    "ls",
    "List the entities: state, holder, latch",
    "  axon ls\n"
    "  axon ls --all                    also those without application or valid profiles, and why\n"
    "  axon ls --json | jq -r '.entities[] | select(.holder == \"\") | .name'\n",
    Runs::Anywhere,
    {},
    {{"all", Takes::Nothing, "Also list entities that are not ready: without application or valid profiles"},
     {"uuid", Takes::Nothing, "Show the UUIDs, which tell entities of the same name apart"}},
    ls};

extern const Verb kInfo{"info",
                        "Show an entity, its services and what they take, and its streams",
                        "  axon info PeopleBot\n"
                        "  axon info PeopleBot Driving      one service only\n"
                        "The streams are those that send a sample within 0.25 s.\n",
                        Runs::Anywhere,
                        {{"entity", Takes::Entity, true, false, "Name, NAME#2, or the beginning of a UUID"},
                         {"service", Takes::Service, false, false, "Show this service only"}},
                        {{"no-streams", Takes::Nothing, "Do not listen for streams"}},
                        info};

}  // namespace axon::cli
