// SPDX-License-Identifier: GPL-2.0-or-later
#include <cstdlib>

#include "cli/command_line.hpp"
#include "cli/holding.hpp"
#include "cli/manual.hpp"
#include "messages/text.hpp"

// axon help, axon __manual
namespace axon::cli {
namespace {

int help(Session& session) {
    auto words = session.args.value("verb", std::vector<std::string>{});
    std::string name;
    for (const auto& word : words) name += (name.empty() ? "" : " ") + word;
    if (!name.empty() && findVerb(name) == nullptr && findGroup(name) == nullptr) {
        std::vector<std::string_view> names;
        for (const auto* verb : verbs())
            if (!verb->hidden) names.emplace_back(verb->name);
        for (const auto& group : verbGroups()) names.emplace_back(group.name);
        const auto near = nearNames(name, names);
        return misused(
            session, "unknown verb " + inQuotes(name),
            near.empty() ? "axon help shows the verbs" : "did you mean " + alternatives(near) + "?");
    }
    words.emplace_back("--help");
    auto text = parseCommandLine(words, [](const char* variable) { return std::getenv(variable); }).out;
    while (text.ends_with('\n')) text.pop_back();
    session.events.emit({{"event", "line"}, {"text", text}});
    return kDone;
}

int manual(Session& session) {
    const auto written = writeManual(session.args.at("folder").get<std::string>());
    return written ? static_cast<int>(kDone) : misused(session, written.refusal().message, {});
}

}  // namespace

extern const Verb kHelp{"help",
                        "Show the verbs, or the help of one verb",
                        "  axon help\n"
                        "  axon help run             the same as axon run --help\n"
                        "  axon help global run\n"
                        "  man axon-run              the manual page of a verb, if Axon is installed\n",
                        Runs::Local,
                        {{"verb", Takes::Verb, false, true, "The verb, such as run or global run"}},
                        {},
                        help};

extern const Verb kManual{"__manual",
                          "Write manual pages and completion scripts below a folder",
                          "",
                          Runs::Local,
                          {{"folder", Takes::File, true, false, "The folder, such as /usr/share"}},
                          {},
                          manual,
                          nullptr,
                          true};

}  // namespace axon::cli
