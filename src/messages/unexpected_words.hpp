// SPDX-License-Identifier: MIT
#pragma once
#include <string>
#include <vector>

namespace axon {

/// What a program says of words of its command line that it does not know, with the options that may have
/// been meant; two lines, without the last line end. `options` with their dashes; `words` must not be empty.
std::string unexpectedWords(const std::string& program, const std::vector<std::string>& words,
                            const std::vector<std::string>& options);

}  // namespace axon
