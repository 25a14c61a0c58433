// SPDX-License-Identifier: MIT
#include "messages/unexpected_words.hpp"

#include <algorithm>
#include <string_view>

#include "messages/text.hpp"

namespace axon {

std::string unexpectedWords(const std::string& program, const std::vector<std::string>& words,
                            const std::vector<std::string>& options) {
    const auto begins = [](const std::string& word) { return word.starts_with('-'); };
    const auto option = std::find_if(words.begin(), words.end(), begins);
    if (option == words.end())
        return program + ": unexpected word " + inQuotes(words.front()) + "\nfix: leave it out, or see " +
               program + " --help";
    const auto name = option->substr(0, option->find('='));
    const auto near = nearNames(name, {options.begin(), options.end()});
    return program + ": unknown option " + inQuotes(name) + "\nfix: " +
           (near.empty() ? program + " --help shows the options"
                         : "did you mean " + alternatives(near) + "?");
}

}  // namespace axon
