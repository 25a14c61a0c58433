// SPDX-License-Identifier: MIT
// @NAME@: a program that uses the robots of an Axon laboratory.
#include <axon/client.hpp>
#include <filesystem>
#include <iostream>

#include "robots.hpp"
#include "words.hpp"

int main(int argc, char** argv) {
    const std::vector<std::string> words(argv + 1, argv + argc);
    if (words.size() == 1) {
        std::cout << "@TARGET@                                     lists the robots\n"
                     "@TARGET@ ROBOT SERVICE [PARAMETER=VALUE…]    runs a service\n"
                     "It reads client.cfg in the working folder, if there is one.\n";
        return words[0] == "--help" ? 0 : 2;
    }
    std::vector<axon::client::Argument> arguments;
    for (std::size_t i = 2; i < words.size(); ++i) {
        const auto argument = readArgument(words[i]);
        if (!argument) {
            std::cerr << "expected PARAMETER=VALUE, found " << words[i] << '\n';
            return 2;
        }
        arguments.push_back(*argument);
    }
    axon::client::Options options;
    options.display_name = "@NAME@";
    if (std::filesystem::exists("client.cfg")) {
        const auto read = axon::client::readConfiguration("client.cfg", options);
        if (!read) return refused(read.refusal());
        options = read.value();
    }
    const auto connected = axon::client::Client::connect(options);
    if (!connected) return refused(connected.refusal());
    auto& client = *connected.value();
    const int exit = words.empty() ? listRobots(client) : runService(client, words[0], words[1], arguments);
    client.close();  // releases what is checked out
    return exit;
}
