// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/manual.hpp"

#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "cli/command_line.hpp"
#include "cli/common_options.hpp"
#include "cli/fake_station.hpp"
#include "cli/synopsis.hpp"

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;
using testing::Not;

namespace {

/// As a person reads it: without the escapes of troff.
std::string plain(std::string text) {
    const std::pair<const char*, const char*> kEscapes[] = {{"\\fB", ""}, {"\\fI", ""},   {"\\fR", ""},
                                                            {"\\-", "-"}, {"\\(aq", "'"}, {"\\(ti", "~"},
                                                            {"\\&", ""},  {"\\e", "\\"}};
    for (const auto& [escape, is] : kEscapes) {
        for (auto at = text.find(escape); at != std::string::npos; at = text.find(escape, at + 1))
            text.replace(at, std::string_view(escape).size(), is);
    }
    for (auto at = text.find("\\[u"); at != std::string::npos; at = text.find("\\[u", at + 1)) {
        const auto end = text.find(']', at);
        const auto point = std::stoul(text.substr(at + 3, end - at - 3), nullptr, 16);
        std::string character;
        if (point >= 0x800) {
            character += static_cast<char>(0xE0U | (point >> 12U));
            character += static_cast<char>(0x80U | ((point >> 6U) & 0x3FU));
        } else {
            character += static_cast<char>(0xC0U | (point >> 6U));
        }
        character += static_cast<char>(0x80U | (point & 0x3FU));
        text.replace(at, end - at + 1, character);
    }
    return text;
}

int help(std::vector<std::string> words, Recorded& seen) {
    const Settings settings;
    Session session{{{"verb", std::move(words)}}, seen, std::make_shared<Mailbox>(), nullptr, settings};
    return findVerb("help")->perform(session);
}

}  // namespace

TEST(Manual, APageSaysAllThatAVerbTakes) {
    for (const auto* verb : verbs()) {
        if (verb->hidden) continue;
        const auto page = plain(manualPage(*verb));
        EXPECT_THAT(page, HasSubstr(manualName(*verb) + " - " + verb->summary)) << verb->name;
        EXPECT_THAT(page, HasSubstr(synopsisOf(*verb))) << verb->name;
        for (const auto& operand : verb->operands)
            EXPECT_THAT(page, HasSubstr(".TP\n" + placeholderOf(operand)));
        for (const auto& option : verb->options)
            EXPECT_THAT(page, HasSubstr(std::string(".TP\n--") + option.name)) << verb->name;
        std::istringstream lines{std::string(verb->examples)};
        for (std::string line; std::getline(lines, line);)
            if (!line.empty()) EXPECT_THAT(page, HasSubstr(line.substr(line.find_first_not_of(' '))));
    }
}

TEST(Manual, TheFirstPageHasEveryVerbEveryOptionAndEveryStatus) {
    const auto page = plain(manualPage());
    for (const auto* verb : verbs()) {
        if (verb->hidden) {
            EXPECT_THAT(page, Not(HasSubstr(verb->name)));
        } else {
            EXPECT_THAT(page, HasSubstr(std::string(verb->name) + "\n"));
        }
    }
    for (const auto& option : commonOptions()) {
        EXPECT_THAT(page, HasSubstr(std::string("--") + option.name));
        EXPECT_THAT(page, HasSubstr(std::string(".TP\n") + option.environment));
    }
    for (const auto& one : exitMeanings()) EXPECT_THAT(page, HasSubstr(one.meaning));
}

TEST(Manual, NoTextOfAVerbIsARequestOfTheFormatter) {
    Verb verb{"try", "Try \\fBit", ".so /etc/passwd\n  'x' ^ ~\n…\n", Runs::Local, {}, {}, nullptr};
    const auto page = manualPage(verb);
    EXPECT_THAT(page, HasSubstr("Try \\efBit"));
    EXPECT_THAT(page, HasSubstr("\n\\&.so /etc/passwd\n"));
    EXPECT_THAT(page, HasSubstr("\n\\&\\(aqx\\(aq \\(ha \\(ti\n"));
    EXPECT_THAT(page, HasSubstr("\\[u2026]"));
}

TEST(Manual, IsWrittenWhereManAndTheShellsLook) {
    const auto folder = std::filesystem::path(testing::TempDir()) / "axon-manual";
    std::filesystem::remove_all(folder);
    ASSERT_TRUE(writeManual(folder));
    for (const auto* name : {"man/man1/axon.1", "man/man1/axon-global-run.1", "man/man1/axon-help.1",
                             "bash-completion/completions/axon", "zsh/vendor-completions/_axon",
                             "fish/vendor_completions.d/axon.fish"})
        EXPECT_GT(std::filesystem::file_size(folder / name), 100U) << name;
    EXPECT_FALSE(std::filesystem::exists(folder / "man/man1/axon-__complete.1"));
    std::ofstream(folder / "file") << "no folder";
    const auto refused = writeManual(folder / "file");
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.refusal().message, HasSubstr("man/man1/axon.1"));
    std::filesystem::remove_all(folder);
}

TEST(Help, ShowsWhatHelpOfTheVerbShows) {
    Recorded seen;
    EXPECT_EQ(help({"global", "run"}, seen), kDone);
    auto expected =
        parseCommandLine({"global", "run", "--help"}, [](const char*) -> const char* { return nullptr; }).out;
    expected.pop_back();
    EXPECT_EQ(seen.last("line")->at("text"), expected);
    EXPECT_EQ(help({"global"}, seen), kDone);
    EXPECT_THAT(seen.last("line")->at("text").get<std::string>(), HasSubstr("Usage: axon global VERB"));
    EXPECT_EQ(help({}, seen), kDone);
    EXPECT_THAT(seen.last("line")->at("text").get<std::string>(), HasSubstr("axon help VERB shows more"));
}

TEST(Help, NamesTheVerbThatIsNearAnUnknownOne) {
    Recorded seen;
    EXPECT_EQ(help({"chekout"}, seen), kUsage);
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("checkout"));
    EXPECT_EQ(help({"run", "PeopleBot"}, seen), kUsage);
}
