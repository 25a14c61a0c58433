// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/common_options.hpp"

#include <gmock/gmock.h>

#include <fstream>
#include <sstream>

#include "cli/command_line.hpp"
#include "cli/fake_station.hpp"

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;

namespace {

Parsed parse(const std::vector<std::string>& words) {
    return parseCommandLine(words, [](const char*) -> const char* { return nullptr; });
}

std::string offered(std::vector<std::string> words) {
    Recorded seen;
    const Settings settings;
    words.insert(words.begin(), std::to_string(words.size() - 1));
    Session session{{{"words", words}}, seen, std::make_shared<Mailbox>(), nullptr, settings};
    EXPECT_EQ(findVerb("__complete")->perform(session), kDone);
    return seen.events.empty() ? std::string() : seen.events.back()["text"].get<std::string>();
}

TEST(CommonOptions, EveryOneIsInTheHelpAndIsCompletedAndItsValueIsSkipped) {
    const auto help = parse({"--help"}).out;
    for (const auto& option : commonOptions()) {
        const auto name = std::string("--") + option.name;
        EXPECT_THAT(help,
                    HasSubstr("  " + name + (*option.placeholder != '\0' ? " " : "") + option.placeholder));
        EXPECT_EQ(offered({"axon", "ls", name}), name);
        std::vector<std::string> words{"axon", name};
        if (option.takes != Takes::Nothing) words.emplace_back("value");
        if (option.takes == Takes::File) {
            EXPECT_EQ(offered({"axon", "ls", name, ""}), "__files__");
        }
        words.insert(words.end(), {"agent", "s"});
        EXPECT_EQ(offered(words), "status\nstop") << name;
    }
}

TEST(CommonOptions, HelpNamesTheVariableAndTheDefault) {
    const auto help = parseCommandLine({"--help"}, [](const char* name) {
                          return std::string_view(name) == "AXON_SERVER" ? "lab:1" : nullptr;
                      }).out;
    EXPECT_THAT(help, HasSubstr("(AXON_SERVER; default lab:1)"));
    EXPECT_THAT(help, HasSubstr("(AXON_USER)"));
    EXPECT_THAT(help, HasSubstr("(default 5)"));
}

TEST(CommonOptions, AnAgentIsStartedWithTheSettingsOfTheCommand) {
    Settings settings;
    settings.server = "lab:1";
    settings.user = "client1";
    settings.name = "client1@lab";
    settings.timeout_s = 2.5;
    settings.direct = false;
    settings.json = true;
    settings.password = "secret1";
    settings.password_file = "/secret1";
    auto words = wordsForAgent(settings);
    EXPECT_THAT(words, testing::Not(testing::Contains(HasSubstr("secret1"))));
    words.insert(words.begin(), {"agent", "run"});
    const auto parsed = parse(words);
    ASSERT_TRUE(parsed.line) << parsed.err;
    EXPECT_EQ(parsed.line->settings.server, "lab:1");
    EXPECT_EQ(parsed.line->settings.user, "client1");
    EXPECT_EQ(parsed.line->settings.name, "client1@lab");
    EXPECT_EQ(parsed.line->settings.timeout_s, 2.5);
    EXPECT_FALSE(parsed.line->settings.direct);
    EXPECT_FALSE(parsed.line->settings.json) << "what it says on standard output is read by the command";
    settings.config = "/client.cfg";
    EXPECT_THAT(wordsForAgent(settings), testing::Contains("/client.cfg"));
}

/// docs/reference/command.md is written by hand; these lines of it are compared.
std::string reference() {
    std::stringstream page;
    page << std::ifstream("docs/reference/command.md", std::ios::binary).rdbuf();
    return page.str();
}

TEST(CommonOptions, TheReferenceHasARowForEach) {
    const auto page = reference();
    for (const auto& option : commonOptions()) {
        auto row = std::string("\n| `--") + option.name;
        if (*option.placeholder != '\0') row += std::string(" ") + option.placeholder;
        row += "` | ";
        if (*option.environment != '\0') row += std::string("`") + option.environment + "` ";
        EXPECT_THAT(page, HasSubstr(row + "|"));
    }
}

/// The rows of the tables below "## Verbs" that are about this one: their first cell names it.
std::string rowsOf(std::string page, const std::string& verb) {
    const auto chapter = page.find("\n## Verbs\n");
    page = chapter == std::string::npos ? ""
                                        : page.substr(chapter + 1, page.find("\n## ", chapter + 1) - chapter);
    const auto space = verb.find(' ');
    const auto group = verb.substr(0, space == std::string::npos ? 0 : space);
    const auto word = verb.substr(space == std::string::npos ? 0 : space + 1);
    std::istringstream lines(page);
    std::string rows;
    for (std::string line; std::getline(lines, line);) {
        if (line.rfind("| `", 0) != 0) continue;
        const auto cell = line.substr(0, line.find(" | "));
        const auto first = cell.substr(3, cell.find_first_of(" `", 3) - 3);
        const bool in_group = findGroup(first) != nullptr;
        const bool names = cell.find("`" + word + "`") != std::string::npos ||
                           cell.find("`" + word + " ") != std::string::npos ||
                           cell.find("`" + verb + "`") != std::string::npos ||
                           cell.find("`" + verb + " ") != std::string::npos;
        if (names && in_group == !group.empty()) rows += line + "\n";
    }
    return rows;
}

TEST(Reference, HasARowForEachVerbAndItsOptions) {
    const auto page = reference();
    for (const auto* verb : verbs()) {
        if (verb->hidden) continue;
        EXPECT_FALSE(rowsOf(page, verb->name).empty())
            << "docs/reference/command.md has no row for " << verb->name;
        for (const auto& option : verb->options)
            EXPECT_THAT(page, testing::ContainsRegex(std::string("--") + option.name + "[^a-z-]"))
                << "of " << verb->name;
    }
}

TEST(Reference, HasARowForEachExitStatus) {
    const auto page = reference();
    for (const int status : {kDone, kRefused, kUsage, kNoServer, kNotConfirmed, kStopped, kInterrupted})
        EXPECT_THAT(page, HasSubstr("\n| " + std::to_string(status) + " | "));
}

}  // namespace
