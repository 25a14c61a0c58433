// SPDX-License-Identifier: GPL-2.0-or-later
#include "laboratory.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <stdexcept>
#include <system_error>
#include <thread>

namespace axon::faults {

namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;

constexpr std::uint16_t kClientPort = 10410;  // and the three after it, as everywhere
constexpr std::size_t kDaemonsMax = 16;       // above that, a process for each Entity Manager is the load

/// 127.x.y.z of this process's own; `which` from 1 to 3.
std::string loopback(unsigned which) {
    const auto pid = static_cast<unsigned>(::getpid());
    return "127." + std::to_string(1 + (pid >> 14U) % 250) + "." + std::to_string((pid >> 6U) & 255U) + "." +
           std::to_string((pid & 63U) * 4 + which);
}

std::string portText(std::uint16_t port) {
    return std::to_string(port);
}

std::string slowDiskLibrary(const fs::path& programs) {
    constexpr auto kName = "libaxon_slow_disk.so";
    auto library = programs / kName;                                                          // of a build
    if (!fs::exists(library)) library = programs.parent_path() / "libexec" / "axon" / kName;  // as installed
    if (!fs::exists(library))
        throw std::runtime_error(library.string() +
                                 ": expected the library that makes a disk slow; fix: build axon_slow_disk, "
                                 "which a build with a sanitizer does not have");
    return library.string();
}

}  // namespace

bool waitUntil(const std::function<bool()>& holds, std::chrono::milliseconds time) {
    const auto end = std::chrono::steady_clock::now() + time;
    while (!holds()) {
        if (interrupted() || std::chrono::steady_clock::now() >= end) return holds();
        std::this_thread::sleep_for(500us);
    }
    return true;
}

Laboratory::Laboratory(const Wishes& wishes, const Needs& needs)
    : wishes_(wishes),
      needs_(needs),
      daemons_(needs.daemons || wishes.entities <= kDaemonsMax),
      own_(loopback(1)),
      between_(loopback(2)),
      keep_logs_(wishes.keep_logs) {
    for (const auto* program : {"axon-server", "axon-entity-manager"})
        if (!fs::exists(wishes_.programs / program))
            throw std::runtime_error((wishes_.programs / program).string() +
                                     " does not exist; expected Axon's programs there; fix: build them, or "
                                     "name their folder with --programs DIR");
    auto name = (fs::temp_directory_path() / "axon-faults-XXXXXX").string();
    if (!::mkdtemp(name.data())) throw std::system_error(errno, std::generic_category(), name);
    folder_ = name;
    board_ = std::make_unique<Board>((folder_ / "board").string(), wishes_.entities, true);
    const auto through = [&](Hop hop, std::uint16_t port) { relay_.open(hop, between_, port, own_, port); };
    for (std::uint16_t lane = 0; lane < 2; ++lane) {
        if (needs_.relay_clients) through(Hop::Client, static_cast<std::uint16_t>(kClientPort + lane));
        if (needs_.relay_managers) through(Hop::Manager, static_cast<std::uint16_t>(kClientPort + 2 + lane));
    }
    if (needs_.relay_links)
        for (std::size_t i = 0; i < wishes_.entities; ++i) through(Hop::Link, linkPort(i));
    std::ofstream server(folder_ / "server.cfg");
    if (needs_.relay_clients)
        server << "FrontEndServerSignal.PublishedEndpoints=" << between_ << ":" << kClientPort + 1 << "\n";
    if (needs_.relay_managers)
        server << "EntityServerSignal.PublishedEndpoints=" << between_ << ":" << kClientPort + 3 << "\n";
    std::ofstream(folder_ / "manager.cfg") << "Axon.LeaseGrace=" << kLeaseGrace << "\n";
    std::ofstream(folder_ / "master.cfg")
        << "Axon.LeaseGrace=" << kLeaseGrace << "\nIce.Default.SourceAddress=" << loopback(3) << "\n";
    if (needs_.first_master) relay_.divert(loopback(3), Hop::Master);
    board_->desk().together = needs_.first_master ? 2 : needs_.together ? 1 : 0;
    if (wishes_.busy) burners_ = std::make_unique<Burners>(std::max(1U, std::thread::hardware_concurrency()));
}

void Laboratory::endAll() {
    for (auto* child : {operator_.get(), load_.get(), server_.get(), application_.get()})
        if (child) child->kill();
    for (auto& manager : managers_)
        if (manager) manager->kill();
    operator_.reset();
    load_.reset();
    managers_.clear();
    server_.reset();
    application_.reset();
}

void Laboratory::endClient() {
    operator_.reset();
}

void Laboratory::startLoad() {
    board_->desk().load = board_->desk().loaders = 0;
    load_ =
        std::make_unique<Child>(std::vector<std::string>{fs::canonical("/proc/self/exe").string(), "load",
                                                         (folder_ / "board").string(),
                                                         std::to_string(wishes_.entities), clientAddress()},
                                folder_ / "load.log");
}

void Laboratory::endLoad() {
    load_.reset();
}

std::size_t Laboratory::managerIndex(std::size_t i) const {
    if (daemons_) return i;
    return needs_.tenth_apart && i >= lastTenth() ? 1 : 0;
}

std::vector<Child*> Laboratory::managersOfLastTenth() {
    std::vector<Child*> processes;
    for (auto i = lastTenth(); i < wishes_.entities; ++i) {
        auto* const process = &manager(i);
        if (processes.empty() || processes.back() != process) processes.push_back(process);
    }
    return processes;
}

void Laboratory::startAnew() {
    endAll();
    for (const auto hop : {Hop::Client, Hop::Manager, Hop::Link, Hop::Master}) {
        relay_.heal(hop);
        relay_.reset(hop);
    }
    board_->desk().wedged = 0;
    startAll();
}

Laboratory::~Laboratory() {
    endAll();
    std::error_code none;
    if (keep_logs_)
        std::fprintf(stderr, "logs: %s\n", folder_.c_str());
    else
        fs::remove_all(folder_, none);
}

std::string Laboratory::clientAddress() const {
    return (needs_.relay_clients ? between_ : own_) + ":" + portText(kClientPort);
}

void Laboratory::startServer() {
    if (server_ && server_->running()) return;
    server_ = std::make_unique<Child>(
        std::vector<std::string>{(wishes_.programs / "axon-server").string(), "--listen", own_, "--config",
                                 (folder_ / "server.cfg").string()},
        folder_ / "server.log");
    server_->waitForLine("ready ");
}

void Laboratory::startApplication() {
    if (application_ && application_->running()) return;
    const auto before = board_->desk().applications.load();
    application_ = std::make_unique<Child>(
        std::vector<std::string>{fs::canonical("/proc/self/exe").string(), "application",
                                 (folder_ / "board").string(), folder_.string(),
                                 std::to_string(wishes_.entities), own_, "-"},
        folder_ / "application.log");
    if (!waitUntil([&] { return board_->desk().applications != before || !application_->running(); }, 20s) ||
        !application_->running())
        application_->waitForLine("(its first robot)");  // throws, with the log
}

void Laboratory::startManagers() {
    const auto server = (needs_.relay_managers ? between_ : own_) + ":" + portText(kClientPort + 2);
    const auto links = needs_.relay_links ? between_ : own_;
    if (!daemons_) {
        managers_.resize(needs_.tenth_apart ? 2 : 1);
        const auto apart = needs_.tenth_apart ? lastTenth() : wishes_.entities;
        for (std::size_t k = 0; k < managers_.size(); ++k) {
            if (managers_[k] && managers_[k]->running()) continue;
            const auto first = k == 0 ? 0 : apart;
            const auto count = k == 0 ? apart : wishes_.entities - apart;
            managers_[k] = std::make_unique<Child>(
                std::vector<std::string>{fs::canonical("/proc/self/exe").string(), "managers",
                                         (folder_ / "board").string(), folder_.string(),
                                         std::to_string(wishes_.entities), links, server,
                                         std::to_string(first), std::to_string(count)},
                folder_ / (k == 0 ? "managers.log" : "managers-apart.log"));
            managers_[k]->waitForLine("ready");
        }
        return;
    }
    managers_.resize(wishes_.entities);
    std::vector<std::size_t> started;
    for (std::size_t i = 0; i < wishes_.entities; ++i) {
        if (managers_[i] && managers_[i]->running()) continue;
        const auto number = std::to_string(i);
        std::vector<std::string> environment;
        if (needs_.slow_disk)
            environment = {"LD_PRELOAD=" + slowDiskLibrary(wishes_.programs),
                           "AXON_SLOW_DISK=" + (folder_ / ("state-" + number)).string()};
        managers_[i] = std::make_unique<Child>(
            std::vector<std::string>{
                (wishes_.programs / "axon-entity-manager").string(), "--application", applicationName(i),
                "--server", server, "--address", links, "--ports", portText(linkPort(i)), "--state",
                (folder_ / ("state-" + number)).string(), "--config",
                (folder_ / (needs_.first_master && i == 0 ? "master.cfg" : "manager.cfg")).string()},
            folder_ / ("manager-" + number + ".log"), std::move(environment));
        started.push_back(i);
    }
    for (const auto i : started) managers_[i]->waitForLine("ready ");
}

void Laboratory::slowDisk() {
    std::ofstream(folder_ / "slow") << "while this file is there (tests/support/slow_disk.hpp)\n";
}

void Laboratory::startAll() {
    startServer();
    startApplication();
    startManagers();
}

bool Laboratory::prepare(std::chrono::seconds patience) {
    startAll();
    if (!operator_ || !operator_->running())
        operator_ = std::make_unique<Child>(
            std::vector<std::string>{fs::canonical("/proc/self/exe").string(), "operator",
                                     (folder_ / "board").string(), std::to_string(wishes_.entities),
                                     clientAddress()},
            folder_ / "operator.log");
    const auto order = ++orders_;
    board_->desk().prepare = order;
    return waitUntil(
        [&] {
            if (board_->desk().prepared != order) return false;
            for (std::size_t i = 0; i < board_->movers(); ++i)
                if ((*board_)[i].moving == 0) {
                    board_->desk().prepared = 0;  // one was stopped meanwhile: the order stands
                    return false;
                }
            return true;
        },
        patience);
}

std::vector<Motion> Laboratory::newMotions() {
    std::vector<Motion> motions;
    std::ifstream log(folder_ / "motions");
    log.seekg(static_cast<std::streamoff>(motions_read_));
    for (std::string line; std::getline(log, line) && !log.eof();) {  // the last one may not be whole yet
        Motion motion;
        if (parseMotion(line, motion)) motions.push_back(std::move(motion));
        motions_read_ += line.size() + 1;
    }
    return motions;
}

}  // namespace axon::faults
