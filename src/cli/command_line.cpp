// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/command_line.hpp"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>

#include "axon/client.hpp"
#include "cli/common_options.hpp"
#include "cli/password.hpp"
#include "cli/synopsis.hpp"
#include "cli/words.hpp"
#include "common/release.hpp"
#include "messages/text.hpp"

namespace axon::cli {
namespace {

constexpr const char* kRootFooter =
    "\nGet started:\n"
    "  axon ls                                    list the entities\n"
    "  axon info PeopleBot                        show what it can do\n"
    "  axon run PeopleBot Driving Distance=1000   run a task\n"
    "  axon stop PeopleBot                        stop it at any time, whoever holds it\n"
    "  axon checkout PeopleBot                    check it out until axon release\n"
    "  axon checkout --query '1 ROBOT/MOBILE'     check out any that is free\n"
    "Words: an entity is a robot or machine. To check it out is to reserve it for yourself; the agent is a "
    "process\n"
    "in the background that keeps check-outs. A stop latches an entity: it refuses tasks until axon rearm. A "
    "receipt\n"
    "says what a stop has reached. A drill measures how long a stop takes, and stops nothing.\n"
    "axon help VERB shows more. Exit status: 0 done, 1 refused or failed, 2 usage, 3 no server,\n"
    "4 not confirmed, 5 stopped or cancelled, 130 interrupted.";

/// As in Verb::name.
std::string nameOf(const CLI::App& app) {
    const auto* parent = app.get_parent();
    if (parent == nullptr) return {};
    const auto before = nameOf(*parent);
    return before.empty() ? app.get_name() : before + " " + app.get_name();
}

/// The verb that is meant by the words of a command line, among which are options.
const Verb* verbIn(const std::vector<std::string>& words) {
    const VerbGroup* group = nullptr;
    for (const auto& word : words) {
        if (const auto* verb = findVerb(group == nullptr ? word : std::string(group->name) + " " + word))
            return verb;
        if (group == nullptr) group = findGroup(word);
    }
    return nullptr;
}

/// CLI11's help with the usage line from the verb's own table.
class HelpFormatter final : public CLI::Formatter {
  public:
    std::string make_usage(const CLI::App* app, std::string name) const override {
        const auto* verb = findVerb(nameOf(*app));
        if (const auto group = nameOf(*app); findGroup(group) != nullptr)
            return "Usage: axon " + group + " VERB [OPTIONS]\n";
        return verb != nullptr ? "Usage: " + synopsisOf(*verb) + "\n" : CLI::Formatter::make_usage(app, name);
    }
};

void declare(CLI::App& app, const Verb& verb, Json& args) {
    for (const auto& operand : verb.operands) {
        CLI::Option* declared = nullptr;
        if (operand.repeated) {
            declared = app.add_option_function<std::vector<std::string>>(
                operand.name,
                [&args, &operand](const std::vector<std::string>& words) { args[operand.name] = words; },
                operand.help);
            // Not Vector's own splitting: a value may hold anything.
            declared->delimiter('\0');
        } else {
            declared = app.add_option_function<std::string>(
                operand.name, [&args, &operand](const std::string& word) { args[operand.name] = word; },
                operand.help);
        }
        if (!operand.choices.empty()) {
            declared->check(
                CLI::IsMember(std::vector<std::string>(operand.choices.begin(), operand.choices.end())));
        }
        declared->required(operand.required);
        declared->type_name("");
    }
    for (const auto& option : verb.options) {
        const auto name = std::string("--") + option.name;
        switch (option.takes) {
            case Takes::Nothing:
                app.add_flag_callback(
                    name, [&args, &option] { args[option.name] = true; }, option.help);
                break;
            case Takes::Duration:
                app.add_option_function<double>(
                       name, [&args, &option](double seconds) { args[option.name] = seconds; }, option.help)
                    ->check(CLI::Range(0.0, 1e9).description(""))
                    ->type_name(placeholderOf(option));
                break;
            case Takes::Count:
                app.add_option_function<int>(
                       name, [&args, &option](int count) { args[option.name] = count; }, option.help)
                    ->check(CLI::Range(1, 1'000'000).description(""))
                    ->type_name(placeholderOf(option));
                break;
            case Takes::MaybeDuration:
                // A flag, so that the word after it is not taken for its number; see readMaybeDurations.
                app.add_flag(name, option.help)->type_name(placeholderOf(option));
                break;
            case Takes::Choice:
                app.add_option_function<std::string>(
                       name, [&args, &option](const std::string& word) { args[option.name] = word; },
                       option.help)
                    ->check(
                        CLI::IsMember(std::vector<std::string>(option.choices.begin(), option.choices.end()))
                            .description(""))
                    ->type_name(placeholderOf(option));
                break;
            default: {
                const auto type = placeholderOf(option);
                if (!option.repeated) {
                    app.add_option_function<std::string>(
                           name, [&args, &option](const std::string& word) { args[option.name] = word; },
                           option.help)
                        ->type_name(type);
                    break;
                }
                // One word each time: what follows is an operand.
                app.add_option_function<std::vector<std::string>>(
                       name,
                       [&args, &option](const std::vector<std::string>& words) { args[option.name] = words; },
                       option.help)
                    ->allow_extra_args(false)
                    ->delimiter('\0')
                    ->type_name(type);
            }
        }
    }
}

void declareCommon(CLI::App& app, Settings& settings) {
    for (const auto& option : commonOptions()) {
        const auto name = std::string("--") + option.name;
        const auto help = helpOf(option, settings);
        if (const auto* text = std::get_if<std::string Settings::*>(&option.setting)) {
            app.add_option(name, settings.*(*text), help)->type_name(option.placeholder);
        } else if (const auto* number = std::get_if<double Settings::*>(&option.setting)) {
            app.add_option(name, settings.*(*number), help)
                ->check(CLI::Range(0.01, 3600.0).description(""))
                ->type_name(option.placeholder);
        } else {
            const auto flag = std::get<bool Settings::*>(option.setting);
            app.add_flag_callback(
                name, [&settings, flag] { settings.*flag = !(Settings{}.*flag); }, help);
        }
    }
}

/// What is wrong with one of them, or an empty text.
std::string readMaybeDurations(const CLI::App& app, const Verb& verb, Json& args) {
    for (const auto& option : verb.options) {
        if (option.takes != Takes::MaybeDuration) continue;
        const auto name = std::string("--") + option.name;
        const auto* given = app.get_option(name);
        if (given->count() == 0) continue;
        const auto text = given->results().back();
        if (text == "true") {
            args[option.name] = true;
            continue;
        }
        char* end = nullptr;
        const double seconds = std::strtod(text.c_str(), &end);
        if (text.empty() || *end != '\0' || !(seconds >= 0) || seconds > 1e9)
            return "expected " + name + " or " + name + "=SECONDS, found " + inQuotes(text);
        args[option.name] = seconds;
    }
    return {};
}

bool isVerb(const std::string& word) {
    return findVerb(word) != nullptr;
}

/// The command after `--` of `checkout`: CLI11 would take it for more entities.
std::vector<std::string> takeCommand(std::vector<std::string>& words) {
    const auto dashes = std::find(words.begin(), words.end(), "--");
    const auto verb = std::find_if(words.begin(), dashes, isVerb);
    if (dashes == words.end() || verb == dashes || *verb != "checkout") return {};
    std::vector<std::string> command(dashes + 1, words.end());
    words.erase(dashes, words.end());
    return command;
}

/// Fills in what was not said elsewhere; what is wrong with the file, or an empty text.
std::string readConfig(Settings& settings, bool server_said) {
    std::error_code ignored;
    settings.config = std::filesystem::absolute(settings.config, ignored).string();
    client::Options defaults;
    auto read = client::readConfiguration(settings.config, defaults);
    if (!read) return read.refusal().message;
    auto its = std::move(read).value();
    if (!server_said && !its.server.empty()) settings.server = its.server;
    // A password goes with its user.
    if (settings.user.empty() || settings.user == its.user) {
        settings.user = its.user;
        if (settings.password.empty() && settings.password_file.empty()) settings.password = its.password;
    }
    settings.properties = std::move(its.properties);
    return {};
}

/// HOST:PORT, or the proxy of a router.
bool isServer(const std::string& text) {
    if (text.find('/') != std::string::npos) return text.find(':') != std::string::npos;
    const auto colon = text.rfind(':');
    return colon != std::string::npos && colon != 0 && colon + 1 != text.size() &&
           text.find_first_not_of("0123456789", colon + 1) == std::string::npos;
}

/// But for the options of every verb and what they take.
std::vector<std::string> withoutOptions(const CLI::App& app, const std::vector<std::string>& all) {
    std::vector<std::string> words;
    for (std::size_t i = 0; i < all.size(); ++i) {
        if (all[i].rfind('-', 0) != 0) {
            words.push_back(all[i]);
        } else if (const auto* option = app.get_option_no_throw(all[i]);
                   option != nullptr && option->get_items_expected_max() > 0) {
            ++i;
        }
    }
    return words;
}

/// What is wrong with the words after a verb, with its remedy. `what` is CLI11's text, which for a word that
/// is none of the choices is "NAME: WORD not in {CHOICES}".
std::string wrongWord(const Verb& verb, const std::string& what) {
    const auto told = [&](const std::string& name, const auto& choices) -> std::optional<std::string> {
        const auto begin = name + ": ";
        const auto end = what.find(" not in {");
        if (choices.empty() || !what.starts_with(begin) || end == std::string::npos) return std::nullopt;
        const auto word = what.substr(begin.size(), end - begin.size());
        const std::vector<std::string_view> names(choices.begin(), choices.end());
        const auto near = nearNames(word, names);
        return "expected " + alternatives({names.begin(), names.end()}) + ", found " + inQuotes(word) +
               "\nfix: " + (near.empty() ? synopsisOf(verb) : "did you mean " + alternatives(near) + "?");
    };
    for (const auto& operand : verb.operands)
        if (const auto text = told(operand.name, operand.choices)) return *text;
    for (const auto& option : verb.options)
        if (const auto text = told(std::string("--") + option.name, option.choices)) return *text;
    return what + "\nfix: " + synopsisOf(verb);
}

std::string mistake(const std::vector<std::string>& words, const std::string& what) {
    const auto first = words.begin();
    if (first == words.end()) return "axon: " + what + "\nfix: axon --help shows the verbs\n";
    if (const auto* verb = verbIn(words)) return "axon: " + wrongWord(*verb, what) + "\n";
    std::vector<std::string_view> names;
    if (const auto* group = findGroup(*first)) {
        const std::string before = std::string(group->name) + " ";
        const auto second = first + 1;
        for (const auto* verb : verbs()) {
            if (std::string_view(verb->name).rfind(before, 0) == 0)
                names.push_back(std::string_view(verb->name).substr(before.size()));
        }
        const auto wanted = second == words.end() ? std::string() : *second;
        const auto near = nearNames(wanted, names);
        return "axon: " + (wanted.empty() ? what : "unknown verb " + inQuotes(before + wanted)) + "\nfix: " +
               (near.empty() ? "axon " + before + "--help shows the verbs"
                             : "did you mean " + alternatives(near) + "?") +
               "\n";
    }
    for (const auto* verb : verbs()) {
        if (!verb->hidden && std::string_view(verb->name).find(' ') == std::string_view::npos)
            names.emplace_back(verb->name);
    }
    for (const auto& group : verbGroups()) names.emplace_back(group.name);
    const auto near = nearNames(*first, names);
    return "axon: unknown verb " + inQuotes(*first) + "\nfix: " +
           (near.empty() ? "axon --help shows the verbs" : "did you mean " + alternatives(near) + "?") + "\n";
}

}  // namespace

Parsed parseCommandLine(std::vector<std::string> words,
                        const std::function<const char*(const char*)>& environment) {
    Parsed parsed;
    CommandLine line;
    const auto from = [&](const char* name, std::string& setting) {
        const char* value = *name == '\0' ? nullptr : environment(name);
        if (value != nullptr && *value != '\0') setting = value;
    };
    for (const auto& option : commonOptions()) {
        if (const auto* text = std::get_if<std::string Settings::*>(&option.setting))
            from(option.environment, line.settings.*(*text));
    }
    from("AXON_PASSWORD", line.settings.password);
    const auto* named_server = environment("AXON_SERVER");
    bool server_said = named_server != nullptr && *named_server != '\0';

    // The words of somebody else's half-written line: nothing of them is an option of ours.
    if (!words.empty() && words.front() == "__complete") {
        line.verb = findVerb("__complete");
        line.args["words"] = std::vector<std::string>(words.begin() + 1, words.end());
        for (std::size_t i = 1; i + 1 < words.size(); ++i) {
            if (words[i] == "--server") line.settings.server = words[i + 1];
            if (words[i] == "--config") line.settings.config = words[i + 1];
        }
        if (!line.settings.config.empty()) readConfig(line.settings, server_said);
        parsed.line = std::move(line);
        return parsed;
    }

    // Another program's words, likewise, but for the help that says so.
    if (!words.empty() && words.front() == "bench" &&
        !(words.size() == 2 && (words[1] == "--help" || words[1] == "-h"))) {
        line.verb = findVerb("bench");
        line.args["words"] = std::vector<std::string>(words.begin() + 1, words.end());
        parsed.line = std::move(line);
        return parsed;
    }

    line.command = takeCommand(words);
    CLI::App app("Use the robots of an Axon laboratory.", "axon");
    app.require_subcommand(1, 1);
    const auto formatter = std::make_shared<HelpFormatter>();
    formatter->column_width(24);
    app.formatter(formatter);
    app.footer(kRootFooter);
    declareCommon(app, line.settings);
    app.set_version_flag("--version", std::string("axon ") + kRelease);
    // A plain list of verbs, not each one's whole help.
    std::map<std::string, CLI::App*> groups;
    for (const auto* verb : verbs()) {
        const std::string name = verb->name;
        CLI::App* above = &app;
        if (const auto space = name.find(' '); space != std::string::npos) {
            const auto& group = *findGroup(name.substr(0, space));
            auto& made = groups[group.name];
            if (made == nullptr) {
                made = app.add_subcommand(group.name, group.summary);
                made->require_subcommand(1, 1)->fallthrough();
                made->footer(group.footer);
            }
            above = made;
        }
        auto* sub = above->add_subcommand(name.substr(name.find(' ') + 1), verb->summary);
        sub->fallthrough();
        if (*verb->examples != '\0')
            sub->footer(std::string("Examples:\n") + verb->examples +
                        "\naxon --help shows the options that all verbs share (--server, --json, …).");
        if (verb->hidden) sub->group("");
        declare(*sub, *verb, line.args);
    }
    try {
        auto reversed = words;
        std::reverse(reversed.begin(), reversed.end());
        app.parse(reversed);
    } catch (const CLI::ParseError& error) {
        std::ostringstream out;
        std::ostringstream err;
        if (error.get_exit_code() == static_cast<int>(CLI::ExitCodes::Success)) {
            app.exit(error, out, err);
            parsed.out = out.str();
            return parsed;
        }
        if (words.empty()) {
            parsed.out = app.help();
        } else if (words.size() == 1 && groups.count(words[0]) != 0) {
            parsed.out = groups[words[0]]->help("axon");
        } else {
            parsed.err = mistake(withoutOptions(app, words), error.what());
        }
        parsed.exit = kUsage;
        return parsed;
    }
    const auto* sub = app.get_subcommands().front();
    while (!sub->get_subcommands().empty()) sub = sub->get_subcommands().front();
    line.verb = findVerb(nameOf(*sub));
    auto wrong_option = readMaybeDurations(*sub, *line.verb, line.args);
    const bool connects = line.verb->runs != Runs::Local || std::string_view(line.verb->name) == "doctor" ||
                          std::string_view(line.verb->name) == "shell";
    const bool finds_server = connects || std::string_view(line.verb->name) == "agent" ||
                              std::string_view(line.verb->name) == "console";
    if (wrong_option.empty() && !line.settings.config.empty() && finds_server) {
        if (app.get_option("--config")->count() > 0) server_said = false;
        if (app.get_option("--server")->count() > 0) server_said = true;
        wrong_option = readConfig(line.settings, server_said);
    }
    if (wrong_option.empty() && connects && line.settings.password.empty() &&
        !line.settings.password_file.empty()) {
        auto password = readPassword(line.settings.password_file);
        if (password) {
            line.settings.password = std::move(password).value();
        } else {
            wrong_option = password.refusal().message;
        }
    }
    if (!wrong_option.empty()) {
        const auto [message, fix] = parted(wrong_option);
        parsed.err = "axon: " + message + "\nfix: " + (fix.empty() ? synopsisOf(*line.verb) : fix) + "\n";
        parsed.exit = kUsage;
        return parsed;
    }
    if (!isServer(line.settings.server)) {
        parsed.err = "axon: expected --server HOST:PORT, found " + inQuotes(line.settings.server) +
                     "\nfix: for example --server 127.0.0.1:10410\n";
        parsed.exit = kUsage;
        return parsed;
    }
    if (line.verb->prepare != nullptr) {
        if (const auto wrong = line.verb->prepare(line.args); !wrong.empty()) {
            const auto [message, fix] = parted(wrong);
            parsed.err = "axon: " + message + "\nfix: " + (fix.empty() ? synopsisOf(*line.verb) : fix) + "\n";
            parsed.exit = kUsage;
            return parsed;
        }
    }
    parsed.line = std::move(line);
    return parsed;
}

}  // namespace axon::cli
