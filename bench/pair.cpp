// SPDX-License-Identifier: GPL-2.0-or-later
// A client and a robot application that do nothing but pass messages, so that bench/instructions.py can count
// what each station spends on one of them. The application writes a byte into a pipe for each message that
// its callback was given, and the client reads it before it sends more: so no station ever has another
// message to deal with than those that were asked for.
#include <fcntl.h>
#include <unistd.h>

#include <axon/entity_interfacer.hpp>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>

#include "client/axon/client.hpp"

namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

template <class T>
T accepted(axon::Result<T> result) {
    if (!result) throw std::runtime_error(result.refusal().message);
    return std::move(result).value();
}

int opened(const char* path, int flags) {
    const int descriptor = ::open(path, flags);
    if (descriptor < 0) throw std::runtime_error(std::string("cannot open ") + path);
    return descriptor;
}

/// Until its parent ends.
int runApplication(const std::string& name, std::uint16_t port, const char* pipe, const fs::path& folder) {
    const auto parent = ::getppid();
    axon::EntityInterfacer::Options options;
    options.application = name;
    options.first_port = options.last_port = port;
    options.watch_profiles = false;
    options.logger = [](axon::LogLevel, const std::string& text) { std::cerr << text << "\n"; };
    const int arrived = opened(pipe, O_RDWR);
    axon::EntityInterfacer robot(std::move(options));
    robot.uploadBasicProfile(folder / "basic.xml");
    robot.uploadServiceProfile(folder / "services.xml");
    robot.onRaw([arrived](const std::vector<std::string>& blocks, const std::string&) {
        for (std::size_t i = 0; i < blocks.size(); ++i)
            if (::write(arrived, "x", 1) != 1) std::abort();
    });
    robot.start();
    while (::getppid() == parent) std::this_thread::sleep_for(200ms);
    return 0;
}

/// Lines of `requests`: COUNT TOGETHER BYTES. Answers each with "sent" when all have arrived.
int runClient(const std::string& server, const std::string& name, const std::string& way, const char* pipe,
              const fs::path& requests) {
    const int arrived = opened(pipe, O_RDWR);
    axon::client::Options options;
    options.server = server;
    options.timeout = axon::client::Seconds{60};
    options.direct = way == "direct";
    const auto client = accepted(axon::client::Client::connect(options));
    accepted(client->waitFor(name, axon::client::Seconds{60}));
    const auto held = accepted(client->checkOut(name));
    while (options.direct && !held.direct()) std::this_thread::sleep_for(5ms);
    std::cout << "ready" << std::endl;
    std::ifstream asked(requests);
    for (std::string line; std::getline(asked, line);) {
        std::istringstream words(line);
        std::size_t count = 0, together = 0, bytes = 0;
        if (!(words >> count >> together >> bytes)) throw std::runtime_error("not understood: " + line);
        const std::string content(bytes, 'x');
        for (std::size_t sent = 0; sent < count; sent += together) {
            for (std::size_t i = 0; i < together; ++i)
                if (const auto done = held.sendRaw(content, axon::client::Seconds{10}); !done)
                    throw std::runtime_error(done.refusal().message);
            char byte = 0;
            for (std::size_t i = 0; i < together; ++i)
                if (::read(arrived, &byte, 1) != 1) throw std::runtime_error("the pipe has ended");
        }
        if (options.direct != held.direct()) throw std::runtime_error("the direct path has ended");
        std::cout << "sent" << std::endl;
    }
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    try {
        const std::string role = argc > 1 ? argv[1] : "";
        if (role == "application" && argc == 6)
            return runApplication(argv[2], static_cast<std::uint16_t>(std::stoi(argv[3])), argv[4], argv[5]);
        if (role == "client" && argc == 7) return runClient(argv[2], argv[3], argv[4], argv[5], argv[6]);
    } catch (const std::exception& problem) {
        std::cerr << "axon-bench-pair: " << problem.what() << "\n";
        return 1;
    }
    std::cerr << "axon-bench-pair is started by bench/instructions.py:\n"
                 "  axon-bench-pair application NAME PORT PIPE FOLDER\n"
                 "  axon-bench-pair client HOST:PORT NAME relayed|direct PIPE REQUESTS\n";
    return 2;
}
