// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "cli/session.hpp"

// New projects: what `axon init` writes.
namespace axon::cli {

/// A file below src/cli/init, whose text is part of the program.
struct EmbeddedFile {
    std::string_view path;  ///< "robot/main.cpp"
    bool executable;
    std::string_view text;
};
const std::vector<EmbeddedFile>& projectFiles();

/// A file of a new project.
struct ProjectFile {
    std::string path;  ///< below the folder of the project
    bool executable = false;
    std::string text;
};

/// "greeter-robot" for a robot called Greeter: the program of the project.
std::string programOf(const std::string& kind, const std::string& name);
/// The files of a project of that kind ("robot" or "client"), with the name put in. MALFORMED if the name
/// does not begin with a letter, is longer than 40 characters, or has others than letters, digits, '-' and
/// '_'.
Result<std::vector<ProjectFile>> projectOf(const std::string& kind, const std::string& name);
/// Writes them. MALFORMED if there is something in the folder already, or a file cannot be written.
Result<void> writeProject(const std::filesystem::path& folder, const std::vector<ProjectFile>& files);

}  // namespace axon::cli
