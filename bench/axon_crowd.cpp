// SPDX-License-Identifier: GPL-2.0-or-later
#include "axon_crowd.hpp"

#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <thread>

namespace axon::bench {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

volatile sig_atomic_t interrupted = 0;

Child::Child(const std::vector<std::string>& words, const fs::path& log) {
    std::fflush(nullptr);  // or the child would print our buffers again
    pid_ = ::fork();
    if (pid_ == 0) {
        ::setpgid(0, 0);  // Ctrl-C is for the benchmark, which then ends its children itself
        ::prctl(PR_SET_PDEATHSIG, SIGKILL);
        std::freopen(log.c_str(), "w", stdout);
        std::freopen(log.c_str(), "a", stderr);
        std::vector<char*> arguments;
        for (const auto& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
        arguments.push_back(nullptr);
        ::execvp(arguments[0], arguments.data());
        std::perror(arguments[0]);
        ::_exit(127);
    }
}
Child::~Child() {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
}
bool Child::running() const {
    return ::waitpid(pid_, nullptr, WNOHANG) == 0;
}

namespace {

std::string waitForLine(const fs::path& log, const std::string& begin, const Child& child) {
    for (int i = 0; i < 2000 && !interrupted; ++i) {
        std::ifstream in(log);
        for (std::string line; std::getline(in, line);)
            if (line.rfind(begin, 0) == 0) return line;
        if (!child.running()) break;
        std::this_thread::sleep_for(5ms);
    }
    throw std::runtime_error("a program did not become ready; see " + log.string());
}

std::string field(const std::string& ready_line, const std::string& key) {
    std::istringstream words(ready_line);
    for (std::string word; words >> word;)
        if (word.rfind(key + "=", 0) == 0) return word.substr(key.size() + 1);
    throw std::runtime_error("no " + key + "= in: " + ready_line);
}

}  // namespace

AxonCrowd::AxonCrowd(const fs::path& programs, const fs::path& folder, std::size_t n, const Running* running)
    : board_((folder / "axon.board").string(), n, true) {
    client::Options options{.timeout = client::Seconds{30}};
    std::string entity_server;
    if (running) {
        auto configured = client::readConfiguration(running->client_config, options);
        if (!configured) throw std::runtime_error(configured.refusal().message);
        options = std::move(configured).value();
        entity_server = running->entity_config;
    } else {
        server_ = std::make_unique<Child>(
            std::vector<std::string>{(programs / "axon-server").string(), "--client-endpoint", "127.0.0.1:0",
                                     "--client-signal-endpoint", "127.0.0.1:0", "--entity-endpoint", "127.0.0.1:0",
                                     "--entity-signal-endpoint", "127.0.0.1:0"},
            folder / "server.log");
        const auto ready = waitForLine(folder / "server.log", "ready ", *server_);
        options.server = field(ready, "client");
        entity_server = field(ready, "entity");
    }
    crowd_ = std::make_unique<Child>(
        std::vector<std::string>{(programs / "axon-bench").string(), "crowd", (folder / "axon.board").string(),
                                 std::to_string(n), entity_server},
        folder / "crowd.log");
    while (board_.ready() < n && !interrupted) {
        if (!crowd_->running()) throw std::runtime_error("the entities did not start; see " + (folder / "crowd.log").string());
        std::this_thread::sleep_for(10ms);
    }
    auto connected = client::Client::connect(options);
    if (!connected) throw std::runtime_error(connected.refusal().message);
    client_ = std::move(connected).value();
    for (std::size_t i = 0; i < n; ++i) names_.push_back("bench-" + std::to_string(i));
    for (const auto& name : names_)
        if (const auto there = client_->waitFor(name, client::Seconds{10}); !there)
            throw std::runtime_error(there.refusal().message);
    auto held = client_->checkOut(names_);
    if (!held) throw std::runtime_error(held.refusal().message);
    held_ = std::move(held).value();
}

nlohmann::json machine() {
    std::string model = "unknown";
    std::ifstream cpu("/proc/cpuinfo");
    for (std::string line; std::getline(cpu, line);)
        if (line.rfind("model name", 0) == 0) {
            model = line.substr(line.find(':') + 2);
            break;
        }
    return {{"cpu", model}, {"cores", std::thread::hardware_concurrency()}, {"clock", "CLOCK_MONOTONIC"}};
}

}  // namespace axon::bench
