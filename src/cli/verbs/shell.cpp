// SPDX-License-Identifier: GPL-2.0-or-later
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <string>

#include "cli/holding.hpp"
#include "cli/verbs/shell_place.hpp"

// axon shell: a prompt of Python that is connected. The package axon has it (python/axon/shell.py).
namespace axon::cli {

namespace fs = std::filesystem;

std::optional<fs::path> pythonFolder(const fs::path& program) {
    if (program.empty()) return std::nullopt;  // unknown
    const auto folder = program.parent_path().parent_path();
    // Installed: PREFIX/bin/axon. Built: build/PRESET/bin/axon.
    for (const auto& packages : {folder / "lib/python3/dist-packages", folder / "python"}) {
        std::error_code unknown;
        if (fs::is_regular_file(packages / "axon/shell.py", unknown)) return packages.lexically_normal();
    }
    return std::nullopt;
}

namespace {

/// For the program that takes the place of this one; an empty value leaves the variable as it is.
void tell(const char* variable, const std::string& value) {
    if (!value.empty()) ::setenv(variable, value.c_str(), 1);
}

/// Whether the program finds the password in the configuration file, so that it needs no place in the
/// environment, which every program has that it starts. axon.shell takes it out of there as soon as it is
/// connected.
bool inConfiguration(const Settings& settings) {
    if (settings.config.empty()) return false;
    const auto read = client::readConfiguration(settings.config);
    return read && read->user == settings.user && read->password == settings.password;
}

int shell(Session& session) {
    std::error_code unknown;
    const auto packages = pythonFolder(fs::read_symlink("/proc/self/exe", unknown));
    if (!packages)
        return misused(session, "the Python package axon is not installed with this program",
                       "install the packages python3-axon and ipython3; from the sources, build with "
                       "AXON_PYTHON=ON");
    const char* before = std::getenv("PYTHONPATH");
    tell("PYTHONPATH", packages->string() + (before && *before ? ":" + std::string(before) : ""));
    // What a configuration file says of server and user is in the settings already (Settings::config).
    tell("AXON_SERVER", session.settings.server);
    tell("AXON_CONFIG", session.settings.config);
    tell("AXON_USER", session.settings.user);
    if (!inConfiguration(session.settings)) tell("AXON_PASSWORD", session.settings.password);
    const char* python = "/usr/bin/python3";  // Debian's, for which the package is built
    const std::array words{python, "-m", "axon.shell", static_cast<const char*>(nullptr)};
    ::execv(python, const_cast<char* const*>(words.data()));
    return misused(session, std::string(python) + " cannot be started: " + std::strerror(errno),
                   "install the packages python3-axon and ipython3");
}

}  // namespace

extern const Verb kShell{
    "shell",
    "Open an interactive prompt of Python that is connected",
    "  axon shell\n"
    "Then, for example:\n"
    "  robot = checkout(\"PeopleBot\")\n"
    "  robot.run(\"Driving\", Distance=1000)\n"
    "The tab key completes names of entities, services, parameters and units. Leaving the prompt releases\n"
    "what it holds. It needs the packages python3-axon and ipython3.\n",
    Runs::Local,
    {},
    {},
    shell};

}  // namespace axon::cli
