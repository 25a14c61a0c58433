// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/common_options.hpp"

#include <fmt/format.h>

namespace axon::cli {

const std::vector<CommonOption>& commonOptions() {
    static const std::vector<CommonOption> all{
        {"server", Takes::Text, "HOST:PORT", "AXON_SERVER", &Settings::server, true,
         "Address of the server, or the proxy of a router"},
        {"config", Takes::File, "FILE", "AXON_CONFIG", &Settings::config, true,
         "Configuration (client.cfg): router or server, user, certificates"},
        {"json", Takes::Nothing, "", "", &Settings::json, false, "Print lines of JSON instead of text"},
        {"timeout", Takes::Duration, "SECONDS", "", &Settings::timeout_s, true,
         "How long a request may take"},
        {"user", Takes::Text, "USER", "AXON_USER", &Settings::user, true,
         "User to log in as; the password comes from AXON_PASSWORD, a file or the terminal"},
        {"password-file", Takes::File, "FILE", "AXON_PASSWORD_FILE", &Settings::password_file, false,
         "File of mode 0600 with the password"},
        {"name", Takes::Text, "NAME", "", &Settings::name, true,
         "Name that others see as the holder; user@host if it is not given"},
        {"no-direct", Takes::Nothing, "", "", &Settings::direct, true,
         "Send everything through the servers, nothing directly to the Entity Managers"},
    };
    return all;
}

std::string helpOf(const CommonOption& option, const Settings& settings) {
    std::string value;
    if (const auto* text = std::get_if<std::string Settings::*>(&option.setting)) value = settings.*(*text);
    if (const auto* number = std::get_if<double Settings::*>(&option.setting))
        value = fmt::format("{}", settings.*(*number));
    const std::string variable = option.environment;
    if (value.empty() && variable.empty()) return option.help;
    if (value.empty()) return fmt::format("{} ({})", option.help, variable);
    return fmt::format("{} ({}default {})", option.help, variable.empty() ? "" : variable + "; ", value);
}

std::vector<std::string> wordsForAgent(const Settings& settings) {
    std::vector<std::string> words;
    for (const auto& option : commonOptions()) {
        if (!option.for_agent) continue;
        const auto name = std::string("--") + option.name;
        if (const auto* text = std::get_if<std::string Settings::*>(&option.setting)) {
            if (const auto& value = settings.*(*text); !value.empty())
                words.insert(words.end(), {name, value});
        } else if (const auto* number = std::get_if<double Settings::*>(&option.setting)) {
            words.insert(words.end(), {name, std::to_string(settings.*(*number))});
        } else if (const auto flag = std::get<bool Settings::*>(option.setting);
                   settings.*flag != Settings{}.*flag) {
            words.push_back(name);
        }
    }
    return words;
}

}  // namespace axon::cli
