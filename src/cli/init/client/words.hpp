// SPDX-License-Identifier: MIT
#pragma once
#include <axon/client.hpp>
#include <optional>
#include <string>

/// "Distance=1000" as an argument of a task. The client library reads the value by the type that the
/// parameter has. Nothing if there is no name before a '='.
inline std::optional<axon::client::Argument> readArgument(const std::string& word) {
    const auto equals = word.find('=');
    if (equals == std::string::npos || equals == 0) return std::nullopt;
    axon::client::Argument argument;
    argument.name = word.substr(0, equals);
    argument.values = {word.substr(equals + 1)};
    argument.from_text = true;
    return argument;
}
