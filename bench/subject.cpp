// SPDX-License-Identifier: GPL-2.0-or-later
#include "subject.hpp"

#include <algorithm>
#include <cstdio>
#include <iostream>

#include "mosquitto_peer.hpp"
#include "nats_peer.hpp"
#include "raw_router.hpp"
#include "report.hpp"

namespace axon::bench {

namespace fs = std::filesystem;

namespace {

class AxonSubject final : public Subject {
  public:
    template <class... Of>
    explicit AxonSubject(Of&&... of) : crowd_(std::forward<Of>(of)...), left_(countLeft(crowd_.client())) {}
    Board& board() override { return crowd_.board(); }
    Board* robots() override { return crowd_.robots(); }
    bool numbered(Kind kind) const override { return kind == Kind::Data; }
    void send(Message message, const std::string& bytes, std::vector<std::int64_t>& called) override {
        if (message == Message::Stop) {
            std::fill(called.begin(), called.end(), nowNs());
            // Sends one stop for all of them and then waits for the receipts; the arrivals are on the board
            // by then. Several that have a server to themselves are stopped as one stops everything, without
            // naming them.
            const bool everything = crowd_.names().size() > 1 && crowd_.alone();
            if (const auto receipts = crowd_.client().stop(
                    everything ? std::vector<std::string>{} : crowd_.names(), client::Seconds{5});
                !receipts)
                std::cerr << "stop: " << receipts.refusal().message << "\n";
            return;
        }
        for (std::size_t i = 0; const auto& entity : crowd_.held()) {
            called[i++] = nowNs();
            // The batch may be larger than what may wait for the server.
            if (const auto sent = entity.sendRaw(bytes, client::Seconds{2}); !sent)
                std::cerr << "data: " << sent.refusal().message << "\n";
        }
    }

    std::size_t disconnected() const override { return *left_; }
    std::size_t relayed() const override { return crowd_.relayed(); }
    std::string ended() const override { return crowd_.ended(); }

  private:
    AxonCrowd crowd_;
    const std::shared_ptr<std::atomic<std::size_t>> left_;
};

template <Variant variant>
std::unique_ptr<Subject> startAxon(const fs::path& folder, std::size_t n) {
    return std::make_unique<AxonSubject>(folder, n, variant);
}

Peer packaged(const char* name, const char* package, const char* program, decltype(Peer::start) start,
              const char* what) {
    return {name, package, findProgram(program).empty() ? program : "", start, what};
}

}  // namespace

const char* nameOf(Message message) {
    return message == Message::Stop ? "stop" : message == Message::Small ? "small" : "data";
}

const std::vector<Peer>& peers() {
    static const std::vector<Peer> all{
        {"axon", "", "", startAxon<Variant::Relayed>, "Axon relayed: client, axon-server, Entity Managers"},
        {"raw", "", "", startRawRouter,
         "the project's own epoll router, a system call for each message, no batching: what a simple relay "
         "costs this machine"},
        packaged(
            "mosquitto-qos0", "mosquitto", "mosquitto",
            [](const fs::path& folder, std::size_t n) { return startMosquitto(folder, n, 0); },
            "Mosquitto, at most once"),
        packaged(
            "mosquitto-qos1", "mosquitto", "mosquitto",
            [](const fs::path& folder, std::size_t n) { return startMosquitto(folder, n, 1); },
            "Mosquitto, at least once"),
        packaged("nats", "nats-server", "nats-server", startNats, "NATS core"),
        // Last: libmosquitto waits by select(), which knows no descriptor from 1024 on, and these have one or
        // two for each receiver.
        {"axon-direct", "", "", startAxon<Variant::Direct>,
         "Axon by direct paths: client, Entity Managers; a stop goes both ways"},
        {"raw-direct", "", "", startRawDirect,
         "raw without its router, a connection to each receiver: what a direct path costs this machine"},
    };
    return all;
}

void reportSkipped(Report& report, const std::string& peer, const std::string& package,
                   const std::string& reason) {
    progress("");
    std::printf("%s is skipped: %s\n", peer.c_str(), reason.c_str());
    auto skipped = report.all().at("skipped");
    skipped.push_back({{"peer", peer}, {"package", package}, {"reason", reason}});
    report.set("skipped", skipped);
}

void reportPeers(Report& report, const std::vector<std::string>& wanted) {
    report.set("skipped", nlohmann::json::array());
    nlohmann::json versions = nlohmann::json::object();
    const auto look = [&](const std::string& name, const std::string& package, bool missing) {
        if (package.empty() || std::find(wanted.begin(), wanted.end(), name) == wanted.end()) return;
        if (missing) {
            reportSkipped(
                report, name, package,
                "its program is not installed; fix: apt-get install --no-install-recommends " + package);
        } else {
            versions[name] = packageVersion(package);
        }
    };
    for (const auto& peer : peers()) look(peer.name, peer.package, !peer.missing.empty());
    look("cyclonedds", "cyclonedds-tools", findProgram("ddsperf").empty());
    report.set("versions", versions);
}

std::unique_ptr<Subject> axonThrough(const Running& running, const fs::path& folder, std::size_t n) {
    return std::make_unique<AxonSubject>(folder, n, Variant::Relayed, &running);
}

const Peer& axonRobots() {
    static const Peer its{
        "axon-robots", "", "", startAxon<Variant::Robots>,
        "Axon relayed, to the callbacks of robot applications with real Entity Interfacers"};
    return its;
}

std::optional<Variant> variantOf(const std::string& name) {
    for (const auto& [its, variant] :
         {std::pair{"axon", Variant::Relayed}, std::pair{"axon-direct", Variant::Direct},
          std::pair{"axon-robots", Variant::Robots}})
        if (name == its) return variant;
    return std::nullopt;
}

std::unique_ptr<Subject> axonWithRadio(const Radio& radio, const fs::path& folder, std::size_t n,
                                       Variant variant) {
    return std::make_unique<AxonSubject>(folder, n, variant, nullptr, &radio);
}

std::unique_ptr<Subject> axonOf(const AxonServer& server, const fs::path& folder, const std::string& prefix,
                                std::size_t n, Variant variant) {
    return std::make_unique<AxonSubject>(server, folder, prefix, n, variant);
}

}  // namespace axon::bench
