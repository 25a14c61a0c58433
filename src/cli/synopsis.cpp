// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/synopsis.hpp"

#include <algorithm>
#include <cctype>

namespace axon::cli {

std::string placeholderOf(const Operand& operand) {
    if (operand.takes == Takes::KeyValue) return "PARAMETER=VALUE";
    std::string text = operand.name;
    std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::toupper(c); });
    return text;
}

std::string placeholderOf(const Option& option) {
    switch (option.takes) {
        case Takes::Nothing:
            return {};
        case Takes::Duration:
            return "SECONDS";
        case Takes::MaybeDuration:
            return "[=SECONDS]";
        case Takes::Count:
            return "N";
        case Takes::Choice:
            return "CHOICE";
        case Takes::File:
            return "FILE";
        case Takes::Entity:
            return "ENTITY";
        case Takes::Binding:
            return "ROLE=ENTITY";
        default:
            return "TEXT";
    }
}

std::string synopsisOf(const Verb& verb) {
    std::string text = std::string("axon ") + verb.name;
    for (const auto& operand : verb.operands) {
        auto word = placeholderOf(operand);
        if (operand.repeated) word += "…";
        text += operand.required ? " " + word : " [" + word + "]";
    }
    if (std::string_view(verb.name) == "checkout") text += " [-- COMMAND…]";
    return text + " [OPTIONS]";
}

const std::vector<ExitMeaning>& exitMeanings() {
    static const std::vector<ExitMeaning> all{
        {kDone, "done"},
        {kRefused, "refused, or the task or run failed"},
        {kUsage, "the command line, a file or the configuration is wrong"},
        {kNoServer, "no server, or the connection was lost"},
        {kNotConfirmed, "not confirmed, timed out, or the outcome is unknown"},
        {kStopped, "the task, or the run, was stopped or cancelled"},
        {kInterrupted, "interrupted by Ctrl-C"},
    };
    return all;
}

}  // namespace axon::cli
