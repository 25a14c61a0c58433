// SPDX-License-Identifier: GPL-2.0-or-later
// round-trips SERVER ENTITY: lets the entity carry out the service Nothing as often as each line on its input
// says, and prints how long each task took, in microseconds, on one line. What benchmark_test.py compares
// Python with.
#include <axon/client.hpp>
#include <chrono>
#include <iostream>

int main(int argc, char** argv) {
    namespace client = axon::client;
    if (argc != 3) return std::cerr << "round-trips SERVER ENTITY\n", 2;
    client::Options options;
    options.server = argv[1];
    const auto lab = client::Client::connect(options);
    if (!lab) return std::cerr << lab.refusal().message << '\n', 1;
    const auto held = lab.value()->checkOut(argv[2]);
    if (!held) return std::cerr << held.refusal().message << '\n', 1;
    std::cout << "ready" << std::endl;
    for (int count = 0; std::cin >> count;) {
        for (int i = 0; i < count; ++i) {
            const auto begin = std::chrono::steady_clock::now();
            const auto end = held->run("Nothing").wait();
            const auto took = std::chrono::steady_clock::now() - begin;
            if (end.state != client::TaskState::Succeeded) return std::cerr << end.reason.message << '\n', 1;
            std::cout << std::chrono::duration_cast<std::chrono::microseconds>(took).count() << ' ';
        }
        std::cout << std::endl;
    }
}
