// SPDX-License-Identifier: GPL-2.0-or-later
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <set>
#include <thread>

#include "cli/arguments.hpp"
#include "cli/common_options.hpp"
#include "cli/holding.hpp"
#include "cli/manual.hpp"
#include "cli/words.hpp"

// axon completion, axon __complete
namespace axon::cli {
namespace {

// A shell that waits for a server that is away is worse than one that completes nothing.
constexpr std::chrono::milliseconds kPatience{300};
// Streams are listened for, which takes its time.
constexpr std::chrono::milliseconds kPatienceForStreams{800};

// In each script a candidate that ends in '=' goes on, "__files__" asks for file names, and others end the
// word.
constexpr const char* kBash = R"sh(# axon completion for bash: source <(axon completion bash)
_axon() {
    local word
    compopt -o nosort 2>/dev/null
    COMPREPLY=()
    while IFS= read -r word; do
        if [[ $word == __files__ ]]; then
            compopt -o default
            return
        fi
        [[ $word == *= ]] && compopt -o nospace
        COMPREPLY+=("$(printf '%q' "$word")")
    done < <(axon __complete "$COMP_CWORD" "${COMP_WORDS[@]}" 2>/dev/null)
}
complete -F _axon axon
)sh";

constexpr const char* kZsh = R"sh(#compdef axon
# axon completion for zsh: source <(axon completion zsh), or as _axon in a directory of $fpath
_axon() {
    local word
    while IFS= read -r word; do
        if [[ $word == __files__ ]]; then
            _files
        elif [[ $word == *= ]]; then
            compadd -S '' -- "$word"
        else
            compadd -- "$word"
        fi
    done < <(axon __complete $((CURRENT - 1)) "${words[@]}" 2>/dev/null)
}
if [[ ${funcstack[1]} == _axon ]]; then
    _axon "$@"
else
    compdef _axon axon
fi
)sh";

constexpr const char* kFish = R"sh(# axon completion for fish: axon completion fish | source
function __axon_complete
    set -l words (commandline -opc) (commandline -ct)
    for word in (axon __complete (math (count $words) - 1) $words 2>/dev/null)
        if test "$word" = __files__
            __fish_complete_path (commandline -ct)
        else
            echo $word
        end
    end
end
complete -c axon -f -a '(__axon_complete)'
)sh";

/// bash takes `Distance=10` apart at '=': together again, and how much of the last word it will keep by
/// itself.
struct Words {
    std::vector<std::string> done;
    std::string current;
    std::size_t kept_by_shell = 0;
};

Words joined(const std::vector<std::string>& raw, std::size_t at) {
    Words words;
    bool glue = false;
    std::vector<std::string> all;
    for (std::size_t i = 1; i <= at; ++i) {
        const auto word = i < raw.size() ? raw[i] : std::string();
        if (word == "=" && !all.empty()) {
            all.back() += "=";
            glue = true;
            words.kept_by_shell = all.back().size();
        } else if (glue) {
            all.back() += word;
            glue = false;
        } else {
            all.push_back(word);
            words.kept_by_shell = 0;
        }
    }
    if (all.empty()) all.emplace_back();
    words.current = all.back();
    all.pop_back();
    words.done = std::move(all);
    return words;
}

class Collected final : public Events {
  public:
    void emit(const Json& event) override { events.push_back(event); }
    const Json* first(const std::string& kind) const {
        for (const auto& event : events) {
            if (event.value("event", "") == kind) return &event;
        }
        return nullptr;
    }
    std::vector<Json> events;
};

/// The candidates for one place of a command line.
class Completer {
  public:
    explicit Completer(Session& session) : session_(session) {}

    std::vector<std::string> complete(const Words& words) {
        std::vector<std::string> given;
        const Verb* verb = nullptr;
        std::string group;   // "global "
        std::string option;  // that still wants its value
        for (const auto& word : words.done) {
            if (!option.empty()) {
                option.clear();
            } else if (word.rfind("--", 0) == 0) {
                if (word.find('=') == std::string::npos && wantsValue(verb, word)) option = word;
            } else if (verb == nullptr) {
                verb = findVerb(group + word);
                if (verb != nullptr) continue;
                if (!group.empty() || findGroup(word) == nullptr) return {};
                group = word + " ";
            } else {
                given.push_back(word);
            }
        }
        if (!option.empty()) {
            for (const auto& one : verb == nullptr ? std::vector<Option>{} : verb->options) {
                if (option != std::string("--") + one.name) continue;
                if (one.takes == Takes::File) return {"__files__"};
                if (one.takes == Takes::Entity) return entities();
                if (one.takes == Takes::Binding) return bindings(given, words.current);
                return {one.choices.begin(), one.choices.end()};
            }
            for (const auto& one : commonOptions()) {
                if (option == std::string("--") + one.name && one.takes == Takes::File) return {"__files__"};
            }
            return {};
        }
        if (words.current.rfind('-', 0) == 0) return options(verb);
        if (verb == nullptr) {
            return wordsAfter(group);
        }
        if (verb->operands.empty()) return {};
        const auto place = std::min(given.size(), verb->operands.size() - 1);
        const auto& operand = verb->operands[place];
        if (given.size() >= verb->operands.size() && !operand.repeated) return {};
        return operands(operand, given, words.current);
    }

  private:
    /// The words that go on from "" or "global " to the name of a verb.
    static std::vector<std::string> wordsAfter(const std::string& before) {
        std::vector<std::string> names;
        for (const auto* one : verbs()) {
            const std::string name = one->name;
            if (one->hidden || !name.starts_with(before)) continue;
            // The next word of it: a verb, or a group once.
            const auto next = name.substr(before.size());
            const auto word = next.substr(0, next.find(' '));
            if (names.empty() || names.back() != word) names.push_back(word);
        }
        return names;
    }

    /// For axon help: the first word of a verb, and after that of a group the second.
    static std::vector<std::string> verbNames(const std::vector<std::string>& given) {
        if (given.empty()) return wordsAfter({});
        if (given.size() == 1 && findGroup(given[0]) != nullptr) return wordsAfter(given[0] + " ");
        return {};
    }

    static bool wantsValue(const Verb* verb, const std::string& word) {
        // A verb's own option comes first: --server of certs takes no value.
        for (const auto& option : verb == nullptr ? std::vector<Option>{} : verb->options) {
            if (word == std::string("--") + option.name)
                return option.takes != Takes::Nothing && option.takes != Takes::MaybeDuration;
        }
        const auto& common = commonOptions();
        return std::any_of(common.begin(), common.end(), [&word](const CommonOption& option) {
            return word == std::string("--") + option.name && option.takes != Takes::Nothing;
        });
    }

    static std::vector<std::string> options(const Verb* verb) {
        std::vector<std::string> names;
        if (verb != nullptr) {
            for (const auto& option : verb->options) names.push_back(std::string("--") + option.name);
        }
        names.emplace_back("--help");
        for (const auto& option : commonOptions()) {
            // A verb may have one of its own by that name: --server of certs.
            const auto name = std::string("--") + option.name;
            if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
        }
        return names;
    }

    std::vector<std::string> operands(const Operand& operand, const std::vector<std::string>& given,
                                      const std::string& current) {
        switch (operand.takes) {
            case Takes::Entity:
                return entities();
            case Takes::File:
                return {"__files__"};
            case Takes::Choice: {
                std::vector<std::string> choices(operand.choices.begin(), operand.choices.end());
                choices.erase(std::remove(choices.begin(), choices.end(), "run"), choices.end());
                return choices;
            }
            case Takes::Service: {
                std::vector<std::string> names;
                for (const auto& service : services(given)) names.push_back(service.at("name"));
                return names;
            }
            case Takes::Resource: {
                std::vector<std::string> names;
                if (const auto service = chosen(given); service.is_object()) {
                    for (const auto& resource : service.at("resources")) names.push_back(resource.at("name"));
                }
                return names;
            }
            case Takes::KeyValue:
                return parameters(given, current);
            case Takes::Stream:
                return streams(given);
            case Takes::Verb:
                return verbNames(given);
            case Takes::GlobalService: {
                std::vector<std::string> names;
                for (const auto& service : globalServices()) names.push_back(service.at("name"));
                return names;
            }
            case Takes::Run: {
                Collected seen;
                session_.perform("global history", Json::object(), seen);
                std::vector<std::string> ids;
                if (const auto* list = seen.first("runs")) {
                    for (const auto& run : list->at("runs"))
                        ids.push_back(run.at("id").get<std::string>().substr(0, 8));
                }
                return ids;
            }
            case Takes::Task: {
                // Of the entity before it, where the verb is about one. A task that is over can be neither
                // controlled nor waited for.
                Collected seen;
                auto args = Json::object();
                if (!operand.repeated && !given.empty()) args["entity"] = given[0];
                session_.perform("tasks", args, seen);
                std::vector<std::string> ids;
                if (const auto* list = seen.first("tasks")) {
                    for (const auto& task : list->at("tasks"))
                        if (!task.at("final")) ids.push_back(task.at("id").get<std::string>().substr(0, 8));
                }
                return ids;
            }
            default:
                return {};
        }
    }

    std::vector<std::string> entities() {
        Collected seen;
        session_.perform("ls", Json::object(), seen);
        std::vector<std::string> names;
        if (const auto* list = seen.first("entities")) {
            for (const auto& entity : list->at("entities")) names.push_back(entity.at("call"));
        }
        return names;
    }

    std::vector<std::string> streams(const std::vector<std::string>& given) {
        if (given.empty()) return {};
        Collected seen;
        session_.perform("info", {{"entity", given[0]}}, seen);
        std::vector<std::string> names;
        if (const auto* entity = seen.first("entity")) {
            for (const auto& stream : entity->at("streams")) {
                const auto name = stream.at("name").get<std::string>();
                if (std::find(given.begin(), given.end(), name) == given.end()) names.push_back(name);
            }
        }
        return names;
    }

    Json globalServices() {
        Collected seen;
        session_.perform("global ls", Json::object(), seen);
        const auto* list = seen.first("global_services");
        return list == nullptr ? Json::array() : list->at("services");
    }

    /// `0=`, and after the '=' the entities.
    std::vector<std::string> bindings(const std::vector<std::string>& given, const std::string& current) {
        std::vector<std::string> words;
        if (const auto equals = current.find('='); equals != std::string::npos) {
            for (const auto& entity : entities()) words.push_back(current.substr(0, equals + 1) + entity);
            return words;
        }
        for (const auto& service : globalServices()) {
            if (given.empty() || !sameToAPerson(service.at("name").get<std::string>(), given[0])) continue;
            for (const auto& role : service.at("roles")) words.push_back(line(role) + "=");
        }
        return words;
    }

    Json services(const std::vector<std::string>& given) {
        if (given.empty()) return Json::array();
        Collected seen;
        session_.perform("info", {{"entity", given[0]}, {"no-streams", true}}, seen);
        const auto* entity = seen.first("entity");
        return entity == nullptr ? Json::array() : entity->at("services");
    }

    Json chosen(const std::vector<std::string>& given) {
        if (given.size() < 2) return nullptr;
        for (const auto& service : services(given)) {
            if (sameToAPerson(service.at("name").get<std::string>(), given[1]) ||
                service.at("global_id") == given[1]) {
                return service;
            }
        }
        return nullptr;
    }

    /// `distance=`, and after the '=' the values that there are.
    std::vector<std::string> parameters(const std::vector<std::string>& given, const std::string& current) {
        const auto service = chosen(given);
        if (!service.is_object()) return {};
        const auto equals = current.find('=');
        std::vector<std::string> words;
        for (const auto& parameter : service.at("parameters")) {
            const auto type = parameter.at("type").get<std::string>();
            if (type == "OUTPUT" || type == "FEEDBACK") continue;
            auto key = parameter.at("name").get<std::string>();
            if (equals == std::string::npos) {
                // Nobody wants to type quotes: readArguments takes '_' for ' '.
                std::replace(key.begin(), key.end(), ' ', '_');
                const bool repeated = parameter.at("multiple");
                const bool used = std::any_of(given.begin(), given.end(), [&](const std::string& word) {
                    return sameToAPerson(word.substr(0, word.find('=')), key);
                });
                if (!used || repeated) words.push_back(key + "=");
                continue;
            }
            if (!sameToAPerson(key, current.substr(0, equals))) continue;
            auto values = parameter.value("choices", Json::array());
            if (values.empty() && parameter.at("data_type") == "BOOL") values = {true, false};
            if (values.empty()) values = parameter.at("values");
            for (const auto& value : values) {
                words.push_back(current.substr(0, equals + 1) +
                                (value.is_string() ? value.get<std::string>() : line(value)));
            }
        }
        return words;
    }

    Session& session_;
};

/// Ends the process when the completion takes too long; nothing has been printed then.
class Impatience {
  public:
    explicit Impatience(std::chrono::milliseconds patience) : patience_(patience) {}

  private:
    const std::chrono::milliseconds patience_;
    std::mutex mutex_;
    std::condition_variable_any ended_;
    const std::jthread thread_{[this](const std::stop_token& enough) {
        std::unique_lock lock(mutex_);
        ended_.wait_for(lock, enough, patience_, [] { return false; });
        if (!enough.stop_requested()) ::_exit(kNotConfirmed);
    }};
};

int complete(Session& session) {
    const auto words = session.args.at("words").get<std::vector<std::string>>();
    if (words.empty()) return kUsage;
    std::size_t at = 0;
    for (const char c : words[0]) {
        if (c < '0' || c > '9' || at > 10'000)
            return misused(session, "expected the number of the word to complete");
        at = at * 10 + static_cast<std::size_t>(c - '0');
    }
    const auto line_words = joined({words.begin() + 1, words.end()}, at);
    const auto& done = line_words.done;
    const bool streams = std::find(done.begin(), done.end(), "watch") != done.end();
    const Impatience impatience(streams ? kPatienceForStreams : kPatience);
    std::string text;
    for (const auto& candidate : Completer(session).complete(line_words)) {
        const bool files = candidate == "__files__";
        if (!files && !sameToAPerson(candidate.substr(0, line_words.current.size()), line_words.current))
            continue;
        if (candidate.find('\n') != std::string::npos) continue;
        text += (text.empty() ? "" : "\n") + (files ? candidate : candidate.substr(line_words.kept_by_shell));
    }
    if (!text.empty()) session.events.emit({{"event", "line"}, {"text", text}});
    return kDone;
}

int completion(Session& session) {
    auto script = completionScript(session.args.at("shell"));
    script.pop_back();
    session.events.emit({{"event", "line"}, {"text", script}});
    return kDone;
}

}  // namespace

std::string completionScript(const std::string& shell) {
    return shell == "bash" ? kBash : shell == "zsh" ? kZsh : kFish;
}

extern const Verb kCompletion{
    "completion",
    "Print the completion script of a shell",
    "  source <(axon completion bash)     for this shell only\n"
    "For every new shell:\n"
    "  mkdir -p ~/.local/share/bash-completion/completions\n"
    "  axon completion bash > ~/.local/share/bash-completion/completions/axon\n"
    "  mkdir -p ~/.zfunc && axon completion zsh > ~/.zfunc/_axon\n"
    "  mkdir -p ~/.config/fish/completions && axon completion fish > ~/.config/fish/completions/axon.fish\n"
    "bash needs the package bash-completion. zsh needs fpath+=~/.zfunc before compinit in ~/.zshrc.\n"
    "It completes verbs, options, entities, their services, parameters and values, global services and "
    "roles.\n",
    Runs::Local,
    {{"shell", Takes::Choice, true, false, "bash, zsh or fish", {"bash", "zsh", "fish"}}},
    {},
    completion};

extern const Verb kComplete{"__complete",
                            "What may come at a place of a command line",
                            "",
                            Runs::Local,
                            {{"words", Takes::Text, true, true, "Number of the word, and the words"}},
                            {},
                            complete,
                            nullptr,
                            true};

}  // namespace axon::cli
