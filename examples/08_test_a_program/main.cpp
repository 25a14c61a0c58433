// SPDX-License-Identifier: MIT
// tour-client [SERVER]: a tour of the rover
#include <iostream>

#include "tour.hpp"

int main(int argc, char** argv) {
    axon::client::Options options;
    if (argc > 1) options.server = argv[1];
    const auto lab = axon::client::Client::connect(options);
    if (!lab) {
        std::cerr << lab.refusal().message << '\n';
        return 1;
    }
    std::cout << tour(*lab.value(), {1000, 500}) << '\n';
}
