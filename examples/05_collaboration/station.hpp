// SPDX-License-Identifier: MIT
// What the three entities of this example have in common: their command line, and cells of the floor.
#pragma once
#include <axon/entity_interfacer.hpp>

#include <cstdio>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

struct Options {
    std::filesystem::path folder = ".";  ///< of the example: profiles, map.txt, table.txt
    std::string ports_file;
    std::string application;
    double speed = 1;  ///< everything takes a part of its time; tests hurry
};

/// PROGRAM [FOLDER [PORTS_FILE]] [--application NAME] [--speed FACTOR]
inline Options readOptions(int argc, char** argv, const std::string& application) {
    Options options;
    options.application = application;
    std::vector<std::string> words;
    for (int i = 1; i < argc; ++i) {
        const std::string word = argv[i];
        if (word == "--help") {
            std::cout << argv[0] << " [FOLDER [PORTS_FILE]] [--application NAME] [--speed FACTOR]\n";
            std::exit(0);
        }
        if (word == "--application" && i + 1 < argc)
            options.application = argv[++i];
        else if (word == "--speed" && i + 1 < argc)
            options.speed = std::atof(argv[++i]);
        else if (!word.starts_with("--") && words.size() < 2)
            words.push_back(word);
        else
            throw axon::Misconfiguration("'" + word +
                                         "': expected --application NAME, --speed FACTOR, or --help");
    }
    if (!words.empty()) options.folder = words[0];
    if (words.size() > 1) options.ports_file = words[1];
    if (!(options.speed > 0)) throw axon::Misconfiguration("--speed: expected a factor above 0, such as 10");
    return options;
}

/// A square of half a metre, "3,1": the fourth from the left in the second row.
struct Cell {
    int x = 0, y = 0;
    bool operator==(const Cell&) const = default;
    bool isBeside(const Cell& other) const { return std::abs(x - other.x) + std::abs(y - other.y) == 1; }
};

inline std::string toText(const Cell& cell) {
    return std::to_string(cell.x) + "," + std::to_string(cell.y);
}

inline Cell toCell(const std::string& text) {
    Cell cell;
    int read = 0;
    if (std::sscanf(text.c_str(), "%d,%d%n", &cell.x, &cell.y, &read) != 2 ||
        text.size() != std::size_t(read))
        throw std::invalid_argument("'" + text + "' is no cell: expected a column and a row, such as 3,1");
    return cell;
}

/// A request that cannot be understood is a failed task, not a fault of the robot: an exception that nobody
/// catches would stop it.
inline axon::EntityInterfacer::TaskHandler failing(axon::EntityInterfacer::TaskHandler handler) {
    return [handler = std::move(handler)](axon::Task& task) {
        try {
            handler(task);
        } catch (const std::invalid_argument& error) {
            task.fail(error.what());
        }
    };
}

/// Uploads the profiles of `its` folder, lets `add` say what the entity can do, and runs it until it is told
/// to end.
inline int runStation(int argc, char** argv, const std::string& application, const std::string& its,
                      const std::function<void(axon::EntityInterfacer&, const Options&)>& add) try {
    const auto options = readOptions(argc, argv, application);
    axon::EntityInterfacer interfacer({.application = options.application, .ports_file = options.ports_file});
    interfacer.uploadBasicProfile(options.folder / its / "basic.xml");
    interfacer.uploadServiceProfile(options.folder / its / "services.xml");
    // Whoever waits in a task is woken by the library, so nothing moves any more when this is called.
    interfacer.onStop(
        [](const axon::StopSignal& stop) { std::cout << "stop: " << toString(stop.cause) << std::endl; });
    add(interfacer, options);
    interfacer.run();
    return 0;
} catch (const axon::Misconfiguration& error) {
    std::cerr << argv[0] << ": " << error.what() << '\n';
    return 2;
}
