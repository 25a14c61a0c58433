// SPDX-License-Identifier: GPL-2.0-or-later
#include <cstdlib>

#include "cli/holding.hpp"
#include "cli/words.hpp"

// axon watch
namespace axon::cli {
namespace {

/// What was measured, without what the event says itself.
Json sampleEvent(const std::string& entity, const Sample& sample) {
    Json event{
        {"event", "sample"}, {"entity", entity}, {"stream", sample.stream}, {"sequence", sample.sequence}};
    auto content = Json::parse(sample.json, nullptr, false);
    if (content.is_discarded()) content = sample.json;
    if (content.is_object()) {
        // Protobuf's JSON writes 64-bit integers as texts.
        if (const auto taken = content.value("taken_at_us", ""); !taken.empty() && taken.size() < 19) {
            event["taken_at_us"] = std::strtoll(taken.c_str(), nullptr, 10);
        }
        for (const auto* known : {"stream", "sequence", "taken_at_us"}) content.erase(known);
    }
    event["sample"] = std::move(content);
    return event;
}

int watch(Session& session) {
    const auto name = session.args.at("entity").get<std::string>();
    const auto found = session.station->find(name);
    if (!found) return refuse(session, found.refusal(), name);
    const auto listening = listenTo(session, found.value());
    const auto mailbox = session.mailbox;
    const auto call = callOf(session, found.value());
    const auto watching = session.station->watch(
        found->id, session.args.value("streams", std::vector<std::string>{}),
        [mailbox, call](const Sample& sample) { mailbox->post(sampleEvent(call, sample), true); });
    if (!watching) return refuse(session, watching.refusal(), name);
    session.events.emit({{"event", "watching"}, {"entity", call}});

    std::optional<std::chrono::steady_clock::time_point> end;
    if (session.args.contains("for")) {
        end = std::chrono::steady_clock::now() +
              std::chrono::duration_cast<std::chrono::steady_clock::duration>(
                  Seconds(session.args.at("for").get<double>()));
    }
    bool any = false;
    while (const auto event = session.mailbox->wait(end)) {
        session.events.emit(*event);
        any = true;
        if (const auto dropped = session.mailbox->takeDropped(); dropped > 0) {
            session.events.emit({{"event", "dropped"}, {"count", dropped}});
        }
        // A clock that is looked at only when nothing comes would never end a busy watch.
        if (end && std::chrono::steady_clock::now() >= *end) break;
    }
    if (session.mailbox->takeInterrupt()) return kInterrupted;
    if (!any) session.events.emit({{"event", "notice"}, {"message", "nothing was received from " + call}});
    return kDone;
}

}  // namespace

extern const Verb kWatch{
    "watch",
    "Show the streams of an entity, and its messages to the holder",
    "  axon watch PeopleBot                  all streams until Ctrl-C\n"
    "  axon watch PeopleBot pose --for 10\n"
    "  axon watch PeopleBot pose --json | jq -c .sample\n"
    "Texts and raw data go to the holder only: they are shown if axon checkout holds the entity.\n",
    Runs::Anywhere,
    {{"entity", Takes::Entity, true, false, "The entity"},
     {"streams", Takes::Stream, false, true, "Names of streams; without a name, all of them"}},
    {{"for", Takes::Duration, "End after this long"}},
    watch};

}  // namespace axon::cli
