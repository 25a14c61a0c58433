// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/project.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <fstream>

#include "cli/view_text.hpp"
#include "messages/text.hpp"

namespace axon::cli {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kLongestName = 40;

bool isLetter(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

bool isName(std::string_view name) {
    return !name.empty() && name.size() <= kLongestName && isLetter(name.front()) &&
           std::all_of(name.begin(), name.end(),
                       [](char c) { return isLetter(c) || (c >= '0' && c <= '9') || c == '-' || c == '_'; });
}

std::string replaced(std::string text, std::string_view what, const std::string& by) {
    for (auto at = text.find(what); at != std::string::npos; at = text.find(what, at + by.size()))
        text.replace(at, what.size(), by);
    return text;
}

Refusal cannot(const std::string& what, const fs::path& path, const std::string& why) {
    return Refusal{RefusalCode::Malformed,
                   "cannot " + what + " " + inQuotes(path.string(), 200) + ": " + why};
}

}  // namespace

std::string programOf(const std::string& kind, const std::string& name) {
    const auto lower = lowerCase(name);
    return lower.ends_with(kind) ? lower : lower + "-" + kind;
}

Result<std::vector<ProjectFile>> projectOf(const std::string& kind, const std::string& name) {
    if (!isName(name)) {
        return Refusal{
            RefusalCode::Malformed,
            "expected a name that begins with a letter and has at most 40 letters, digits, '-' and "
            "'_', found " +
                inQuotes(name)};
    }
    std::vector<ProjectFile> files;
    for (const auto& file : projectFiles()) {
        if (!file.path.starts_with(kind + "/")) continue;
        auto text = replaced(std::string(file.text), "@NAME@", name);
        files.push_back({std::string(file.path.substr(kind.size() + 1)), file.executable,
                         replaced(std::move(text), "@TARGET@", programOf(kind, name))});
    }
    return files;
}

Result<void> writeProject(const fs::path& folder, const std::vector<ProjectFile>& files) {
    std::error_code failed;
    if (fs::exists(fs::symlink_status(folder, failed)) &&
        !(fs::is_directory(folder, failed) && fs::is_empty(folder, failed))) {
        return cannot("make a project in", folder, "it exists and is not an empty folder");
    }
    fs::create_directories(folder, failed);
    if (failed) return cannot("make", folder, failed.message());
    for (const auto& file : files) {
        const auto path = folder / file.path;
        std::ofstream out(path, std::ios::binary);
        out << file.text;
        out.close();
        if (out.fail()) return cannot("write", path, std::strerror(errno));
        if (file.executable)
            fs::permissions(path, fs::perms::owner_exec | fs::perms::group_exec | fs::perms::others_exec,
                            fs::perm_options::add, failed);
    }
    return {};
}

}  // namespace axon::cli
