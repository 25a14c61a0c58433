// SPDX-License-Identifier: GPL-2.0-or-later
#include "axon_crowd.hpp"

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <functional>
#include <stdexcept>
#include <thread>

namespace axon::bench {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

namespace {

/// Entities log in 32 at a time; on a busy machine a thousand of them take a while.
constexpr auto kJoinTime = 120s;

client::Options patient() {
    return {.timeout = client::Seconds{30}};
}

/// Of a process, besides what each of many costs it.
constexpr std::size_t kOwnDescriptors = 100;

/// Counted in /proc: two sessions with the server; two connections with a robot application, and those that
/// are being made; with a direct path 12, of two adapters (each a listener, and three of its thread pool) and
/// the connections that they have taken, and as much room again: a path that is opened anew has those of the
/// old one beside it.
std::size_t descriptorsOfEach(Variant variant) {
    return (isDirect(variant) ? 24 : 2) + (hasRobots(variant) ? 4 : 0);
}
/// A listener, two connections, what wakes its threads; and a connection that says Hello meanwhile.
constexpr std::size_t kDescriptorsOfRobot = 8;
/// At the client.
constexpr std::size_t kDescriptorsOfPath = 2;

/// The variant, where this process, which is the client's, may have as many descriptors as it needs.
Variant permitted(Variant variant, std::size_t n) {
    const auto needed = n * kDescriptorsOfPath + kOwnDescriptors;
    if (isDirect(variant) && needed > descriptorsPermitted())
        throw NotPermitted(std::to_string(n) + " direct paths need " + std::to_string(needed) +
                           " descriptors in the client's process, which may have " +
                           std::to_string(descriptorsPermitted()) + "; fix: raise the limit with ulimit -n");
    return variant;
}

/// Of users that exist in one run's folder, for as long as it lasts.
constexpr const char* kPassword = "of a benchmark";

void addUser(const fs::path& users, const std::string& name, const std::string& role) {
    const auto command = "'" + (programs() / "axon-server").string() + "' --users '" + users.string() +
                         "' --add-user " + name + " --user-role " + role + " >'" + users.string() +
                         ".log' 2>&1";
    FILE* pipe = ::popen(command.c_str(), "w");
    if (pipe != nullptr) std::fprintf(pipe, "%s\n", kPassword);
    if (pipe == nullptr || ::pclose(pipe) != 0)
        throw std::runtime_error("axon-server did not add a user" + see(users.string() + ".log"));
}

std::vector<std::string> serverCommand(const fs::path& folder, const Radio* radio) {
    const std::string host = radio ? Radio::address() : "127.0.0.1";
    std::vector<std::string> words{(programs() / "axon-server").string(),
                                   "--client-endpoint",
                                   "127.0.0.1:0",
                                   "--client-signal-endpoint",
                                   "127.0.0.1:0",
                                   "--entity-endpoint",
                                   host + ":0",
                                   "--entity-signal-endpoint",
                                   host + ":0"};
    if (radio) {
        const auto users = folder / "users.cfg";
        addUser(users, "bench-client", "operator");
        addUser(users, "bench-entity", "entity");
        words.insert(words.end(), {"--users", users.string(), "--plain-tcp"});
    }
    return words;
}

std::string configuration(const fs::path& file, const std::string& server, const std::string& user) {
    std::ofstream(file) << "Axon.Server=" << server << "\nAxon.User=" << user
                        << "\nAxon.Password=" << kPassword << "\n";
    fs::permissions(file, fs::perms::owner_read | fs::perms::owner_write);
    return file.string();
}

client::Options configured(const fs::path& file) {
    auto read = client::readConfiguration(file, patient());
    if (!read) throw std::runtime_error(read.refusal().message);
    return std::move(read).value();
}

}  // namespace

AxonServer::AxonServer(const fs::path& folder, const Radio* radio)
    : radio_(radio), child_(serverCommand(folder, radio), folder / "server.log") {
    const auto ready = child_.waitForLine("ready ");
    client_ = field(ready, "client");
    entity_ = field(ready, "entity");
    if (radio) {
        client_ = configuration(folder / "client.cfg", client_, "bench-client");
        entity_ = configuration(folder / "entity.cfg", entity_, "bench-entity");
    }
}

Entities::Entities(const fs::path& folder, const std::string& prefix, std::size_t n,
                   const std::string& server, const Radio* radio, Variant variant, std::size_t scans)
    : board_((folder / (prefix + ".board")).string(), n, true) {
    const auto own = descriptorsPermitted() - std::min(descriptorsPermitted(), kOwnDescriptors);
    const auto wired = radio ? firstWireless(n) : n;
    // Processes of this name for all of them; each says on the board that it is ready.
    const auto start = [&](const char* process, const std::string& suffix, std::size_t descriptors,
                           const std::vector<std::string>& more, Board& board) {
        const auto most = std::max<std::size_t>(1, own / descriptors);
        const auto before = children_.size();
        for (std::size_t first = 0, count = 0; first < n; first += count) {
            const bool wireless = first >= wired;
            count = std::min(most, (wireless ? n : wired) - first);
            std::vector<std::string> words{(folder / (prefix + suffix)).string(), std::to_string(n),
                                           std::to_string(first), std::to_string(count), prefix};
            words.insert(words.end(), more.begin(), more.end());
            children_.push_back(std::make_unique<Child>(
                ourselves(process, words), folder / (prefix + suffix + "-" + std::to_string(first) + ".log"),
                std::vector<std::string>{}, wireless ? radio->enterWireless() : std::function<void()>()));
        }
        children_.back()->waitUntil(
            [&] {
                if (const auto its = ended(); !its.empty()) throw std::runtime_error(its);
                return board.ready() >= children_.size() - before;
            },
            "the entities did not start", kJoinTime);
    };
    if (hasRobots(variant)) {
        robots_.emplace((folder / (prefix + ".robots")).string(), n, true);
        start("robots", ".robots", kDescriptorsOfRobot, {std::to_string(scans)}, *robots_);
    }
    start("crowd", ".board", descriptorsOfEach(variant), {server, std::to_string(static_cast<int>(variant))},
          board_);
    for (std::size_t i = 0; i < n; ++i) names_.push_back(prefix + "-" + std::to_string(i));
}

std::string Entities::ended() const {
    for (const auto& child : children_)
        if (auto its = whichHasEnded({{"a process of entities", child.get()}}); !its.empty()) return its;
    return {};
}

std::unique_ptr<client::Client> connectClient(client::Options options) {
    auto connected = client::Client::connect(std::move(options));
    if (!connected) throw std::runtime_error(connected.refusal().message);
    return std::move(connected).value();
}

std::unique_ptr<client::Client> connectClient(const std::string& server, Variant variant) {
    auto options = fs::exists(server) ? configured(server) : patient();
    options.direct = isDirect(variant);
    options.direct_paths = 4096;
    options.direct_spin = directSpin();
    if (!fs::exists(server)) options.server = server;
    return connectClient(std::move(options));
}

std::vector<client::CheckOut> holdAll(client::Client& client, const std::vector<std::string>& names) {
    for (const auto& name : names)
        if (const auto there = client.waitFor(name, client::Seconds{10}); !there)
            throw std::runtime_error(there.refusal().message);
    auto held = client.checkOut(names);
    if (!held) throw std::runtime_error(held.refusal().message);
    return std::move(held).value();
}

std::shared_ptr<std::atomic<std::size_t>> countLeft(client::Client& client) {
    auto left = std::make_shared<std::atomic<std::size_t>>(0);
    client.onEntity([left](Presence presence, const client::Entity&) {
        if (presence == Presence::Left) ++*left;
    });
    return left;
}

AxonCrowd::AxonCrowd(const fs::path& folder, std::size_t n, Variant variant, const Running* running,
                     const Radio* radio)
    : variant_(permitted(variant, n)) {
    if (!running) server_ = std::make_unique<AxonServer>(folder, radio);
    entities_ = std::make_unique<Entities>(
        folder, "bench", n, running ? running->entity_config : server_->entityAddress(), radio, variant);
    client_ = connectClient(running ? running->client_config : server_->clientAddress(), variant);
    hold();
}

std::string AxonCrowd::ended() const {
    const auto server = whichHasEnded({{"axon-server", server_ ? &server_->process() : nullptr}});
    return server.empty() ? entities_->ended() : server;
}

AxonCrowd::AxonCrowd(const AxonServer& server, const fs::path& folder, const std::string& prefix,
                     std::size_t n, Variant variant)
    : variant_(permitted(variant, n)),
      entities_(
          std::make_unique<Entities>(folder, prefix, n, server.entityAddress(), server.radio(), variant)),
      client_(connectClient(server.clientAddress(), variant)) {
    hold();
}

std::size_t AxonCrowd::relayed() const {
    return !isDirect(variant_)
               ? 0
               : static_cast<std::size_t>(std::count_if(held_.begin(), held_.end(),
                                                        [](const auto& its) { return !its.direct(); }));
}

void AxonCrowd::hold() {
    held_ = holdAll(*client_, names());
    const auto end = std::chrono::steady_clock::now() + kJoinTime;
    while (const auto missing = relayed()) {
        if (interrupted) throw std::runtime_error("interrupted");
        if (std::chrono::steady_clock::now() > end)
            throw std::runtime_error("only " + std::to_string(held_.size() - missing) + " of " +
                                     std::to_string(held_.size()) + " direct paths have opened within " +
                                     std::to_string(kJoinTime.count()) + " s");
        std::this_thread::sleep_for(5ms);
    }
}

}  // namespace axon::bench
