// SPDX-License-Identifier: GPL-2.0-or-later
#include <axon/entity_interfacer.hpp>
#include <iostream>

// The entity of command_test.py, without a robot: workbench-entity FOLDER_OF_PROFILES PORTS_FILE
int main(int argc, char** argv) try {
    if (argc != 3) return std::cerr << "workbench-entity FOLDER_OF_PROFILES PORTS_FILE\n", 2;
    const std::filesystem::path profiles = argv[1];
    axon::EntityInterfacer interfacer({.application = "Workbench", .ports_file = argv[2]});
    interfacer.uploadBasicProfile(profiles / "basic.xml");
    interfacer.uploadServiceProfile(profiles / "services.xml");
    auto turns_done = interfacer.stream("turns");
    interfacer.onParameter([](const std::string&, const axon::Parameter& parameter) {
        return parameter.name == "Speed" && parameter.integer() == 7 ? axon::Decision::deny("at 7 it rattles")
                                                                     : axon::Decision::grant();
    });
    interfacer.onText(
        [&](const std::string& text, const std::string&) { interfacer.sendInfoMsg("heard: " + text); });
    interfacer.onRaw([&](const std::vector<std::string>& blocks, const std::string&) {
        std::string all;
        for (const auto& block : blocks) all += block;
        interfacer.sendRaw(std::string(all.rbegin(), all.rend()));
    });
    interfacer.onTask("Work", [&](axon::Task& task) {
        const auto turns = task.integer("Turns");
        for (std::int64_t turn = 1; turn <= turns && task.waitWhilePaused(); ++turn) {
            if (!task.waitFor(std::chrono::milliseconds(20))) break;
            task.progress(static_cast<double>(turn) / static_cast<double>(turns));
            turns_done.send(static_cast<double>(turn));
        }
        task.result("Speed used", task.integer("Speed"));
        if (const auto plan = task.resource("Plan"); !plan.empty())
            task.result("Plan size", static_cast<std::int64_t>(std::filesystem::file_size(plan)));
    });
    interfacer.run();
    return 0;
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
