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
using Lines = std::vector<std::string>;

/// The lines of the chapter under this heading.
Lines chapterOfReference(const std::string& heading) {
    std::ifstream page("docs/reference/command.md", std::ios::binary);
    Lines lines;
    bool inside = false;
    for (std::string line; std::getline(page, line);) {
        if (line.rfind("## ", 0) == 0) inside = line == heading;
        if (inside) lines.push_back(line);
    }
    return lines;
}

std::string joined(const Lines& lines) {
    std::string text = "\n";
    for (const auto& line : lines) text += line + "\n";
    return text;
}

TEST(CommonOptions, TheReferenceHasARowForEach) {
    const auto chapter = joined(chapterOfReference("## Options of every verb"));
    for (const auto& option : commonOptions()) {
        auto row = std::string("\n| `--") + option.name;
        if (*option.placeholder != '\0') row += std::string(" ") + option.placeholder;
        row += "` | ";
        if (*option.environment != '\0') row += std::string("`") + option.environment + "` ";
        EXPECT_THAT(chapter, HasSubstr(row + "|"));
    }
}

/// Whether the first cell of this row of a table names the verb.
bool isRowOf(const std::string& line, const std::string& verb) {
    if (line.rfind("| `", 0) != 0) return false;
    const auto space = verb.find(' ');
    const auto word = verb.substr(space == std::string::npos ? 0 : space + 1);
    const auto cell = line.substr(0, line.find(" | "));
    const auto first = cell.substr(3, cell.find_first_of(" `", 3) - 3);
    const auto names = [&cell](const std::string& name) {
        return cell.find("`" + name + "`") != std::string::npos ||
               cell.find("`" + name + " ") != std::string::npos;
    };
    const bool of_group = space != std::string::npos;
    return (findGroup(first) != nullptr) == of_group && (names(word) || names(verb));
}

/// Which lines of the chapter "Verbs" are about this verb: its rows, the items of lists that begin with its
/// name, and the table under "Options of" it.
std::vector<std::size_t> linesAbout(const std::string& verb, const Lines& chapter) {
    std::vector<std::size_t> about;
    bool item = false;
    bool table = false;
    for (std::size_t i = 0; i < chapter.size(); ++i) {
        const auto& line = chapter[i];
        const bool continues = line.rfind("  ", 0) == 0;
        if (!continues)
            item = line.rfind("* `" + verb + "`", 0) == 0 || line.rfind("* `" + verb + " ", 0) == 0;
        if (line == "Options of `" + verb + "`:")
            table = true;
        else if (!line.empty() && line.front() != '|')
            table = false;
        if (isRowOf(line, verb) || item || (table && line.rfind("| `--", 0) == 0)) about.push_back(i);
    }
    return about;
}

/// The options of this verb that the lines about it do not name; the verb itself if there are no such lines.
Lines missingOf(const Verb& verb, const Lines& chapter) {
    const auto about = linesAbout(verb.name, chapter);
    if (about.empty()) return {verb.name};
    std::string text;
    for (const auto line : about) text += chapter[line] + "\n";
    Lines missing;
    for (const auto& option : verb.options) {
        const auto name = std::string("--") + option.name;
        if (!testing::Value(text, testing::ContainsRegex(name + "[^a-z-]"))) missing.push_back(name);
    }
    return missing;
}

TEST(Reference, HasARowForEachVerbAndNamesItsOptionsThere) {
    const auto chapter = chapterOfReference("## Verbs");
    for (const auto* verb : verbs()) {
        if (verb->hidden) continue;
        EXPECT_THAT(missingOf(*verb, chapter), testing::IsEmpty())
            << "docs/reference/command.md does not say this of " << verb->name;
    }
}

TEST(Reference, AnOptionIsMissedWhereItsVerbIsDescribedWhateverElseThePageNames) {
    const auto chapter = chapterOfReference("## Verbs");
    for (const auto* verb : verbs()) {
        if (verb->hidden) continue;
        for (const auto& option : verb->options) {
            auto without = chapter;
            const auto name = std::string("--") + option.name;
            for (const auto line : linesAbout(verb->name, chapter)) {
                auto& text = without[line];
                for (auto at = text.find(name); at != std::string::npos; at = text.find(name))
                    text.replace(at, name.size(), "-+");
            }
            without.push_back("Elsewhere: `" + name + "`.");
            EXPECT_THAT(missingOf(*verb, without), testing::Contains(name)) << verb->name;
        }
    }
}

TEST(Reference, HasARowForEachExitStatus) {
    const auto chapter = joined(chapterOfReference("## Exit status"));
    for (const int status : {kDone, kRefused, kUsage, kNoServer, kNotConfirmed, kStopped, kInterrupted})
        EXPECT_THAT(chapter, HasSubstr("\n| " + std::to_string(status) + " | "));
}

}  // namespace
