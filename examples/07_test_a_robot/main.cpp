// SPDX-License-Identifier: MIT
// rover-entity [FOLDER_OF_PROFILES]
#include <iostream>

#include "rover.hpp"

int main(int argc, char** argv) try {
    Rover(argc > 1 ? argv[1] : ".").run();
    return 0;
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
