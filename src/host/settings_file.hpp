// SPDX-License-Identifier: MIT
#pragma once
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "common/result.hpp"

namespace axon {

/// One line `KEY = VALUE`.
struct Setting {
    std::string key;    ///< never empty
    std::string value;  ///< empty where nothing is behind the '='
    std::string where;  ///< "ports.cfg:2", begins a message about it
};

/// Reads the text of a settings file, the syntax of Ice's property files: one setting on each line, `#`
/// begins a comment, blanks around key and value do not count. A backslash takes the meaning from `#`, `=`, a
/// blank and itself; before anything else it is a character like others.
///
/// Returns the settings in the order of their lines, a key as often as it is there. Refused with MALFORMED
/// for a line that is no setting; the message names `file`, line, what was expected and the fix. It shows the
/// line's first word only, for a password may follow. Threads: any; pure.
Result<std::vector<Setting>> parseSettings(std::string_view text, std::string_view file);

/// The same from a file of at most 1 MiB; refused with BAD_NAME when it cannot be read.
Result<std::vector<Setting>> readSettings(const std::filesystem::path& file);

}  // namespace axon
