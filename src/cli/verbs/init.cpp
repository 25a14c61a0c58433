// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/holding.hpp"
#include "cli/project.hpp"
#include "cli/words.hpp"

// axon init
namespace axon::cli {
namespace {

int init(Session& session) {
    const std::string kind = session.args.at("kind");
    const std::string name = session.args.at("name");
    const auto folder = session.args.value("folder", name);
    const auto files = projectOf(kind, name);
    if (!files) return misused(session, files.refusal().message, "for example axon init " + kind + " Rover");
    if (const auto written = writeProject(folder, files.value()); !written) {
        return misused(session, written.refusal().message,
                       "choose another name, or another folder with --folder");
    }
    auto paths = Json::array();
    for (const auto& file : files.value()) paths.push_back(file.path);
    auto next = Json::array({"cd " + shellWord(folder)});
    if (kind == "robot") {
        next.push_back("./run");
    } else {
        next.push_back("cmake -S . -B build && cmake --build build");
        next.push_back("build/" + programOf(kind, name));
    }
    session.events.emit({{"event", "project"},
                         {"kind", kind},
                         {"name", name},
                         {"folder", folder},
                         {"files", std::move(paths)},
                         {"next", std::move(next)}});
    return kDone;
}

}  // namespace

extern const Verb kInit{
    "init",
    "Write a new project: a robot application, or a client program",
    "  axon init robot Rover             writes the folder Rover\n"
    "  cd Rover && ./run                 builds it and runs it; axon ls shows it\n"
    "  axon init client tour --folder src/tour\n"
    "The project builds and runs as it is. Its README.md says what to change.\n",
    Runs::Local,
    {{"kind", Takes::Choice, true, false, "robot or client", {"robot", "client"}},
     {"name", Takes::Text, true, false, "Name of the robot or program: letters, digits, '-' and '_'"}},
    {{"folder", Takes::File, "Folder to write; the name if it is not given"}},
    init};

}  // namespace axon::cli
