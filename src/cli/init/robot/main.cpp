// SPDX-License-Identifier: MIT
#include <iostream>

#include "robot.hpp"

int main(int argc, char** argv) try {
    if (argc > 1 && *argv[1] == '-') {
        std::cout << "@TARGET@ [FOLDER]   FOLDER has basic.xml, services.xml and ports.cfg\n";
        return 0;
    }
    Robot(argc > 1 ? argv[1] : ROBOT_FOLDER).run();
    return 0;
} catch (const axon::Misconfiguration& error) {
    std::cerr << error.what() << '\n';
    return 2;
}
