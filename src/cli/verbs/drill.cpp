// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>
#include <map>

#include "cli/distribution.hpp"
#include "cli/holding.hpp"
#include "cli/words.hpp"
#include "common/rate_limit.hpp"

// axon drill
namespace axon::cli {
namespace {

using Clock = std::chrono::steady_clock;

struct Drilled {
    std::string name;
    Distribution manager, callback;
    std::size_t tries = 0;
    bool no_application = false;
};

void add(std::map<std::string, Drilled>& all, const std::vector<DrillReport>& reports) {
    for (const auto& report : reports) {
        auto& one = all[report.entity];
        one.name = report.name;
        one.tries += report.manager.size();
        one.no_application = report.no_application;
        for (const auto& time : report.manager) one.manager.add(time);
        // Where there is no application there is nothing that could arrive.
        if (report.no_application) continue;
        for (const auto& time : report.callback) one.callback.add(time);
    }
}

int drill(Session& session) {
    const auto names = session.args.value("entity", std::vector<std::string>{});
    if (names.empty() != session.args.value("all", false)) {
        return misused(session,
                       names.empty() ? "expected entities or --all, found neither"
                                     : "expected entities or --all, found both",
                       "axon drill PeopleBot, or axon drill --all");
    }
    for (const auto& name : names) {
        if (const auto found = session.station->find(name); !found)
            return refuse(session, found.refusal(), name);
    }
    const auto count = session.args.value("count", 20);
    // Without --every as many tries as a client may make, and a tenth fewer.
    const auto drilled = names.empty() ? session.station->entities(Listed::All).size() : 0;
    const double fastest = 1.1 * static_cast<double>(drilled) / kDrillsPerSecond;
    const auto every = std::chrono::duration_cast<Clock::duration>(
        Seconds(session.args.value("every", std::max(0.1, fastest))));
    std::map<std::string, Drilled> all;
    bool interrupted = false;
    Refusal refused;
    for (int i = 0; i < count && !interrupted; ++i) {
        const auto next = Clock::now() + every;
        const auto reports = session.station->drill(names);
        if (!reports) {
            refused = reports.refusal();
            break;
        }
        add(all, reports.value());
        session.events.emit({{"event", "drilling"}, {"done", i + 1}, {"count", count}});
        if (reports.value().empty()) break;
        // A try may take longer than the time between two of them.
        interrupted = session.mailbox->takeInterrupt();
        while (!interrupted && i + 1 < count && Clock::now() < next) {
            if (const auto event = session.mailbox->wait(next)) session.events.emit(*event);
            interrupted = session.mailbox->takeInterrupt();
        }
    }
    const auto entities = session.station->entities();
    bool arrived = !all.empty();
    for (const auto& [id, one] : all) {
        const auto entity = std::find_if(entities.begin(), entities.end(),
                                         [&id = id](const Entity& e) { return e.id == id; });
        session.events.emit({{"event", "drill"},
                             {"id", id},
                             {"entity", entity == entities.end() ? one.name : callName(*entity, entities)},
                             {"tries", one.tries},
                             {"no_application", one.no_application},
                             {"manager", one.manager.toJson()},
                             {"callback", one.callback.toJson()}});
        arrived = arrived && one.manager.never() == 0 && one.callback.never() == 0;
    }
    if (!refused.ok()) return refuse(session, refused);  // after what there was until then
    if (all.empty()) session.events.emit({{"event", "notice"}, {"message", "there is no entity to drill"}});
    if (interrupted) return kInterrupted;
    return arrived ? kDone : kNotConfirmed;
}

}  // namespace

extern const Verb kDrill{
    "drill",
    "Measure how fast a stop is, without stopping anything",
    "  axon drill PeopleBot\n"
    "  axon drill --all --count 1000 --every 0.05\n"
    "  axon drill PeopleBot --json | jq 'select(.event == \"drill\") | .callback.p99_ms'\n"
    "Each try travels like a stop to the process of the robot application and back. The application itself\n"
    "is not called: nothing latches and no task ends. A try that does not come back within a second counts\n"
    "as never arrived, and as infinitely late. A percentile is shown if there are enough tries for it.\n"
    "The exit status is 4 if a try never arrived.\n",
    Runs::Anywhere,
    {{"entity", Takes::Entity, false, true, "Entities to drill, whoever holds them"}},
    {{"all", Takes::Nothing, "All entities"},
     {"count", Takes::Count, "Number of tries (default 20)"},
     {"every", Takes::Duration, "Time from one try to the next (default 0.1)"}},
    drill};

}  // namespace axon::cli
