// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

namespace axon {

/// The text in double quotes as messages to people show it: cut after `limit` bytes (at a character's edge),
/// with control characters and bytes that are not UTF-8 shown as '?'.
std::string inQuotes(std::string_view text, std::size_t limit = 60);

/// Characters (Unicode code points) of a well-formed UTF-8 text.
std::size_t countCharacters(std::string_view text);

/// Without the white space of XML (space, tab, line ends) at both ends.
std::string_view trimmed(std::string_view text);

/// Equal when A to Z and a to z are not told apart.
bool equalIgnoringCase(std::string_view a, std::string_view b);

/// The candidates that a person who typed `name` may have meant, nearest first, at most three. Edit distance
/// without regard to case; a third of the name may be wrong, two characters of a short one.
std::vector<std::string> nearNames(std::string_view name, const std::vector<std::string_view>& candidates);

/// "a", "a or b", "a, b or c"; each quoted.
std::string alternatives(const std::vector<std::string>& names);

}  // namespace axon
